"""`bojax best` prints a config that runs, and confirms its score with fresh runs."""

import pytest
import yaml

from bojax.cli.main import main
from bojax.config.sweep import load_config
from bojax.report.ranking import Measure, best_of
from bojax.report.source import load
from tests.report.synthetic import write_learning, write_results
from tests.transcript import cases


@pytest.fixture
def folder(here):
    return write_results(here / "made-up")


def test_it_prints_the_config_of_the_best_point(folder, capsys):
    assert main(["best", "made-up"]) == 0
    out, err = capsys.readouterr()
    comments = [line for line in out.splitlines() if line.startswith("#")]
    assert comments[0] == "# kcbts, the best of 5 points in made-up" and err == ""
    assert comments[1].startswith("# mean return: ") and "40 runs; chosen by these same runs" in comments[1]
    sweep = load_config(yaml.safe_load(out))
    assert (sweep.points[0].label, sweep.runs, sweep.seed) == ("kcbts", 40, 1)


def test_another_column_and_a_minus_sign_choose_another_point(folder, capsys):
    assert main(["best", "made-up", "--by=-return"]) == 0
    out = capsys.readouterr().out
    worst = best_of(load(folder), Measure("return", is_least=True)).point
    assert out.startswith(f"# {worst.name}, ") and worst.label != "kcbts"


MISTAKES = """\
nowhere
=> nowhere: no such results folder
made-up --by ''
=> --by: got ""; allowed: a column
made-up --by retrun
=> runs.parquet: unknown column retrun; allowed: exits, return
made-up --out x
=> bojax best: --out and --resume: allowed only with --confirm
made-up --confirm 0
=> --confirm: got 0; allowed: >= 1
"""


def test_mistakes(folder, capsys, refusal):
    nothing = "", "the following arguments are required: DIR"
    for words, message in [nothing, *cases(MISTAKES)]:
        assert refusal(f"best {words}").startswith(message)
    assert main("best made-up --confirm 1 --out made-up".split()) == 2  # after the config, which is printed
    assert capsys.readouterr().err.startswith("error: made-up: the folder is not empty")


def test_a_module_that_the_folder_names_is_announced(folder, capsys):
    (folder.parent / "their_planner.py").write_text("raise ValueError('imported')")
    manifest = folder / "manifest.json"
    manifest.write_text(manifest.read_text().replace('{"kind": "kcbts"', '{"kind": "their_planner:Mine"'))
    assert main(["best", "made-up"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["best", "made-up", "--confirm", "1"]) == 2
    announced, error = capsys.readouterr().err.splitlines()
    place = "made-up/manifest.json: points.0.config.planner.kind"
    assert announced == f"importing their_planner ({folder.parent}/their_planner.py), named in {place}"
    assert error.startswith(f'error: {place}: got "their_planner:Mine"; importing their_planner failed')


def test_fresh_runs_confirm_the_score(here, capfd):
    made_up = write_learning(here / "made-up", runs=3, episodes=2)
    manifest = made_up / "manifest.json"
    chain = '"env": {"kind": "chain", "length": 3, "max_length": 3, "max_steps": 30}'
    text = manifest.read_text().replace('"env": {"kind": "mountain-car"}', chain)
    manifest.write_text(text.replace('"learner": {"kind": "emu-q"}', '"learner": {"kind": "additive"}'))
    assert main(["best", "made-up", "--confirm", "4"]) == 0
    out = capfd.readouterr().out.splitlines()
    fresh = load(next(here.glob("results/car-best/*")))
    assert fresh.runs["run"].tolist() == [0, 1, 2, 3] and fresh.manifest.seed == 1
    assert out[-1].startswith("mean steps to goal, or to the end of the longest run: ")
    assert out[-1].endswith("4 runs")
