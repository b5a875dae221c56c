"""The drawer of curves: missing data, names and words, whatever the figure."""

from collections import Counter
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest

from bojax.report import style
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.drawing.curves import Chart, Curve, Panel, without_line
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


def test_words_name_the_quantity_the_runs_the_bands_and_the_ends():
    drawn = drawing(Panel("reward", "mean reward", [RISING]))
    assert drawn.caption == (
        "Mean reward, with pointwise 95% bands (Student's t). By episode, 2 runs per curve."
    )
    assert drawn.alt == (
        "Line chart of the mean reward, by episode. First and last value of each curve: a 0 and 3.00."
    )


def test_two_panels_are_told_apart():
    share = Panel(
        "successes (%)", "share of runs that succeed", [curve("a", [[0, 1], [0, 0]])], is_share=True
    )
    caption = drawing(Panel("reward", "mean reward", [RISING]), share).caption
    assert caption == (
        "Above: mean reward, with pointwise 95% bands (Student's t). Below: share of runs that succeed, with "
        "pointwise 95% bands (Wilson). By episode, 2 runs per curve."
    )


def test_without_bands_none_are_promised():
    apart = curve("a", [[0, 1, np.nan], [np.nan, np.nan, 2]])
    caption = drawing(Panel("reward", "mean reward", [apart])).caption
    assert caption == "Mean reward. By episode, 2 runs per curve."


def test_a_curve_without_values_is_not_drawn_but_told():
    drawn = drawing(Panel("reward", "mean reward", [EMPTY, RISING]))
    assert drawn.caption.endswith("Without a value: b.")
    assert [text.get_text() for text in drawn.figure.axes[0].texts] == ["a"]
    assert not drawn.curves  # one alone cannot be hidden


def test_a_curve_has_the_colour_of_its_setting_whichever_others_have_values():
    absent = curve("0", np.full((2, 3), np.nan))
    lines = chart(Panel("reward", "mean reward", [absent, RISING])).axes[0].get_lines()
    alone = chart(Panel("reward", "mean reward", [RISING])).axes[0].get_lines()
    assert lines[0].get_color() != alone[0].get_color()


def test_without_any_value_there_is_no_figure():
    with pytest.raises(FigureUnavailable, match="no run has a finite value: mean reward"):
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


def test_bands_are_cut_to_what_is_possible():
    solved = Curve(RISING.point, np.arange(3.0), np.array([[0.0, 0, 2], [0, 1, 1]]), (0, np.arange(3)))
    ((mean, low, high),) = Panel("episodes solved", "mean number", [solved]).bands
    assert (mean.tolist(), low.tolist(), high.tolist()) == ([0, 0.5, 1.5], [0, 0, 0], [0, 1, 2])


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


def test_ten_names_of_two_lines_stand_beside_their_curves():
    near = [curve(f"kcbts-anywhere-bearing-{at}", [[0, 10 + at / 9]] * 2) for at in range(10)]
    drawn = drawing(Panel("reward", "mean reward", near))
    with style.settings():
        drawn.figure.draw_without_rendering()
    texts = drawn.figure.axes[0].texts
    assert [text.get_text() for text in texts] == [f"kcbts-anywhere-\nbearing-{at}" for at in range(10)]
    boxes = [text.get_window_extent() for text in texts]
    assert all(below.y1 <= above.y0 for below, above in pairwise(boxes))
    assert not drawn.figure.legends and drawn.figure.bbox.y1 >= boxes[-1].y1


@pytest.mark.parametrize(
    ("number", "name"), [(11, "name"), (2, "a name that takes three lines of sixteen letters")]
)
def test_many_or_long_names_are_listed_below(number, name):
    many = [curve(f"{name} {index}", [[0, index], [0, index]]) for index in range(number)]
    drawn = drawing(Panel("reward", "mean reward", many))
    assert len(drawn.figure.legends[0].get_texts()) == number and not drawn.figure.axes[0].texts


def ids_of(drawn):
    """Ids of the SVG, and the number of parts of each curve and of each name among them."""
    with style.settings():
        svg = ElementTree.fromstring(style.encode(drawn.figure)["svg"])
    ids = [element.attrib["id"] for element in svg.iter() if "id" in element.attrib]
    marked = [each.rpartition("-")[0] for each in ids if each.startswith(("curve-", "name-"))]
    return ids, Counter(marked)


@pytest.mark.parametrize("is_swept", [False, True])
@pytest.mark.parametrize("suffix", ["", " with a name too long to stand beside its curve"])
def test_a_curve_and_its_name_are_found_in_the_svg(suffix, is_swept):
    # Names are spread apart, so that lines lead to the first and the last.
    curves = [curve(f"{name}{suffix}", [[0, 10, 5], [0, 10, 5]]) for name in "abc"]
    other = Panel("steps", "mean steps", [EMPTY, *curves[::-1]])
    drawn = drawing(Panel("reward", "mean reward", curves), other, is_swept=is_swept)
    ids, parts = ids_of(drawn)
    assert drawn.curves == [each.point.name for each in curves]
    assert len(set(ids)) == len(ids)
    each = 2 * (3 if is_swept else 2)  # panels; band, line and markers
    lead, key = (0, 1) if suffix else (1, 0)
    assert parts == {
        **{"curve-0": each + lead, "curve-1": each, "curve-2": each + lead},
        **dict.fromkeys(("name-0", "name-1", "name-2"), 1 + key),
    }


def test_what_a_figure_adds_to_a_curve_is_hidden_with_it():
    with style.settings():
        both = Chart([Panel("reward", "mean reward", [RISING, curve("c", [[0, 9, 9]])])], "episode")
        both.mark(RISING, *both.axes[0].plot([1, 2], [0, 1]))
        both.mark(EMPTY, *both.axes[0].plot([1, 2], [0, 2]))
        _, parts = ids_of(both.drawing("Title"))
    assert parts["curve-0"] == parts["curve-1"] + 1


@pytest.mark.parametrize("suffix", ["", " with a name that takes a line of its own"])
def test_the_names_below_leave_the_panel_its_height(suffix):
    def height(count):
        many = [curve(f"name {index}{suffix}", [[0, index], [0, index]]) for index in range(count)]
        drawn = drawing(Panel("reward", "mean reward", many))
        with style.settings():
            style.encode(drawn.figure)
        return drawn.figure.axes[0].get_window_extent().height

    assert height(40) > 0.9 * height(10)


@pytest.mark.parametrize(
    ("values", "dotted"),
    [
        ([1.0], [True]),
        ([1.0, 2.0], [True, True]),
        ([1.0, 2.0, 3.0], [False, False, False]),
        ([np.nan, 1.0, 2.0, np.nan, 3.0, np.nan, np.nan, 4.0], [0, 0, 0, 0, 1, 0, 0, 1]),
    ],
)
def test_values_that_no_line_reaches_are_dots(values, dotted):
    assert without_line(np.array(values)).tolist() == list(map(bool, dotted))
