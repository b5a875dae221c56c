"""A gallery shows every trajectory of a family, once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.experiments.trajectories import TrajectoryGallery
from bojax.motions.kernel_trajectories import KernelTrajectories
from bojax.results.schema import column_names
from tests.motions.families import all_paths, cubic, kernel, splines
from tests.motions.families import paths_of as family_paths

paths_of = jax.jit(lambda gallery: gallery.paths())

GALLERIES = [
    (splines(5), 3, 5),
    (cubic(), 4, 16),
    (kernel(), 2, 8),
]


@pytest.mark.parametrize("motions, levels, number", GALLERIES)
def test_a_gallery_has_every_path_of_its_family(motions, levels, number):
    gallery = TrajectoryGallery(motions, levels)
    carry = gallery.init(jax.random.key(0))
    [kept] = jax.jit(lambda gallery, carry: gallery.snapshot(carry))(gallery, carry).values()
    assert kept["paths"].shape == (number, 8, 3)
    assert len(np.unique(np.round(kept["paths"], 9), axis=0)) == number
    summary = jax.jit(lambda gallery, carry: gallery.summary(carry))(gallery, carry)
    assert summary["trajectories"] == number
    path = np.asarray(jax.jit(lambda motions, key: motions.sample(key))(motions, jax.random.key(0)))
    turns = np.diff(path[:, 2]) * 8 / float(motions.length)
    np.testing.assert_allclose(summary["curvature"], np.sqrt(np.mean(turns**2)), rtol=1e-9)
    np.testing.assert_allclose(summary["start_turn"], abs(path[0, 2]), rtol=1e-9)
    np.testing.assert_allclose(summary["end_turn"], abs(path[-1, 2]), rtol=1e-9)
    assert ("speed_by_time" in summary) == isinstance(motions, KernelTrajectories)
    assert set(summary) == set(column_names(gallery.tables["runs"]))  # `jit` sorts the keys


def test_a_gallery_of_a_set_is_the_set():
    gallery = TrajectoryGallery(splines(9), 3)
    np.testing.assert_allclose(paths_of(gallery), all_paths(splines(9)), atol=1e-14)


def test_a_gallery_of_a_continuous_family_spans_its_box():
    gallery = np.asarray(paths_of(TrajectoryGallery(cubic(), 3)))
    corners_and_centre = jnp.asarray([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 0.0]])
    for path in np.asarray(family_paths(cubic(), corners_and_centre)):
        assert np.abs(gallery - path).max(axis=(1, 2)).min() < 1e-12


def test_a_gallery_is_drawn_in_one_advance():
    gallery = TrajectoryGallery(splines(5), 1)
    carry = gallery.init(jax.random.key(0))
    assert not gallery.is_done(carry)
    carry, records = gallery.advance(carry)
    assert gallery.is_done(carry) and records.active_steps == gallery.max_advances == 1
    carry, records = gallery.advance(carry)
    assert gallery.is_done(carry) and records.active_steps == 0
    assert records.tables == {}
