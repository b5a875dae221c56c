import logging

import matplotlib
import numpy as np
import pytest

from bojax.report import style, text
from bojax.report.drawing.curves import step_ticks
from bojax.report.drawing.smooth import smooth
from bojax.report.figures.returns import swarm
from tests.report.synthetic import point_of


def test_a_notebook_keeps_its_backend(monkeypatch):
    monkeypatch.setitem(matplotlib.rcParams, "backend", "svg")
    with style.settings():
        png = style.encode(style.figure(1.0)[0])["png"]
    assert png.startswith(b"\x89PNG") and matplotlib.get_backend() == "svg"


def test_labels_are_spread_no_further_than_needed():
    places = style.spread([0.0, 0.1, 5.0, 0.05], 1.0, -10.0, 10.0)
    order = np.argsort(places)
    np.testing.assert_array_equal(order, [0, 3, 1, 2])
    assert (np.diff(np.asarray(places)[order]) >= 1.0 - 1e-9).all()
    assert places[2] == 5.0
    assert np.mean([places[0], places[3], places[1]]) == pytest.approx(0.05)


def test_labels_stay_within_bounds_that_fit_them():
    assert style.spread([9.9, 10.0], 1.0, 0.0, 10.0) == pytest.approx([9.0, 10.0])
    assert style.spread([0.0, 0.0], 1.0, 0.0, 10.0) == pytest.approx([0.0, 1.0])


def test_a_known_identifier_has_one_colour_and_unknown_ones_take_the_rest():
    assert style.colour("kcbts", ["mine", "kcbts"]) == style.colour("kcbts", ["kcbts"]) == style.BLUE
    labels = ["kcbts", "mine", "yours"]
    assert len({style.colour(label, labels) for label in labels}) == 3


def test_more_labels_than_colours_do_not_look_alike():
    points = [point_of(number, f"agent {number}", f"agent {number}") for number in range(20)]
    looks = [tuple(look.values()) for look in style.looks(points)]
    assert len(set(looks)) == len(looks)


def test_step_ticks_are_even_and_reach_the_end():
    for last, step in ((1, 1), (5, 1), (15, 3), (50, 10), (2**53, 2 * 10**15)):
        assert step_ticks(last) == list(range(0, last + 1, step))


def test_a_swarm_stacks_what_falls_into_one_bin():
    dots, offsets = swarm(np.array([0.1, 0.2, 5.0]), np.linspace(0, 10, 11))
    np.testing.assert_allclose(dots, [0.5, 0.5, 5.5])
    np.testing.assert_allclose(offsets, [-0.035, 0.035, 0.0])


def test_numbers_keep_three_digits_and_time_spans_have_a_fitting_unit():
    values = {0.0: "0", 0.01234: "0.0123", 569.6: "570", -1523.4: "-1,523", None: "–", float("nan"): "–"}
    assert [text.number(value) for value in values] == [*values.values()]
    spans = {4.2e-5: "42.0 µs", 0.0123: "12.3 ms", 7.25: "7.25 s", 150: "2 min 30 s"}
    assert [text.seconds(value) for value in spans] == [*spans.values()]


def test_an_estimate_has_the_decimals_that_its_interval_allows():
    assert text.with_bounds(569.62, 531.9, 611.3) == ("570", "[532, 611]")
    assert text.with_bounds(4.9721, 4.84, 5.09) == ("4.97", "[4.84, 5.09]")
    assert text.with_bounds(-0.2, -40.0, 41.0) == ("0", "[-40, 41]")
    assert text.with_bounds(17.0, 17.0, 17.0) == ("17", "[17, 17]")


def test_a_smooth_curve_follows_an_arc_through_its_poses():
    angle = np.linspace(0.0, 2.0, 9)[1:]
    poses = np.stack([np.sin(angle), 1 - np.cos(angle), angle], axis=1)
    curve = smooth(np.zeros(3), poses)
    np.testing.assert_allclose(curve[8::8], poses[:, :2], atol=1e-12)
    np.testing.assert_allclose(np.hypot(curve[:, 0], curve[:, 1] - 1), 1.0, atol=2e-3)


def test_a_curve_in_reverse_has_no_loops():
    x = -np.linspace(0.0, 1.0, 5)[1:]
    curve = smooth(np.zeros(3), np.stack([x, 0 * x, 0 * x], axis=1))
    assert (np.diff(curve[:, 0]) < 0).all() and (curve[:, 1] == 0).all()


def test_fallback_fonts_of_other_weights_are_no_messages():
    logger = logging.getLogger("matplotlib.font_manager")
    with style.settings():
        assert not logger.isEnabledFor(logging.WARNING)
    assert logger.isEnabledFor(logging.WARNING)


def test_a_long_word_is_broken_where_it_has_parts():
    for width, lines in (
        (16, ["emu-q, state_", "lengthscale 0.2"]),
        (26, ["learner.features.", "state_lengthscale"]),
        (14, ["discrete/", "pomcpow"]),
        (16, ["kcbts"]),
        (16, ["a" * 16, "a" * 4]),
    ):
        assert style.wrapped("".join(lines), width).split("\n") == lines


def test_a_list_of_names_with_commas_has_semicolons():
    assert text.joined(["a", "b", "c"]) == "a, b and c"
    assert text.joined(["emu-q, kappa 1", "emu-q, kappa 2"]) == "emu-q, kappa 1; emu-q, kappa 2"
    assert text.joined(["emu-q, kappa 1"]) == "emu-q, kappa 1"
