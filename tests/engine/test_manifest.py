"""The content of the manifest."""

from types import SimpleNamespace

import jax.numpy as jnp
import pytest

from bojax.config.errors import ConfigError
from bojax.config.sweep import load_sweep
from bojax.engine.chunks import Layout, cut
from bojax.engine.groups import static_groups
from bojax.engine.manifest import describe_groups, describe_sweep, outline_of
from bojax.results.chunk_folder import ChunkState
from bojax.results.outline import Outline
from tests.toy import toy, toy_sweep


def test_settings_changed_from_the_published_sweep_are_stated():
    sweep = load_sweep("parking", ["planner.iterations=7"])
    plan = {"runs": 2, "seed": 0, "record": {}, "config": {}, "points": []}
    manifest = describe_sweep(sweep, plan, [], "bojax sweep parking", "running")
    assert [after for _, after in manifest["changed"].values()] == [7]
    assert describe_sweep(toy_sweep(), plan, [], "bojax sweep toy", "running")["changed"] == {}


def test_seconds_and_steps_of_a_group_are_those_of_its_chunks():
    groups = static_groups([toy(), toy(max_length=15)])
    chunks = [chunk for group in groups for chunk in cut(group, range(4), Layout(2, (2,), 1), [{}, {}], {})]
    segments = [[[2, 10, 0.5], [2, 6, 0.25]], [[2, 1, 1.0]], [], []]
    states = [(chunk, ChunkState(segments=each)) for chunk, each in zip(chunks, segments, strict=True)]
    first, second = describe_groups([{"name": "a"}, {"name": "b"}], states)
    assert first == {"group": 0, "name": "a", "run_seconds": 1.75, "active_steps": 17}
    assert second == {"group": 1, "name": "b", "run_seconds": 0.0, "active_steps": 0}


def experiment(outline):
    """An experiment whose problem has this method."""
    return SimpleNamespace(problem=SimpleNamespace(outline=outline))


def test_a_declared_outline_is_written_as_plain_numbers():
    disc = (jnp.zeros(()), 0.0, jnp.asarray(0.5))
    declared = outline_of(experiment(lambda: Outline(goals=[disc])))
    assert declared == {"outline": Outline(goals=[[0.0, 0.0, 0.5]]).as_numbers()}
    assert outline_of(experiment(lambda: None)) == {} == outline_of(SimpleNamespace())


@pytest.mark.parametrize("outline", [lambda: Outline(obstacles=[(1.0, 2.0)]), lambda: 3, lambda: 1 / 0])
def test_an_outline_that_is_none_is_refused_in_a_line(outline):
    with pytest.raises(ConfigError, match=r"^SimpleNamespace\.outline: .+$"):
        outline_of(experiment(outline))
