"""The content of the manifest."""

from types import SimpleNamespace

import jax.numpy as jnp
import pytest

from bojax.config.errors import ConfigError
from bojax.config.sweep import load_sweep
from bojax.engine.sweep_run import outline_of
from bojax.results.outline import Outline
from bojax.results.store import read_manifest
from tests.engine.drive import plan_sweep


def test_settings_changed_from_the_published_sweep_are_stated(tmp_path):
    plan_sweep(load_sweep("parking", ["planner.iterations=7"]), tmp_path)
    assert [after for _, after in read_manifest(tmp_path)["changed"].values()] == [7]


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
