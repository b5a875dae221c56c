"""Maps of values on the grid of a belief, drawn over the domain."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle

from bojax.problems.settings import FieldProblem
from bojax.report import style
from bojax.report.columns import BELIEF
from bojax.report.drawing.base import points_with
from bojax.report.source import Point, Results
from bojax.report.statistics import Floats
from bojax.report.text import number

QUIET = LinearSegmentedColormap.from_list("quiet", ["#FBFBFA", "#D9DCDD", "#A9AFB2"])
"""Light greys: a background on which every colour of a planner can be read."""

Belief = Mapping[str, Floats]


def beliefs(results: Results, point: Point) -> dict[int, Belief]:
    """The recorded final beliefs of a point that include the true field, by run."""
    found = results.arrays(point, "belief")
    return {run: arrays for run, arrays in found if BELIEF <= arrays.keys()}


def first_beliefs(
    results: Results, most: int, *, of_heights: bool = False
) -> tuple[list[tuple[Point, int, Belief]], str]:
    """The first recorded belief of each point, or each that maps heights, and the note of `drawn_points`."""

    def recorded(point: Point) -> dict[int, Belief]:
        maps_heights = isinstance(point.problem, FieldProblem) and point.problem.maps_heights
        return beliefs(results, point) if maps_heights or not of_heights else {}

    missing = f"no recorded {'map of heights' if of_heights else 'belief'} in arrays/"
    found, note = points_with(results, recorded, missing, most)
    return [(point, *next(iter(kept.items()))) for point, kept in found], note


def errors_told(maps: Sequence[tuple[Point, int, Belief]], unit: str = "") -> str:
    """The root mean square error of the mean of each belief, for alternative texts."""
    errors = [float(np.sqrt(np.mean((belief["mean"] - belief["truth"]) ** 2))) for _, _, belief in maps]
    names = [point.name for point, _, _ in maps]
    return ", ".join(f"{name} {number(error)}{unit}" for name, error in zip(names, errors, strict=True))


def draw_map(axes: Axes, belief: Belief, values: Floats, norm: Normalize, cmap: Any) -> AxesImage:
    """Draw values `[y, x]` as colours, interpolated within the grid and not extrapolated beyond it."""
    places = [belief[name] for name in ("x", "y")]
    (x_min, x_max), (y_min, y_max) = ((float(each[0]), float(each[-1])) for each in places)
    x_step, y_step = (float(np.ptp(each) / max(1, len(each) - 1)) for each in places)
    limits = axes.get_xlim(), axes.get_ylim()
    extent = x_min - x_step / 2, x_max + x_step / 2, y_min - y_step / 2, y_max + y_step / 2
    look: dict[str, Any] = {"norm": norm, "cmap": cmap, "interpolation": "bilinear", "zorder": 1}
    image = axes.imshow(values, origin="lower", extent=extent, **look)
    edge = Rectangle((x_min, y_min), x_max - x_min, y_max - y_min, transform=axes.transData)
    image.set_clip_path(edge)
    axes.set_xlim(limits[0])
    axes.set_ylim(limits[1])
    return image


def draw_samples(axes: Axes, belief: Belief) -> None:
    """Draw a dot at each sample of a belief that records them."""
    if "samples" in belief:
        axes.scatter(*belief["samples"][:, :2].T, s=1.6, color=style.INK, linewidths=0, zorder=2.4)


def draw_scale(figure: Figure, image: ScalarMappable, panels: Iterable[Axes], **options: Any) -> Colorbar:
    """Draw the scale of a map below its panels."""
    bar = figure.colorbar(image, ax=list(panels), location="bottom", **options)
    bar.ax.spines["outline"].set_visible(False)
    bar.ax.tick_params(length=2, labelsize=8.5)
    return bar
