"""A sweep on Slurm's own daemons, which run on this machine: `slurm_cluster.sh` starts them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bojax.cli.main import main
from bojax.config.errors import ConfigError
from bojax.config.launching import SlurmConfig, load_launching
from bojax.engine.errors import EngineError
from bojax.engine.launchers.slurm import Slurm
from bojax.results.attempts import AttemptRegistry
from bojax.results.store import WORK
from tests.engine.clusters import (
    EPISODES,
    HAS_SLURM,
    SWEEP,
    contents,
    running_in,
    search_path,
    slurm,
    wait_until,
)
from tests.transcript import cases


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    if not HAS_SLURM:
        pytest.skip("needs slurm-wlm and munge, and root")
    with slurm(tmp_path_factory.mktemp("slurm")) as conf, pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLURM_CONF", str(conf))
        yield


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A working directory with a sweep and its results."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "sweep.yaml").write_text(SWEEP)
    (folder / "cluster.yaml").write_text("{tasks: 2, cpus_per_task: 1, time: '0:10:00'}")
    return folder


@pytest.fixture(scope="module")
def alone(place) -> dict[str, bytes]:
    bojax(place, "sweep", "sweep.yaml", "--out", "alone", EPISODES)
    return contents(place / "alone")


def bojax(place: Path, *words: str, code: int = 0) -> subprocess.CompletedProcess:
    done = subprocess.run(
        [sys.executable, "-m", "bojax", *words],
        cwd=place,
        env={**os.environ, **search_path()},
        capture_output=True,
        text=True,
    )
    assert done.returncode == code, done.stderr
    return done


def on_slurm(place: Path, out: str, *words: str, code: int = 0) -> str:
    """Submit or resume the sweep; the number of the array, if one was submitted."""
    options = ("--launcher", "slurm", "--cluster", "cluster.yaml", "--out", out, EPISODES)
    done = bojax(place, "sweep", "sweep.yaml", *options, *words, code=code)
    return done.stdout.partition("submitted job ")[2].partition(" ")[0]


def states(job: str) -> set[str]:
    shown = subprocess.run(
        ["squeue", "-h", "-t", "all", "-o", "%T", "-j", job], capture_output=True, text=True
    )
    return set(shown.stdout.split())


def has_checkpoint(out: Path) -> bool:
    """Whether there is a checkpoint of the first chunk, with which task 0 starts.

    A task that is still starting may have no handler of its signal yet, though another one has a checkpoint.
    """
    return any((out / WORK).glob("chunk-00000-*/checkpoint-*"))


@pytest.mark.slow
@pytest.mark.slurm
def test_signals_and_a_second_array(cluster, place, alone):
    """Tasks near their limit, and those whose worker dies, start again; cancelled ones do not."""
    out = place / "out"
    job = on_slurm(place, "out")
    assert "#SBATCH --signal=B:USR2@120" in (out / "slurm.sh").read_text()
    wait_until(lambda: has_checkpoint(out))
    subprocess.run(["scancel", "--signal=USR2", "--batch", f"{job}_0"], check=True)
    wait_until(lambda: "Restarts=1" in shown(f"{job}_0"))
    subprocess.run(["scancel", job], check=True)
    wait_until(lambda: states(job) == {"CANCELLED"})
    assert not any((out / WORK).glob("*.failed"))
    second = on_slurm(place, "out", "--resume")  # what is left
    assert second != job and not on_slurm(place, "out", "--resume")  # its tasks have not ended
    wait_until(lambda: running_in(out))
    os.kill(running_in(out)[0], signal.SIGKILL)
    wait_until(lambda: "Restarts=1" in shown(second))
    wait_until(lambda: states(second) == {"COMPLETED"})
    assert len(AttemptRegistry(out / WORK, out).done) == 4
    assert not on_slurm(place, "out", "--resume")
    assert contents(out) == alone
    assert not (out / WORK).exists() and (out / "report.html").exists()


def shown(job: str) -> str:
    return subprocess.run(["scontrol", "show", "job", job], capture_output=True, text=True).stdout


@pytest.mark.slurm
def test_an_unknown_partition_is_refused_before_anything_is_written(cluster, place, tmp_path):
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    (tmp_path / "cluster.yaml").write_text("{partition: nowhere}")
    words = ("sweep", "sweep.yaml", "--launcher", "slurm", "--cluster", "cluster.yaml", "--out", "out")
    done = bojax(tmp_path, *words, code=2)
    assert done.stderr.count("\n") == 1 and "--launcher slurm: " in done.stderr
    assert "Invalid partition name specified" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_script():
    config = SlurmConfig(
        tasks=3,
        partition="gpu",
        account="lab",
        time="2:00:00",
        gpus_per_task=1,
        memory="32G",
        options=("--constraint=h100",),
        setup=("module load cuda",),
    )
    lines = Slurm(config).script("parking, fig-4.6", [Path("/results/my sweep")], 5).splitlines()
    assert lines[0] == "#!/bin/bash"
    assert {
        *(
            "#SBATCH --requeue",
            "#SBATCH --array=0-4%3",
            "#SBATCH --open-mode=append",
            "#SBATCH --time=2:00:00",
        ),
        *("#SBATCH --signal=B:USR2@120", "#SBATCH --partition=gpu", "#SBATCH --account=lab"),
        *("#SBATCH --gpus-per-task=1", "#SBATCH --mem=32G", "#SBATCH --constraint=h100"),
        "#SBATCH --job-name=bojax-parking-fig-4.6",
        "#SBATCH --output='/results/my sweep/.work/slurm-%A_%a.out'",
    } <= set(lines)
    assert "module load cuda" in lines
    (worker,) = [line for line in lines if "bojax worker" in line]
    assert worker.endswith("""-m bojax worker '/results/my sweep' --share "$SLURM_ARRAY_TASK_ID/5" &""")


def test_the_folder_of_the_output_is_no_pattern():
    lines = Slurm(SlurmConfig()).script("parking", [Path("/results/90%j")], 1).splitlines()
    assert "#SBATCH --output=/results/90%%j/.work/slurm-%A_%a.out" in lines


@pytest.mark.parametrize(("name", "folder"), [("a\n#SBATCH --nice", "/results"), ("a", "/results\ntouch x")])
def test_a_line_break_does_not_get_into_the_script(name, folder):
    with pytest.raises(EngineError, match="allowed: names and paths on one line"):
        Slurm(SlurmConfig()).script(name, [Path(folder)], 1)


@pytest.fixture
def here(here) -> Path:
    (here / "sweep.yaml").write_text(SWEEP)
    return here


@pytest.mark.parametrize(("command", "folder"), [("sweep", "out"), ("tune", "out/rounds/000")])
def test_a_dry_run_prints_the_script_and_does_nothing(here, capsys, command, folder):
    (here / "cluster.yaml").write_text("{tasks: 8}")
    words = [*COMMANDS[command].split(), "--launcher", "slurm", "--cluster", "cluster.yaml", "--dry-run"]
    assert main([*words, "--out", "out"]) == 0
    out = capsys.readouterr().out
    assert "#SBATCH --array=0-7%8" in out and f" {here / folder} " in out
    assert sorted(path.name for path in here.iterdir()) == ["cluster.yaml", "sweep.yaml"]


def test_a_dry_run_refuses_the_folders_that_a_sweep_refuses(here, refusal):
    message = f"{here}: the folder is not empty; give another --out, or --resume an unfinished sweep"
    assert refusal(f"sweep sweep.yaml --launcher slurm --dry-run --out {here}") == message


@pytest.mark.parametrize("command", ["sweep", "tune"])
def test_no_slurm_on_this_machine(here, refusal, monkeypatch, command):
    monkeypatch.setenv("PATH", str(here))
    message = "--launcher slurm: no sbatch on this machine; allowed: a login node of a Slurm cluster"
    assert refusal(f"{COMMANDS[command]} --launcher slurm --out out") == message


def test_an_option_that_sbatch_does_not_know(here, refusal, monkeypatch):
    script = here / "sbatch"
    script.write_text("#!/bin/sh\nprintf \"sbatch: unrecognized option '--x'\\nTry more\\n\" >&2; exit 1\n")
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{here}:{os.environ['PATH']}")
    message = "--launcher slurm: sbatch: unrecognized option '--x'"
    assert refusal("sweep sweep.yaml --launcher slurm --out out") == message


COMMANDS = {
    "sweep": "sweep sweep.yaml",
    "reproduce": "reproduce fig-4.6",
    "tune": "tune cliff-walking learner.kappa=0:1",
}


@pytest.mark.parametrize(("submitted", "cluster"), [("7", ""), ("7;name", "--clusters=name ")])
def test_a_driver_that_waits_asks_slurm_until_the_array_has_ended(
    tmp_path, monkeypatch, capsys, submitted, cluster
):
    """A search waits for each round, cancels what is left of its array, and waits for these tasks."""
    told = tmp_path / "told"
    empty = f"echo 'CLUSTER: name' > {tmp_path}/queue"
    answers = {"sbatch": f"echo '{submitted}'", "squeue": f"cat {tmp_path}/queue", "scancel": empty}
    for command, text in answers.items():
        script = tmp_path / command
        script.write_text(f'#!/bin/sh\ncat > /dev/null\necho {command} "$@" >> {told}\n{text}\n')
        script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr("bojax.engine.launchers.slurm.ASK_SECONDS", 0.0)
    launcher = Slurm(SlurmConfig(tasks=2), waits=True)
    (tmp_path / "queue").write_text("CLUSTER: name\n7\n7\n")
    (tmp_path / WORK).mkdir()
    launcher.start("round", [tmp_path], 3, 9)
    assert capsys.readouterr().err == "submitted job 7 of 3 tasks, 2 at a time\n"
    assert launcher.is_awaited and launcher.keep() and launcher.keep()
    launcher.close()
    asked = f"squeue --noheader {cluster}--jobs=7 --format=%F"
    assert told.read_text().splitlines()[1:] == [asked, asked, f"scancel {cluster}7", asked]
    assert not launcher.keep()
    before = told.read_text()
    launcher.close()
    assert told.read_text() == before


MISTAKES = """\
--cluster c.yaml
=> --cluster: allowed: only with --launcher
--launcher ray --devices 0
=> --devices: allowed: only without
--launcher ray --dry-run
=> --dry-run: allowed: only with --launcher slurm
--launcher pbs
=> --launcher: invalid choice: 'pbs'
--launcher slurm --cluster no.yaml
=> no.yaml:
--launcher slurm --cluster c.yaml
=> c.yaml: task: unknown key; allowed: account, cpus_per_task, gpus_per_task, memory, options, partition,
   setup, tasks, time; did you mean "tasks"?
"""


@pytest.mark.parametrize("name", ["partition", "account", "time", "memory", "options", "setup"])
@pytest.mark.parametrize("text", ["a\nb", "a\tb", "a\u2028b", ""])
def test_settings_are_lines_of_the_script(here, name, text):
    value = [text] if name in ("options", "setup") else text
    (here / "c.yaml").write_text(json.dumps({name: value}))
    with pytest.raises(ConfigError, match=rf"^c\.yaml: {name}.*: got \".*; allowed: text (on|that)"):
        load_launching(Path("c.yaml"), SlurmConfig)


@pytest.mark.parametrize("command", COMMANDS)
def test_mistakes(here, refusal, command):
    (here / "c.yaml").write_text("{task: 3}")
    for words, message in cases(MISTAKES):
        assert refusal(f"{COMMANDS[command]} {words}").startswith(message)
