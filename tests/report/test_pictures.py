"""The scripts of pictures/: the film of the README, figures of the site, and the gallery of all figures."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from bojax.config.sweep import load_config, load_sweep
from tests.report.synthetic import write_results

PICTURES = Path(__file__).parents[2] / "pictures"


def script(name):
    return runpy.run_path(str(PICTURES / f"{name}.py"))


def test_cars_drive_and_those_at_the_goal_are_counted():
    paths = {"emu-q": np.linspace([-0.5, -0.5], [0.5, 0.4], 25).T, "rff-q": np.full((2, 25), -0.5)}
    film = script("cars")["Cars"](paths, "cars")
    first, *_, last = film.images()
    assert film.num_images == len(list(film.images())) == 3
    assert first.size == (720, 270) and first.tobytes() != last.tobytes()


def test_a_figure_of_the_site_has_dark_colours(tmp_path):
    results = write_results(tmp_path / "results", runs=20)
    assert script("site")["main"]([str(results), "accumulated-reward", str(tmp_path / "figure.svg")]) == 0
    assert b"prefers-color-scheme: dark" in (tmp_path / "figure.svg").read_bytes()


@pytest.mark.parametrize("name", script("gallery")["SWEEPS"])
def test_sweeps_of_the_gallery_are_valid(name):
    config, settings = script("gallery")["SWEEPS"][name]
    overrides = [f"{key}={str(value).lower()}" for key, value in settings.items() if key != "runs"]
    is_sweep = "axes" in config or (isinstance(config, str) and config.startswith(("fig", "parking")))
    assert (load_sweep if is_sweep else load_config)(config, overrides, settings.get("runs")).points
