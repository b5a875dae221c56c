"""The model of a field: learned from an earlier survey, or assumed."""

import jax
import numpy as np
import pytest

pytest.importorskip("shapely")

from bojax.areas.place import read_place  # noqa: E402
from bojax.surveys import model  # noqa: E402
from bojax.surveys.model import assumed_model, learned_model  # noqa: E402


def test_hyper_parameters_of_a_sampled_field_are_recovered(tmp_path, monkeypatch):
    lengthscale, std, noise = 60.0, 2.0, 0.2
    random = np.random.default_rng(3)
    points = random.uniform(0.0, 1000.0, (250, 2))
    scaled = np.sqrt(5.0) * np.linalg.norm(points[:, None] - points, axis=2) / lengthscale
    covariance = std**2 * (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
    values = np.linalg.cholesky(covariance + noise**2 * np.eye(250)) @ random.normal(size=250)
    file = str(tmp_path / "pilot.csv")
    np.savetxt(file, np.column_stack([points, 50.0 + values]), delimiter=";", header="x;y;depth", comments="")
    with jax.enable_x64(True):
        learned = learned_model(file, read_place("1kmx1km"), None)
        # Another prior compiles the learning anew, and what it finds is not looked at.
        monkeypatch.setattr(model, "relearn", lambda gp, key, **_: (gp.with_constant_mean(), None))
        given = learned_model(file, read_place("1kmx1km"), 80.0)
    assert learned.lengthscale == pytest.approx(lengthscale, rel=0.3)
    assert learned.std == pytest.approx(std, rel=0.3)
    assert given.lengthscale == 80.0


def test_without_data_the_lengthscale_is_a_tenth_of_the_root_of_the_area():
    assert assumed_model(1e6, None).lengthscale == pytest.approx(100.0)
    assert assumed_model(1e6, 30.0).lengthscale == 30.0
