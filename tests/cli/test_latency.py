"""`bojax bench latency`: measures single runs, for claims about the time of an advance."""

import json

import pytest

from bojax.cli.main import main
from bojax.config.sweep import load_sweep
from bojax.report.build import build_report
from tests.engine.drive import run_sweep

TEST = {"kind": "latency", "labels": ["epsilon-greedy"], "below": 60.0}
SWEEP = {
    "base": {"experiment": "learning", "env": {"kind": "chain", "length": 4, "max_length": 4}, "episodes": 2},
    "axes": {"learner": ["additive", "epsilon-greedy"]},
    "runs": 2,
    "record": {"runs": 0},
    "claims": [{"id": "quick", "claim": "it is quick", "source": "here", "test": TEST}],
}


def test_claims_read_the_latency_in_the_results_folder(tmp_path, capsys):
    folder = tmp_path / "toy"
    assert run_sweep(load_sweep(SWEEP), folder) == 0
    build_report(folder)
    assert claim(folder)["verdict"] == "inconclusive"
    assert main(["bench", "latency", str(folder)]) == 0
    assert f"to judge claims: bojax report {folder}" in capsys.readouterr().out
    build_report(folder)
    assert claim(folder)["verdict"] == "reproduced"
    seconds = json.loads((folder / "latency.json").read_text())["seconds"]
    assert claim(folder)["ours"] == pytest.approx(seconds["1"][0])
    for median, least, largest in seconds.values():
        assert 0 < least <= median <= largest
    assert list(seconds) == ["0", "1"]


def claim(folder):
    return json.loads((folder / "claims.json").read_text())[0]
