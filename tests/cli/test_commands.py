"""The commands `run`, `sweep`, `report`, `bench` and `doctor`: calls made, exit codes, output."""

from pathlib import Path

import jax
import pytest

from bojax.cli import doctor
from bojax.cli.main import main
from bojax.config.component import External

FOLDER = Path("results/parking/20260101-000000")
"""The folder chosen by the engine."""


@pytest.fixture
def calls(here, monkeypatch):
    """Calls of the engine and of the report, which do nothing but return what `codes` says."""
    made: list[tuple] = []
    codes: dict[str, int] = {}

    def run_sweeps(requests, resume, command, finish, launcher, indices, planned):
        assert launcher is None and indices is None
        for request in requests:
            made.append(("run", request.sweep, request.out, resume, command))
            if request.sweep.name not in codes:
                finish(request.out or FOLDER)
        return max(codes.values(), default=0)

    def build_report(folder, watch):
        made.append(("report", folder))
        return folder / "report.html"

    monkeypatch.setattr("bojax.engine.run.run_sweeps", run_sweeps)
    monkeypatch.setattr("bojax.report.progress.build_report", build_report)
    return made, codes


def test_a_sweep_runs_and_is_reported(calls, capsys):
    made, _ = calls
    assert main(["sweep", "parking", "problem.half_width=3", "--runs", "5", "--seed", "7"]) == 0
    (_, sweep, out, resume, command), report = made
    assert (sweep.name, sweep.runs, sweep.seed) == ("parking", 5, 7)
    assert out is None and resume is False
    assert command == "bojax sweep parking problem.half_width=3 --runs 5 --seed 7".split()
    assert report == ("report", FOLDER)
    assert capsys.readouterr().out == f"{FOLDER}/report.html\n"


def test_a_config_runs(calls):
    made, _ = calls
    assert main(["run", "planner=sbo", "parking", "--out", "mine", "planner.depth=2"]) == 0
    _, sweep, out, _, _ = made[0]
    assert out == Path("mine") and sweep.points[0].config.planner.depth == 2


@pytest.mark.parametrize("command", ["run", "sweep"])
def test_random_actions_are_run_beside_a_config_and_before_its_report(calls, command, monkeypatch):
    made, _ = calls
    monkeypatch.setattr("bojax.engine.baseline.write_baseline", lambda sweep, _: made.append(sweep.name))
    assert main([command, "point-maze" if command == "run" else "study-point-maze"]) == 0
    names = [each if isinstance(each, str) else each[0] for each in made]
    assert names == (["run", "point-maze", "report"] if command == "run" else ["run", "report"])


def test_several_sweeps_get_folders_of_their_own(calls):
    made, codes = calls
    codes |= {"fig-4.2": 0, "fig-4.6": 0}  # without reports, which other processes would write
    assert main(["sweep", "fig-4.2", "fig-4.6", "--out", "both"]) == 0
    assert [call[2] for call in made if call[0] == "run"] == [Path("both/fig-4.2"), Path("both/fig-4.6")]


def test_the_exit_code_is_that_of_the_engine(calls):
    made, codes = calls
    codes["fig-4.2"] = 143
    assert main(["sweep", "fig-4.2", "fig-4.6"]) == 143
    assert [call[0] for call in made] == ["run", "run"]


def test_an_existing_folder_is_not_touched(here, refusal):
    (here / "mine").mkdir()
    (here / "mine" / "notes.txt").write_text("precious")
    error = refusal("run parking --out mine")
    assert error.startswith("mine: ") and "is not empty" in error
    assert (here / "mine" / "notes.txt").read_text() == "precious"


def test_a_name_that_is_too_long_for_a_folder(here, capsys):
    long = "x" * 300
    for resume, told in (([], []), (["--resume"], [f"note: nothing to resume; starting anew: {long}"])):
        assert main(["run", "chain", "episodes=1", "--runs", "1", "--out", long, *resume]) == 2
        *notes, error = capsys.readouterr().err.splitlines()
        assert notes == told and "File name too long" in error and not list(here.iterdir())


