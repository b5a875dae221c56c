"""What groups take on a reference machine."""

import json

import pytest

from bojax.config.sweep import load_sweep
from bojax.engine import paces
from bojax.engine.chunks import Layout
from bojax.engine.forecast import COMPILATION
from bojax.engine.plan import plain

LAYOUT = Layout(queue=16, widths=(8,), repack=1)
SMALL = {"kind": "planning", "problem": {"kind": "parking", "max_steps": 5}, "planner": {"kind": "sbo"}}


@pytest.fixture
def known(tmp_path, monkeypatch):
    """A function that writes the file of the reference machines."""

    def write(content):
        file = tmp_path / "paces.json"
        file.write_text(content if isinstance(content, str) else json.dumps(content))
        monkeypatch.setattr(paces, "REFERENCE", file)
        paces._references.cache_clear()

    yield write
    paces._references.cache_clear()


def test_the_file_is_in_order():
    content = paces.REFERENCE.read_text()
    assert len(content) < 40_000
    for platform, kinds in json.loads(content).items():
        assert platform in ("cpu", "gpu")
        for kind, entries in kinds.items():
            assert kind and all(min(entry) > 0.0 for entry in entries)
            assert len({size for size, _, _ in entries}) == len(entries)


@pytest.mark.parametrize(
    ("name", "platform"),
    [("parking", "cpu"), ("fig-4.4", "gpu"), ("fig-5.2a", "cpu"), ("fig-5.7", "gpu")]
    + [
        (name, "cpu")
        for name in ("fig-3.7", "fig-5.8b", "table-5.3-lunar-lander", "table-5.3-cartpole-swing-up")
    ],
)
def test_sweeps_of_the_thesis_are_known(name, platform):
    for point in load_sweep(name).points:
        compilation, run = paces.reference(plain(point.config), platform, LAYOUT)
        assert 1.0 < compilation < 100.0 and run is not None and 1e-5 < run < 100.0


def test_the_nearest_size_counts_in_proportion(known):
    kind, size = paces.kind_and_size(SMALL)
    assert (kind, size) == ("planning sbo parking", 5)
    known({"cpu": {kind: [[5, 3.0, 0.1], [100, 4.0, 9.0]]}, "gpu": {kind: [[5, 30.0, 0.1]]}})
    for steps, expected in ((5, (3.0, 0.1)), (10, (3.0, 0.2)), (200, (4.0, 18.0))):
        config = SMALL | {"problem": {"kind": "parking", "max_steps": steps}}
        compilation, run = paces.reference(config, "cpu", LAYOUT)
        assert (compilation, run) == (
            expected[0],
            pytest.approx(expected[1] * paces.cost_of_run("cpu", 8, 16)),
        )


def test_a_run_costs_less_in_more_lanes_and_in_longer_queues():
    # Of 8 runs in 8 lanes, 1.5 times the time of a run; of 32, 4.5 times.
    assert paces.cost_of_run("cpu", 8, 32) / paces.cost_of_run("cpu", 8, 8) == pytest.approx(4.5 / 1.5 / 4)
    # A fixed cost, as of 100 lanes, is shared by the lanes.
    assert paces.cost_of_run("gpu", 50, 50) == pytest.approx(1.5 * (1.0 + 100 / 50))


@pytest.mark.parametrize("steps", ["many", None, 0, -3, True, [4]])
def test_any_config_has_a_size(steps):
    config = SMALL | {"problem": {"kind": "parking", "max_steps": steps}}
    assert paces.kind_and_size(config) == ("planning sbo parking", 1)


def test_other_kinds_are_compiled_as_long_as_the_median_one(known):
    known({"cpu": {"a": [[5, 3.0, 0.1]], "b": [[5, 7.0, 0.1]], "c": [[5, 4.0, 0.1]]}})
    assert paces.reference(SMALL, "cpu", LAYOUT) == (4.0, None)
    assert paces.reference({}, "tpu", LAYOUT) == (COMPILATION, None)


@pytest.mark.parametrize("content", ["", "{", "\0", "{}"])
def test_without_the_file_nothing_is_known(known, content):
    known(content)
    assert paces.reference(SMALL, "cpu", LAYOUT) == (COMPILATION, None)
    paces.REFERENCE.unlink()
    paces._references.cache_clear()
    assert paces.reference(SMALL, "cpu", LAYOUT) == (COMPILATION, None)
