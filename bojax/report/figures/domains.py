"""The domain of a problem, drawn from its configuration: border, goal, everything that stands still."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Patch, Rectangle

from bojax.report import style

FLOOR, WALL, EDGE = "#F6F6F4", "#4A4A4A", "#555555"

TARGET: Mapping[str, Any] = {"facecolor": "none", "edgecolor": style.INK, "linestyle": (0, (2, 1.5))}
"""How an area to reach is drawn."""


def parking(axes: Axes, problem: Mapping[str, Any]) -> None:
    """A square `[-half_width, half_width]^2` with the goal, a disc of `distance_tolerance`, at its centre."""
    half = float(problem.get("half_width", 4.0))
    radius = float(problem.get("distance_tolerance", 0.1))
    square = (-half, -half, half, half)
    axes.add_patch(_box(square, facecolor=FLOOR, edgecolor=EDGE, linewidth=1.1, zorder=0))
    _limits(axes, square, 0.1 * half)
    axes.add_patch(Circle((0, 0), radius, facecolor=style.INK, edgecolor="none", zorder=6))
    # The disc is a speck on this scale: a ring makes it findable without claiming its size.
    axes.scatter([0], [0], s=85, facecolors="none", edgecolors=style.INK, linewidths=1.0, zorder=6)
    _ticks(axes, (-half, 0.0, half), (-half, 0.0, half))


def monitoring(axes: Axes, problem: Mapping[str, Any]) -> None:
    """The rectangle `domain` with its `walls`, the border of `target_area` and the position of `start`."""
    domain = x_min, y_min, x_max, y_max = tuple(float(bound) for bound in problem["domain"])
    _limits(axes, domain, 0.03 * max(x_max - x_min, y_max - y_min))
    # The border stands above maps and walls, which end at it.
    axes.add_patch(_box(domain, facecolor=FLOOR, edgecolor="none", zorder=0))
    border = _box(domain, facecolor="none", edgecolor=EDGE, linewidth=1.1, zorder=2.6)
    axes.add_patch(border)
    for wall in problem.get("walls") or ():
        patch = axes.add_patch(_box(wall, facecolor=WALL, edgecolor="none", zorder=2.5))
        patch.set_clip_path(border)
    if problem.get("target_area") is not None:
        # Inside the border, which it often shares.
        inset = 0.012 * (x_max - x_min)
        low_x, low_y, high_x, high_y = problem["target_area"]
        inner = (low_x + inset, low_y + inset, high_x - inset, high_y - inset)
        axes.add_patch(_box(inner, **TARGET, linewidth=1.0, zorder=2.4))
    if problem.get("start") is not None:
        axes.scatter(
            *problem["start"][:2], s=22, facecolors="white", edgecolors=style.INK, linewidths=1.3, zorder=4.5
        )
    _ticks(axes, (x_min, (x_min + x_max) / 2, x_max), (y_min, (y_min + y_max) / 2, y_max))


DOMAINS: Mapping[str, Callable[[Axes, Mapping[str, Any]], None]] = {
    "parking": parking,
    "robot-parking": parking,
    "space-modelling": monitoring,
    "two-pits": monitoring,
    "diagonal": monitoring,
    "monitoring": monitoring,
    "hilly-terrain": monitoring,
    "indoor-props": monitoring,
}
"""By the problem's kind; of other problems, what their outline declares is drawn."""


def has_parking_goal(problem: Mapping[str, Any]) -> bool:
    """Whether the goal is drawn as a disc in a ring."""
    return DOMAINS.get(str(problem.get("kind"))) is parking


def outlined(axes: Axes, outline: Mapping[str, Any]) -> None:
    """The shapes that a problem declares: border, obstacles, goals."""
    border = outline.get("border")
    if border is not None:
        _limits(axes, border, 0.03 * max(border[2] - border[0], border[3] - border[1]))
        axes.add_patch(_box(border, facecolor=FLOOR, edgecolor=EDGE, linewidth=1.1, zorder=0))
    for shape in outline.get("obstacles") or ():
        axes.add_patch(_shape(shape, facecolor=WALL, edgecolor="none", zorder=2.5))
    for shape in outline.get("goals") or ():
        axes.add_patch(_shape(shape, **TARGET, linewidth=1.2, zorder=2.4))


def draw_domain(axes: Axes, problem: Mapping[str, Any], outline: Mapping[str, Any]) -> None:
    """The domain of a problem, in metres on both axes alike, without a box around it.

    Args:
        axes: Where it is drawn.
        problem: Settings of the problem, which tell the domain of a built-in one.
        outline: What a problem of the user's declares.
    """
    if problem.get("kind") in DOMAINS:
        DOMAINS[str(problem["kind"])](axes, problem)
    outlined(axes, outline)
    axes.set_aspect("equal")
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)


def _shape(numbers: Sequence[float], **options: Any) -> Patch:
    if len(numbers) == 3:
        return Circle((numbers[0], numbers[1]), numbers[2], **options)
    return _box(numbers, **options)


def _box(bounds: Sequence[float], **options: Any) -> Rectangle:
    x_min, y_min, x_max, y_max = bounds
    return Rectangle((x_min, y_min), x_max - x_min, y_max - y_min, **options)


def _limits(axes: Axes, bounds: Sequence[float], margin: float) -> None:
    axes.set_xlim(bounds[0] - margin, bounds[2] + margin)
    axes.set_ylim(bounds[1] - margin, bounds[3] + margin)


def _ticks(axes: Axes, x: Sequence[float], y: Sequence[float]) -> None:
    axes.set_xticks(x, [_tick(value) for value in x])
    axes.set_yticks(y, [_tick(value) for value in y])


def _tick(value: float) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")
