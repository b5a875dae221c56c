"""The slow tier: claims of the thesis that quick sweeps reproduce, and runs that do not depend on others."""

import json

import numpy as np
import pytest

from bojax.cli.main import main
from bojax.results.store import read_table
from tests.examples.pages import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("usual_jax")]

RUNS = 30
CLAIMS = {
    "fig-5.2a": ["values-stay", "additive-drops", "order"],
    "table-5.3-mountain-car": ["emu-q-success", "similar"],
    "fig-4.6": ["order-thesis-settings", "kcbts-parks", "random-never-parks", "random-leaves"],
}
"""Claims of sweeps for which so many runs are enough."""


@pytest.mark.parametrize("name", CLAIMS)
def test_claims_are_reproduced(name, tmp_path):
    words = [str(ROOT / "sweeps" / f"{name}.yaml"), "engine.latency=false", "--out", str(tmp_path)]
    assert main(["sweep", *words, "--runs", str(RUNS)]) == 0
    claims = json.loads((tmp_path / "claims.json").read_text())
    verdicts = {claim["id"].split("/")[1]: claim["verdict"] for claim in claims}
    assert {claim: verdicts[claim] for claim in CLAIMS[name]} == dict.fromkeys(CLAIMS[name], "reproduced")


def test_the_first_runs_of_many_are_those_of_few(tmp_path):
    tables = {}
    for runs in (4, 10):
        words = ["run", "parking", "engine.lanes_per_device=4", "engine.latency=false", "--runs", str(runs)]
        assert main([*words, "--out", str(tmp_path / str(runs))]) == 0
        tables[runs] = read_table(tmp_path / str(runs) / "runs.parquet").slice(0, 4)
    assert tables[4].equals(tables[10])
    assert len(np.unique(tables[4]["return"])) > 1
