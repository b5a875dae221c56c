"""The slow tier: claims of the thesis that quick sweeps reproduce, and runs that do not depend on others."""

import json

import numpy as np
import pytest

from bojax.cli.main import main
from bojax.config.files import available
from bojax.config.points import Sweep
from bojax.config.sweep import load_sweep
from bojax.results.store import read_table
from tests.examples.pages import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("usual_jax")]

CLAIMS = {
    "fig-5.2a": (30, ["values-stay", "additive-drops", "order"]),
    "table-5.3-mountain-car": (20, ["emu-q-success", "rff-q-success", "rff-q-episodes", "similar"]),
    "fig-4.6": (200, ["kcbts-parks-anywhere-bearing-dropped", "kcbts-falls-active", "random-leaves"]),
}
"""For each sweep a number of runs, and claims that so many runs reproduce."""


@pytest.mark.minutes
@pytest.mark.parametrize("name", CLAIMS)
def test_claims_are_reproduced(name, tmp_path):
    runs, expected = CLAIMS[name]
    words = [str(ROOT / "sweeps" / f"{name}.yaml"), "--out", str(tmp_path)]
    assert main(["sweep", *words, "--runs", str(runs)]) == 0
    claims = json.loads((tmp_path / "claims.json").read_text())
    verdicts = {claim["id"].split("/")[1]: claim["verdict"] for claim in claims}
    assert {claim: verdicts[claim] for claim in expected} == dict.fromkeys(expected, "reproduced")


@pytest.mark.parametrize("name", [name for name in available("sweeps") if name.startswith("study-")])
def test_every_study_runs(name, tmp_path):
    """Two short runs of every point; settings that the study sweeps keep their values."""
    sweep = load_sweep(str(ROOT / "sweeps" / f"{name}.yaml"))
    short = {f"problem.{_inner(sweep, 'problem')}max_steps": 2}
    if any(hasattr(getattr(point.config, "planner", None), "iterations") for point in sweep.points):
        short["planner.iterations"] = 2
    if sweep.base["experiment"] == "learning":
        short = {"episodes": 1, "tests": 1, f"env.{_inner(sweep, 'env')}max_steps": 20}
    if any(hasattr(getattr(point.config, "env", None), "physics") for point in sweep.points):
        short["env.physics.impl"] = "c"  # MJX in JAX takes longer to compile, and has tests of its own
    words = [f"{key}={value}" for key, value in short.items() if key not in sweep.points[0].swept]
    assert main(["sweep", str(sweep.source), *words, "--runs", "2", "--out", str(tmp_path)]) == 0
    assert len(read_table(tmp_path / "runs.parquet")) == 2 * len(sweep.points)


def _inner(sweep: Sweep, part: str) -> str:
    """`problem.` where a problem or an environment is made from another problem, which has the time limit."""
    return "problem." if hasattr(getattr(sweep.points[0].config, part, None), "problem") else ""


def test_the_first_runs_of_many_are_those_of_few(tmp_path):
    tables = {}
    for runs in (4, 10):
        words = ["run", "parking", "engine.lanes_per_device=4", "--runs", str(runs)]
        assert main([*words, "--out", str(tmp_path / str(runs))]) == 0
        tables[runs] = read_table(tmp_path / str(runs) / "runs.parquet").slice(0, 4)
    assert tables[4].equals(tables[10])
    assert len(np.unique(tables[4]["return"])) > 1
