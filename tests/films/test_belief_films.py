"""Films and figures of state problems show the recorded states, step by step."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from bojax.films import beliefs
from bojax.films.choose import choose_film
from bojax.films.film import render, write_still
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.drawing.sketches import draw_step, set_stage, sketches
from bojax.report.figures.particles import particles
from bojax.report.source import load
from bojax.results.outline import Outline
from bojax.results.store import ResultsError
from tests.report.synthetic import write_folder

STEPS, ROOM, DRAWN = 4, 6, 16


def belief_results(folder, kind="light-dark", outline=None, recorded=True, num_steps=STEPS):
    """Two runs of one point: a state that moves by 1 a step, and a belief whose spread is halved."""
    size = 1 if kind == "light-dark" else 2
    spread = np.linspace(-1.0, 1.0, DRAWN)[:, None] * np.ones(size)
    rows = np.full((ROOM + 1, 1 + DRAWN, size), np.nan)
    for step in range(num_steps + 1):
        rows[step] = step + np.concatenate([np.zeros((1, size)), 3.0 * 0.5**step * spread])
    sketch = {"fixed": np.where(np.isnan(rows), np.nan, 2.0), "moving": rows}
    arrays = {f"0-{run}-sketch": sketch for run in (0, 1) if recorded}
    common = {"point": 0, "label": "pomcpow"}
    runs = [common | {"run": run, "return": -4.0, "steps": num_steps} for run in (0, 1)]
    steps = [{"step": step + 1, "accumulated_reward": -1.5 * (step + 1)} for step in range(num_steps)]
    tables = {"runs": runs, "steps": [common | {"run": run} | step for run in (0, 1) for step in steps]}
    config = {"kind": "planning", "problem": {"kind": kind}, "planner": {"kind": "pomcpow"}}
    point = {"index": 0, "label": "pomcpow", "variant": "pomcpow", "swept": {}, "config": config}
    if outline is not None:
        point["outline"] = outline
    return write_folder(folder, tables, [point], arrays)


@pytest.mark.parametrize("kind", ["light-dark", "vdp-tag"])
def test_a_film_has_a_picture_of_each_step(tmp_path, kind):
    results = load(belief_results(tmp_path / "results", kind, {"obstacles": [[1.0, 1.0, 2.0, 1.1]]}))
    film = choose_film(results, run=1)
    assert (film.name, film.num_images, film.seconds) == ("pomcpow-run1", STEPS + 1, 0.5)
    pictures = [np.asarray(image) for image in film.images()]
    assert len(pictures) == STEPS + 1
    for before, after in zip(pictures, pictures[1:], strict=False):
        assert np.any(before[70:] != after[70:])
    assert render(film, tmp_path / "animations")[0].stat().st_size < 200_000
    write_still(film, tmp_path / "still.png", 0.5)
    assert (tmp_path / "still.png").exists()


def test_films_tell_the_return_so_far(tmp_path, monkeypatch):
    film = choose_film(load(belief_results(tmp_path / "results")))
    texts = []
    monkeypatch.setattr(beliefs, "photograph", lambda figure: texts.append(figure.texts[1].get_text()))
    assert len(list(film.images())) == STEPS + 1
    assert texts[0] == "step 0 of 4, return so far 0" and texts[-1] == "step 4 of 4, return so far -6"


def test_the_belief_of_the_step_is_drawn(tmp_path):
    results = load(belief_results(tmp_path / "results", "vdp-tag"))
    point = results.points[0]
    sketch = sketches(results, point)[0]
    axes = Figure().add_subplot()
    set_stage(axes, sketch, point.outline)
    left, right = axes.get_xlim()
    assert left < -3.0 and right > 4.0 + 3.0 * 0.5**STEPS  # the extremes of all steps
    cloud, path, now = draw_step(axes, sketch, 2)[3:]  # after those of the fixed point
    np.testing.assert_allclose(cloud.get_offsets()[:, 0], 2.0 + 0.75 * np.linspace(-1.0, 1.0, DRAWN))
    np.testing.assert_allclose(cloud.get_sizes(), 3.2**2)
    np.testing.assert_allclose(path.get_xdata(), [0.0, 1.0, 2.0])
    assert (now.get_xdata()[0], now.get_ydata()[0]) == (2.0, 2.0)


@pytest.mark.parametrize("size", [1, 2])
def test_dots_show_the_shares_of_equal_states(size):
    belief = np.repeat([[0.0] * 60 + [1.0] * 4, [0.0] * 16 + [1.0] * 48], size).reshape(2, 64, size)
    rows = np.concatenate([np.zeros((2, 1, size)), belief], axis=1)
    axes = Figure().add_subplot()
    doubted, _, _, known, _, _ = draw_step(axes, {"doubted": rows, "known": np.zeros_like(rows)}, 1)
    np.testing.assert_allclose(doubted.get_offsets()[-2:, -1], [0.0, 1.0])
    areas = doubted.get_sizes()
    np.testing.assert_allclose(areas / areas[-1], [60 / 48, 4 / 48, 16 / 48, 1.0][-len(areas) :])
    np.testing.assert_allclose(known.get_sizes(), 3.2**2)
    assert areas.max() <= (4.0 * 3.2) ** 2


@pytest.mark.parametrize("kind, panels", [("light-dark", 1), ("vdp-tag", 4)])
def test_the_figure_shows_the_first_recorded_run(tmp_path, kind, panels):
    drawing = particles(load(belief_results(tmp_path / "results", kind)))
    titles = [axes.get_title() for axes in drawing.figure.axes]
    assert titles == ([""] if panels == 1 else ["step 0", "step 1", "step 3", "step 4"])
    assert (
        f"{DRAWN} states of the belief, equal ones as one larger dot. Run 0." in drawing.caption
        and "run 0, 4 steps" in drawing.alt
    )
    assert drawing.files["png"]


def test_the_figure_shows_each_step_of_a_short_episode_once(tmp_path):
    drawing = particles(load(belief_results(tmp_path / "results", "vdp-tag", num_steps=2)))
    assert [axes.get_title() for axes in drawing.figure.axes] == ["step 0", "step 1", "step 2"]


def test_what_was_not_recorded_is_not_drawn(tmp_path):
    results = load(belief_results(tmp_path / "results", recorded=False))
    with pytest.raises(FigureUnavailable, match="no recorded sketch"):
        particles(results)
    with pytest.raises(ResultsError, match="no sketch was recorded"):
        choose_film(results)
    shown = load(belief_results(tmp_path / "others"))
    with pytest.raises(ResultsError, match=r"--model: a state problem has no robot"):
        choose_film(shown, model=tmp_path)
    with pytest.raises(ResultsError, match="--episode"):
        choose_film(shown, episode=2)
    with pytest.raises(ResultsError, match="no steps of run 7"):
        choose_film(shown, run=7)


@pytest.mark.parametrize(("values", "whole"), [([0.0, 1.0, 1.0], True), ([0.0, 0.5, 1.0], False)])
def test_the_axis_of_whole_numbers_has_whole_ticks(values, whole):
    axes = Figure().add_subplot()
    set_stage(axes, {"state": np.array(values)[:, None, None]}, Outline())
    assert all(tick % 1.0 == 0.0 for tick in axes.get_yticks()) == whole
    assert axes.get_xticks().tolist() == [0, 1, 2]
