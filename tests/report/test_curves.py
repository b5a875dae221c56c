"""The drawer of curves: missing data, names and words, whatever the figure."""

import numpy as np
import pytest

from bojax.report import style
from bojax.report.drawing.base import Undrawable
from bojax.report.drawing.curves import Chart, Curve, Panel
from tests.report.synthetic import point_of


def curve(name, values, first=1.0):
    values = np.asarray(values, dtype=np.float64)
    return Curve(point_of(0, name, name), first + np.arange(values.shape[1]), values)


def chart(*panels, xlabel="episode", **options):
    with style.settings():
        return Chart(panels, xlabel, **options)


def drawing(*panels, **options):
    with style.settings():
        return Chart(panels, "episode", **options).drawing("Title")


RISING = curve("a", [[0, 1, 2], [0, 3, 4]])
EMPTY = curve("b", np.full((2, 3), np.nan))


def test_a_curve_is_the_mean_of_its_runs():
    (axes,) = chart(Panel("reward", "mean reward", [RISING])).axes
    np.testing.assert_array_equal(np.asarray(axes.get_lines()[0].get_ydata()), [0, 2, 3])
    np.testing.assert_array_equal(np.asarray(axes.get_lines()[0].get_xdata()), [1, 2, 3])


def test_words_name_the_quantity_the_runs_the_bands_and_the_ends():
    drawn = drawing(Panel("reward", "mean reward", [RISING]))
    assert drawn.caption == ("Mean reward, with pointwise 95% bootstrap bands. By episode, 2 runs per curve.")
    assert drawn.alt == (
        "Line chart of the mean reward, by episode. First and last value of each curve: a 0 and 3.00."
    )


def test_two_panels_are_told_apart():
    share = Panel(
        "successes (%)", "share of runs that succeed", [curve("a", [[0, 1], [0, 0]])], is_share=True
    )
    caption = drawing(Panel("reward", "mean reward", [RISING]), share).caption
    assert caption == (
        "Above: mean reward, with pointwise 95% bootstrap bands. Below: share of runs that succeed, with "
        "pointwise 95% Wilson bands. By episode, 2 runs per curve."
    )


def test_a_curve_without_values_is_not_drawn_but_told():
    drawn = drawing(Panel("reward", "mean reward", [EMPTY, RISING]))
    assert drawn.caption.endswith("Without a value: b.")
    assert [text.get_text() for text in drawn.figure.axes[0].texts] == ["a"]


def test_a_curve_has_the_colour_of_its_setting_whichever_others_have_values():
    absent = curve("0", np.full((2, 3), np.nan))
    lines = chart(Panel("reward", "mean reward", [absent, RISING])).axes[0].get_lines()
    alone = chart(Panel("reward", "mean reward", [RISING])).axes[0].get_lines()
    assert lines[0].get_color() != alone[0].get_color()


def test_without_any_value_there_is_no_figure():
    with pytest.raises(Undrawable, match="no run has a finite value: mean reward"):
        chart(Panel("reward", "mean reward", [EMPTY]))


def test_the_sentence_on_missing_values_stands_only_where_some_are():
    told = "Runs that have ended are left out."
    partial = curve("a", [[0, 1, 2], [0, 3, np.nan]])
    assert told in drawing(Panel("reward", "mean reward", [partial], missing=told)).caption
    assert told not in drawing(Panel("reward", "mean reward", [RISING], missing=told)).caption


def test_a_share_is_certain_before_the_first_step():
    flags = curve("a", [[0, 0, 1], [0, 0, 1]], first=0.0)
    ((_, low, high),) = Panel("successes (%)", "share", [flags], is_share=True).bands
    assert low[0] == high[0] == 0 and high[1] > 0.5


def test_hollow_markers_are_means_over_some_runs():
    partial = curve("a", [[1, 2, 3], [1, 2, np.nan]])
    (axes,) = chart(Panel("steps", "mean steps", [partial]), is_swept=True).axes
    faces = axes.collections[-1].get_facecolor()
    np.testing.assert_array_equal(faces[2], [1, 1, 1, 1])
    assert not np.array_equal(faces[0], faces[2])


@pytest.mark.parametrize("rows", [1, 2])
def test_names_do_not_overlap(rows):
    near = [curve(name, [[0, 10], [0, 10 + shift]]) for name, shift in (("a", 0), ("b", 0.1), ("c", 0.2))]
    drawn = drawing(*(Panel(f"reward {row}", f"mean reward {row}", near) for row in range(rows)))
    with style.settings():
        drawn.figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in drawn.figure.axes[0].texts]
    assert [text.get_text() for text in drawn.figure.axes[0].texts] == ["a", "b", "c"]
    assert boxes[0].y1 <= boxes[1].y0 and boxes[1].y1 <= boxes[2].y0


def test_many_or_long_names_are_listed_below():
    many = [curve(f"name {index}", [[0, index], [0, index]]) for index in range(10)]
    drawn = drawing(Panel("reward", "mean reward", many))
    assert len(drawn.figure.legends[0].get_texts()) == 10 and not drawn.figure.axes[0].texts
