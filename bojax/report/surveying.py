"""The page of a planned survey, from the files of its folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from bojax.report import style
from bojax.report.drawing.base import Drawing
from bojax.report.drawing.maps import QUIET, draw_scale
from bojax.report.tables import Cell, Table
from bojax.report.template import fill
from bojax.report.text import counted, number, printed, shortened
from bojax.results.store import read_json, write_content

SURVEY, ARRAYS = "survey.json", "survey.npz"
"""The files of a survey: what was asked and found, and the arrays of its map."""

_STARTS = ("o", "^", "D", "v")  # markers of the ends of each robot's route


def build_survey_page(folder: Path) -> Path:
    """Write the figures and `report.html` of a planned survey, and return the path of the page."""
    survey = read_json(folder / SURVEY)
    with np.load(folder / ARRAYS) as arrays:
        maps = dict(arrays)
    with style.settings():
        plates = {"route": _draw_route(survey, maps).encoded(), "error": _draw_errors(survey).encoded()}
        if survey["goal"]["kind"] in ("hotspots", "threshold"):
            plates["goal"] = _draw_goal(survey, maps).encoded()
        for index, read in enumerate(survey["read"]):
            plates[f"read-{index + 1}"] = _draw_read(maps, read, maps[f"read_{index}"]).encoded()
    style.write_images(folder, {name: plate.files for name, plate in plates.items()})
    page = fill(
        "survey.html.j2",
        title=f"Survey of {survey['area']}",
        summary=_summary(survey),
        counts=[],
        plates=plates,
        candidates=_table(survey),
        settings=list(survey["settings"].items()),
        provenance=list(survey["provenance"].items()),
        footer="Written by bojax from the files of this folder, which hold every number shown here.",
    )
    path = folder / "report.html"
    write_content(path, page)
    return path


def survey_summary(folder: Path) -> str:
    """What was chosen in a survey's folder, and what it gains, in sentences."""
    return _summary(read_json(folder / SURVEY))


def _summary(survey: Mapping[str, Any]) -> str:
    chosen = survey["candidates"][0]
    mower = next(each for each in survey["candidates"] if each["method"] == "lawnmower")
    before = chosen["errors"][0]
    robots = len(chosen["routes"])
    each = "" if robots == 1 else f" at most for each of {robots} robots"
    text = (
        f"The best of {counted(len(survey['candidates']), 'candidate')} is: {chosen['name']}, "
        f"{_distance(chosen['length'])} long{each}. It takes the mean standard deviation "
        f"{survey['goal']['meaning']} from {number(before)} to {number(chosen['errors'][-1])}"
    )
    if chosen is mower:
        return f"{text}."
    gain = 1.0 - chosen["errors"][-1] / mower["errors"][-1]
    if gain < 0.0:  # only with a separation that no lawnmower keeps
        left = number(mower["errors"][-1])
        return f"{text}. The best lawnmower leaves less, {left}, but its robots come closer than asked."
    other = f"{number(mower['errors'][-1])}, {_distance(mower['length'])} long"
    return f"{text}, {100 * gain:.1f}% less than the best lawnmower ({other})."


def _distance(metres: float) -> str:
    # From 999.5 m, three digits of metres would be 1e+03.
    return f"{metres / 1000:.2f} km" if metres >= 999.5 else f"{metres:.3g} m"


def _unit(extent: float) -> tuple[str, float]:
    return ("km", 1000.0) if extent >= 2000 else ("m", 1.0)


def _draw_route(survey: Mapping[str, Any], maps: Mapping[str, np.ndarray]) -> Drawing:
    """The route on a map of the expected standard deviation."""
    chosen = survey["candidates"][0]
    drawn, axes, scale = _draw_map(survey, maps, "after", "expected standard deviation after the survey")
    for index, waypoints in enumerate(chosen["routes"]):
        route, colour, dashes = np.asarray(waypoints) / scale, style.PALETTE[index], style.LINES[index]
        axes.plot(*route.T, color=colour, linestyle=dashes, linewidth=1.1)
        axes.plot(*route[0], marker=_STARTS[index], color=colour, markersize=5)
        axes.plot(*route[-1], marker=_STARTS[index], color=colour, markersize=5, fillstyle="none")
    return Drawing(
        drawn,
        "Route",
        f"The proposed route ({chosen['name']}), from the filled marker to the empty one, on the standard "
        "deviation that the model expects after it. x is to the east and y to the north of the lower left "
        "corner of the area.",
        f"A route of {_distance(chosen['length'])} in the area; {chosen['name']}.",
    )


def _draw_goal(survey: Mapping[str, Any], maps: Mapping[str, np.ndarray]) -> Drawing:
    """The weights of the goal."""
    drawn, _, _ = _draw_map(survey, maps, "weights", "weight in the error")
    return Drawing(
        drawn,
        "What counts",
        f"Weight of each place in the error, a mean {survey['goal']['meaning']}; the mean weight is 1.",
        f"A map of weights from {number(maps['weights'].min())} to {number(maps['weights'].max())}.",
    )


