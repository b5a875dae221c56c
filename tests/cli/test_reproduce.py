"""`bojax reproduce`: which sweeps an id means, and one page over all of them."""

import builtins
import contextlib
import io
import os
import shutil
import signal
import time
from pathlib import Path

import pytest

from bojax.cli import background
from bojax.cli.main import main
from bojax.cli.parser import UsageError
from bojax.cli.reproducing import _newest, selected
from bojax.config.files import available
from bojax.config.sweep import load_sweep

SMALL = """\
base: {experiment: learning, env: chain, learner: {kind: epsilon-greedy}, episodes: 2, runs: 2}
report: {figures: [returns]}
claims:
- id: %s/higher
  source: Fig. 5.2, p. 100
  claim: the first is above the second
  test: {kind: order, column: last_return, by: variant, greater: [bold, timid]}
axes:
  learner:
    bold: {epsilon: 0.9}
    timid: {epsilon: 0.1}
"""


def test_all_is_every_sweep_with_claims_of_the_thesis_once():
    names = selected(["all"])
    assert len(set(names)) == len(names)
    assert set(names) == {
        name
        for name, path in available("sweeps").items()
        if load_sweep(name).claims
        and not name.startswith(("study-", "pomdp-"))
        and "alias:" not in path.read_text()
    }
    chapters = [name for chapter in ("chapter3", "chapter4", "chapter5") for name in selected([chapter])]
    assert sorted(chapters) == sorted(names)


def test_ids(refusal):
    for ids, names in (
        (["fig-4.6"], ["fig-4.6"]),
        (["fig-5.3"], ["fig-5.3-cliff", "fig-5.3-taxi"]),
        (["fig-5.2"], ["fig-5.2a", "fig-5.2b", "fig-5.2c", "fig-5.2d"]),
        (["table-5.1", "fig-5.3-taxi", "table-5.1"], ["table-5.1", "fig-5.3-taxi"]),
        (["study-jaco"], ["study-jaco"]),
        (["pomdp"], ["pomdp-lander", "pomdp-light-dark", "pomdp-sub-hunt", "pomdp-vdp-tag"]),
    ):
        assert selected(ids) == names
    for name in ("fig-4.66", "fig-", "chapter6", "", "parkin"):
        assert refusal(f"reproduce '{name}'").startswith(f"bojax reproduce: got {name}; allowed: ")


def test_a_folder_with_content_is_refused(here, refusal):
    for file in ("manifest.json", "reproduction.html", "notes.txt"):
        (here / file).mkdir()
        (here / file / file).write_text("")
        message = f"{file}: the folder is not empty; give another --out, or --resume a reproduction"
        assert refusal(f"reproduce fig-4.6 --out {file}") == message


def test_settings_and_a_folder_to_resume_that_is_not_there(here, refusal):
    assert refusal("reproduce fig-4.6 planner.iterations=3").endswith("bojax sweep changes settings")
    assert "no reproduction to resume" in refusal("reproduce fig-4.6 --resume")


def test_the_newest_unfinished_reproduction_of_these_sweeps_is_resumed(tmp_path):
    names = ["fig-9.1a", "fig-9.1b"]
    (tmp_path / "1" / "fig-9.1a").mkdir(parents=True)
    assert _newest(tmp_path, names).name == "1"  # its page may be missing
    (tmp_path / "0" / "fig-9.1b" / ".work").mkdir(parents=True)
    (tmp_path / "2" / "fig-4.6" / ".work").mkdir(parents=True)  # another figure
    (tmp_path / "3").mkdir()  # a page alone
    (tmp_path / "4.md").touch()
    assert _newest(tmp_path, names).name == "0"
    with pytest.raises(UsageError, match="no reproduction to resume"):
        _newest(tmp_path, ["fig-4.8"])