def test_a_part_of_the_users_own_is_resolved_before_the_engine_sees_it(calls, tmp_path):
    made, _ = calls
    (tmp_path / "own_kernels.py").write_text(
        "import equinox as eqx\n"
        "from jaxtyping import Array, Float\n"
        "from bojax.models.kernels import Kernel\n"
        "class Mine(Kernel):\n"
        "    lengthscale: Float[Array, ''] = 2.0\n"
        "    def __call__(self, x, y):\n"
        "        return self.lengthscale\n"
    )
    assert main(["run", "parking", "planner.kernel=own_kernels:Mine"]) == 0
    kernel = made[0][1].points[0].config.planner.kernel
    assert not isinstance(kernel, External) and kernel.lengthscale == 2.0


def test_report_takes_folders(calls, capsys):
    made, _ = calls
    assert main(["report", "a", "b"]) == 0
    assert made == [("report", Path("a")), ("report", Path("b"))]
    assert capsys.readouterr().out == "a/report.html\nb/report.html\n"


def test_benchmarks_are_modules_with_a_main(here, monkeypatch, capsys, refusal):
    monkeypatch.setattr("bojax.cli.bench.shipped", lambda folder: here / folder)
    assert refusal("bench").startswith("no benchmarks found; run this command in a clone of ")
    (here / "benchmarks").mkdir()
    for name, code in (("one", 0), ("two_words", 3)):
        path = here / "benchmarks" / f"bench_{name}.py"
        path.write_text(f"def main(argv):\n    print('{name}', argv)\n    return {code}\n")
    for words, code, output in (
        ("bench one", 0, "one []\n"),
        ("bench two-words", 3, "two_words []\n"),
        ("bench one results/a b", 0, "one ['results/a', 'b']\n"),
        ("bench", 3, "benchmarks: one, two-words\none []\ntwo_words []\n"),
    ):
        assert main(words.split()) == code
        assert capsys.readouterr().out == output
    message = "unknown benchmark two-word; allowed: one, two-words; did you mean"
    assert message in refusal("bench two-word")


class TestDoctor:
    """Every check ends in a line."""

    def test_this_machine(self, here, capsys):
        assert main(["doctor"]) == 0
        out = capsys.readouterr().out
        assert "jaxlib" in out and jax.devices()[0].platform in out and "float64" in out
        assert out.endswith("all checks passed\n")
        assert list(here.iterdir()) == []

    def test_a_failure_is_a_line_and_an_exit_code(self, monkeypatch, capsys):
        def fail():
            yield doctor.Finding("ok", "half of it")
            raise ValueError("broken\nin two")

        monkeypatch.setattr(doctor, "CHECKS", {"devices": fail})
        assert main(["doctor"]) == 1
        assert capsys.readouterr().out.splitlines() == [
            "ok      devices       half of it",
            "FAILED  devices       ValueError: broken in two",
            "",
            "1 of 2 checks failed",
        ]

    def test_it_says_what_a_missing_package_is_for(self, monkeypatch):
        lacks = ("ray", "wandb")
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name in lacks else name)
        installed, *missing = doctor.examine(doctor.CHECKS["extras"])
        assert installed.state == "ok" and "gym (environments of Gymnasium)" in installed.text
        advice = "is not installed; install it in a clone of bojax: pip install -e"
        assert [(finding.state, finding.text) for finding in missing] == [
            ("note", f"--launcher ray: ray {advice} '.[ray]'"),
            ("note", f"bojax export --to wandb: wandb {advice} '.[wandb]'"),
        ]

    def test_a_folder_that_cannot_be_written(self, here, monkeypatch):

        def refuse(**_):
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr("tempfile.NamedTemporaryFile", refuse)
        (finding,) = doctor.examine(doctor.CHECKS["results"])
        assert finding.state == "FAILED" and finding.text.endswith("cannot be written: Permission denied")