def _draw_map(
    survey: Mapping[str, Any], maps: Mapping[str, np.ndarray], name: str, label: str
) -> tuple[Figure, Axes, float]:
    """One of the maps in the border of the area, and the metres of a unit of its axes."""
    side = survey["grid_spacing"]
    figure, axes, border, scale = _axes(maps, maps["outline"])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2
    look: dict[str, Any] = {"edgecolors": "face", "linewidths": 0.2, "zorder": 0}  # below the border
    squares = list((maps["grid"][:, None] + corners) / scale)
    cells = PolyCollection(squares, array=maps[name], cmap=QUIET, **look)
    cells.set_clim(0.0, float(maps[name].max()))
    cells.set_rasterized(True)
    axes.add_collection(cells)
    cells.set_clip_path(border)
    draw_scale(figure, cells, [axes], shrink=0.7, label=label)
    return figure, axes, scale


def _draw_read(maps: Mapping[str, np.ndarray], read: Mapping[str, str], rows: np.ndarray) -> Drawing:
    """The values that were read from a file, at their places."""
    shown = np.concatenate([maps["outline"], rows[:, :2]])
    figure, axes, _, scale = _axes(maps, shown)
    # Squares that would tile the places, but no larger than a marker that shows one value.
    width, height = np.maximum(np.ptp(rows[:, :2], axis=0), 1e-9) / scale
    inches = axes.get_position().width * figure.get_figwidth() / np.ptp(axes.get_xlim())
    size = np.clip(72.0 * inches * (width * height / len(rows)) ** 0.5, 2.0, 6.0)  # places may lie on a line
    look: dict[str, Any] = {"marker": "s", "linewidths": 0.0, "rasterized": True, "zorder": 0}
    drawn = axes.scatter(*(rows[:, :2] / scale).T, c=rows[:, 2], s=(1.1 * size) ** 2, **look)
    name = Path(read["file"]).name
    label = shortened(printed(read["label"] or "value"), 50)
    draw_scale(figure, drawn, [axes], shrink=0.7, label=label)
    low, high = number(float(rows[:, 2].min())), number(float(rows[:, 2].max()))
    return Drawing(
        figure,
        f"What was read from {name}",
        f"{counted(len(rows), 'value')} of {name}, from {low} to {high}; large files are thinned. The "
        "line is the border of the area.",
        f"A map of the values of {name}, from {low} to {high}.",
    )


def _axes(maps: Mapping[str, np.ndarray], shown: np.ndarray) -> tuple[Figure, Axes, PathPatch, float]:
    """Axes that show points, the border of the area in them, and the metres of their unit."""
    unit, scale = _unit(float(np.ptp(shown, axis=0).max()))
    low, high = shown.min(0) / scale, shown.max(0) / scale
    width, height = high - low
    figure, grid = style.figure(min(7.0, max(2.6, 0.9 + 4.0 * height / width)))
    axes = grid[0, 0]
    border = PathPatch(_outline(maps, scale), fill=False, edgecolor=style.INK, linewidth=0.8)
    axes.add_patch(border)
    axes.set_aspect("equal")
    margin = 0.03 * max(width, height)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"y ({unit})")
    return figure, axes, border, scale


def _outline(maps: Mapping[str, np.ndarray], scale: float) -> Outline:
    """The border of the area and of its holes."""
    rings = np.split(maps["outline"] / scale, maps["ring_ends"][:-1])
    codes = []
    for ring in rings:
        codes += [Outline.MOVETO, *[Outline.LINETO] * (len(ring) - 2), Outline.CLOSEPOLY]
    return Outline(np.concatenate(rings), codes)


def _draw_errors(survey: Mapping[str, Any]) -> Drawing:
    """Expected error against distance; the proposed route and the best of the other method have names."""
    chosen = survey["candidates"][0]
    named = [chosen, *[each for each in survey["candidates"] if each["method"] != chosen["method"]][:1]]
    unit, scale = _unit(max(each["length"] for each in survey["candidates"]))
    figure, grid = style.figure(3.2)
    axes = grid[0, 0]
    for each in survey["candidates"]:
        if each not in named:
            axes.plot(np.asarray(each["distances"]) / scale, each["errors"], color="#C4C8CA", linewidth=0.8)
    for index, each in [*enumerate(named)][::-1]:  # the proposed route above the other
        is_mower = each["method"] == "lawnmower"
        name = f"best lawnmower ({each['detail']})" if is_mower else each["name"]
        look: dict[str, Any] = {"color": style.PALETTE[index], "linestyle": style.LINES[index]}
        axes.plot(np.asarray(each["distances"]) / scale, each["errors"], label=name, **look)
    style.quiet_grid(axes)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
    axes.set_xlabel(f"distance ({unit})")
    axes.set_ylabel("mean standard deviation")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0))  # above the curves
    return Drawing(
        figure,
        "Expected error against distance",
        f"Mean {survey['goal']['meaning']} of the standard deviation that the model expects after the "
        "measurements up to each distance. Grey: the other candidates.",
        _summary(survey),
    )


def _table(survey: Mapping[str, Any]) -> Table:
    rows = []
    for each in survey["candidates"]:
        waypoints = ", ".join(str(len(route)) for route in each["routes"])
        texts = _distance(each["length"]), number(each["errors"][-1]), waypoints
        rows.append((each["name"], [Cell(text) for text in texts]))
    caption = (
        "All routes that were compared, the proposed one first. Error: mean standard deviation "
        f"{survey['goal']['meaning']} that the model expects at the end. {survey['rule']}"
    )
    return Table(["length", "error", "waypoints"], rows, caption)