@pytest.fixture(autouse=True, scope="module")
def one_process():
    """One process writes all reports: each would import what draws them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(background, "PROCESSES", 1)
        yield


@pytest.fixture
def two(here):
    """Two small sweeps of a figure in the working directory."""
    return _with_two_sweeps(here)


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """A folder with two small sweeps of a figure and their finished reproduction, and what was printed."""
    folder = _with_two_sweeps(tmp_path_factory.mktemp("reproduced"))
    printed = io.StringIO()
    redirected = contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed)
    with contextlib.chdir(folder), redirected[0], redirected[1]:
        assert main(["reproduce", "fig-9.1", "--out", "out"]) == 0
    return folder, printed.getvalue()


def _with_two_sweeps(folder):
    (folder / "sweeps").mkdir()
    for name in ("fig-9.1a", "fig-9.1b"):
        (folder / "sweeps" / f"{name}.yaml").write_text(SMALL % name)
    return folder


def test_sweeps_of_a_figure_and_one_page(reproduced, monkeypatch, capfd):
    folder, printed = reproduced
    assert printed.splitlines()[-1] == "out/reproduction.html"
    assert "out/fig-9.1a: 1 claim: 0 reproduced, 0 not reproduced and 1 inconclusive\n" in printed
    for name in ("fig-9.1a", "fig-9.1b"):
        assert (folder / "out" / name / "report.html").is_file()
    text = (folder / "out" / "reproduction.md").read_text()
    assert "| command | `bojax reproduce fig-9.1` |" in text and "2 claims, tested by 2 sweeps" in text
    monkeypatch.chdir(folder)
    assert main(["reproduce", "fig-9.1", "--out", "out", "--resume"]) == 0
    assert "out/fig-9.1a: already finished" in capfd.readouterr().out


def test_a_page_on_published_results_of_others_does_not_speak_of_the_thesis(two, capfd):
    text = (SMALL % "pomdp-small").replace("Fig. 5.2, p. 100", "Somebody (2020)")
    (two / "sweeps" / "pomdp-small.yaml").write_text(text)
    assert main(["reproduce", "pomdp-small", "--out", "out"]) == 0
    capfd.readouterr()
    for page in ("reproduction.md", "reproduction.html", "reproduction/other.md", "reproduction/other.html"):
        text = (two / "out" / page).read_text()
        assert "the first is above the second" in text and "Somebody (2020)" in text
        assert (
            "thesis" not in text.partition("</style>")[2] if page.endswith("html") else "thesis" not in text
        )
    assert "# Reproduction of published results\n" in (two / "out" / "reproduction.md").read_text()
    assert "| source | claim | verdict | published | here |" in (two / "out" / "reproduction.md").read_text()


def test_ctrl_c_during_the_import_of_jax_is_not_lost(two, capfd, monkeypatch):
    """There, the KeyboardInterrupt may be raised in a callback, which discards it."""
    real = builtins.__import__

    def interrupt(name, *args, **kwargs):
        if name == "bojax.engine.run":
            os.kill(os.getpid(), signal.SIGINT)
            with contextlib.suppress(KeyboardInterrupt):
                time.sleep(0.3)
        return real(name, *args, **kwargs)

    monkeypatch.setattr("builtins.__import__", interrupt)
    assert main(["reproduce", "fig-9.1", "--out", "out"]) == 130
    assert capfd.readouterr().err == "interrupted\n" and not Path("out").exists()


def test_the_script_for_slurm_names_the_folders_of_the_results(two, capsys):
    assert main(["reproduce", "fig-9.1a", "--out", "out", "--launcher", "slurm", "--dry-run"]) == 0
    assert "out/fig-9.1a" in capsys.readouterr().out


def test_a_missing_report_is_an_error(reproduced, here, capfd):
    shutil.copytree(reproduced[0], here, dirs_exist_ok=True)
    (here / "out" / "fig-9.1a" / "report.html").unlink()
    (here / "out" / "fig-9.1a" / "report.html").mkdir()
    assert main(["reproduce", "fig-9.1", "--out", "out", "--resume"]) == 1
    error = capfd.readouterr().err
    assert "error: the report of out/fig-9.1a cannot be written" in error and "bojax report out/" in error
