"""The figure of swept settings: best and mean over all others at each value."""

import numpy as np
import pytest

from bojax.report.drawing.base import FigureUnavailable
from bojax.report.drawing.curves import Curve
from bojax.report.figures.grids import _short, curves_and_panels, marginals
from bojax.report.figures.sweeps import readable
from bojax.report.source import distinct_names, short_value, swept_values
from bojax.report.text import plain
from tests.report.synthetic import point_of


def grid():
    points = []
    for variant in ("a", "b"):
        for kappa in (1.0, 10.0):
            for depth in (2, 3):
                swept = {"planner": variant, "planner.kappa": kappa, "planner.depth": depth}
                points.append(point_of(len(points), "sbo", variant, swept))
    return points


def test_marginals_are_the_best_and_the_mean_over_all_other_settings():
    points = grid()
    means = np.arange(8.0)  # a: kappa 1 -> 0, 1; kappa 10 -> 2, 3; b: 4..7
    best, mean = marginals(points[4:], means[4:], "planner.kappa", [1.0, 10.0])
    np.testing.assert_array_equal(best, [5.0, 7.0])
    np.testing.assert_array_equal(mean, [4.5, 6.5])


def test_named_axes_are_curves_and_lists_are_panels():
    points = grid()
    variants = [point.variant for point in points]
    assert curves_and_panels(points) == (variants, ["planner.kappa", "planner.depth"])
    assert swept_values(points, "planner.depth") == [2, 3]


def test_of_many_named_points_the_last_names_are_a_panel():
    swept = [
        {"planner": f"p-{i}", "problem.walls": f"w-{j}", "planner.kappa": kappa}
        for i in range(5)
        for j in range(3)
        for kappa in (1.0, 2.0)
    ]
    points = [
        point_of(index, "sbo", f"{each['planner']}/{each['problem.walls']}", each)
        for index, each in enumerate(swept)
    ]
    curves, panels = curves_and_panels(points)
    assert curves == [each["planner"] for each in swept]
    assert panels == ["problem.walls", "planner.kappa"]
    few = [point for point in points if point.swept["planner"] in ("p-0", "p-1")]
    assert len(set(curves_and_panels(few)[0])) == 6


def test_a_sweep_of_names_alone_has_no_such_figure():
    points = [point_of(0, "sbo", "a", {"planner": "a"})]
    with pytest.raises(FigureUnavailable, match="no list"):
        curves_and_panels(points)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.35, "0.35"), (3000.0, "3k"), (17, "17"), (True, "true"), (None, "none"), ("my:Puck", "my:Puck")],
)
def test_values_are_short_enough_for_an_axis(value, text):
    assert _short(value) == text


def test_a_list_is_told_by_its_number_in_the_sweep():
    points = [point_of(i, "sbo", "a", {"walls": [[i, 0.5]], "length": 2.0}) for i in range(2)]
    assert distinct_names(points) == ["a, walls no. 1", "a, walls no. 2"]
    assert short_value(points, "length", 2.0) == 2.0


def test_a_vector_of_few_numbers_is_told_as_it_is():
    points = [point_of(i, "sbo", "a", {"wind": [0.4, -i / 3], "five": [i] * 5}) for i in range(2)]
    assert distinct_names(points) == ["a, wind (0.4, 0), five no. 1", "a, wind (0.4, -0.333333), five no. 2"]


@pytest.mark.parametrize(("is_least", "kept", "word"), [(False, 12, "greatest"), (True, 0, "least")])
def test_of_many_curves_the_best_of_each_label_is_drawn(is_least, kept, word):
    values = np.zeros((4, 2))
    curves = [
        Curve(point_of(i, "sbo" if i < 13 else "random", f"v-{i}"), np.arange(2.0), values + i)
        for i in range(14)
    ]
    assert readable(curves[:12], is_least=is_least) == (curves[:12], "")
    found, note = readable(curves, is_least=is_least)
    assert found == [curves[kept], curves[13]]
    assert note == f" Of 14 settings, the one with the {word} mean of each label is drawn."


@pytest.mark.parametrize(("value", "text"), [([], "[]"), ([1.0, 2], "1, 2"), (None, "none"), (True, "true")])
def test_settings_are_never_empty_cells(value, text):
    assert plain(value) == text
