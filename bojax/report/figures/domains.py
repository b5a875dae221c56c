"""The domain of a problem, drawn from its configuration: border, goal, everything that stands still."""

from collections.abc import Callable, Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from bojax.report import style


def parking(axes: Axes, problem: Mapping[str, Any]) -> None:
    """A square `[-half_width, half_width]^2` with the goal, a disc of `distance_tolerance`, at its centre."""
    half = float(problem.get("half_width", 4.0))
    radius = float(problem.get("distance_tolerance", 0.1))
    axes.add_patch(
        Rectangle(
            (-half, -half),
            2 * half,
            2 * half,
            facecolor="#F6F6F4",
            edgecolor="#555555",
            linewidth=1.1,
            zorder=0,
        )
    )
    axes.add_patch(Circle((0, 0), radius, facecolor=style.INK, edgecolor="none", zorder=6))
    # The disc is a speck on this scale: a ring makes it findable without claiming its size.
    axes.scatter([0], [0], s=85, facecolors="none", edgecolors=style.INK, linewidths=1.0, zorder=6)
    axes.set_xlim(-1.1 * half, 1.1 * half)
    axes.set_ylim(-1.1 * half, 1.1 * half)
    axes.set_xticks(
        [-half, 0, half], [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in (-half, 0.0, half)]
    )
    axes.set_yticks(
        [-half, 0, half], [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in (-half, 0.0, half)]
    )


DOMAINS: Mapping[str, Callable[[Axes, Mapping[str, Any]], None]] = {"parking": parking}
"""By the problem's kind; other problems are drawn without a domain."""
