"""How figures look: one colour per identifier everywhere, sizes that survive a phone, files without dates."""

import io
import re
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager
from matplotlib.transforms import offset_copy
from scipy.optimize import isotonic_regression

from bojax.report.source import Point

BLUE, ORANGE, GREEN, PINK, SKY, YELLOW, BROWN, GREY = PALETTE = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#B8558F",
    "#3795CF",
    "#C98A00",
    "#7A4B2A",
    "#6B6B6B",
)
"""Okabe and Ito's palette for all kinds of colour vision, the light ones darkened to carry text."""

COLOURS: Mapping[str, str] = {
    "kcbts": BLUE,
    "sbo": ORANGE,
    "gps-abt": GREEN,
    "random": GREY,
    "cbts": SKY,
    "bo-pomdp": PINK,
    "myopic": YELLOW,
    "explorer": BROWN,
    "emu-q": BLUE,
    "rff-q": ORANGE,
    "exploration-values": BLUE,
    "additive": ORANGE,
    "epsilon-greedy": GREY,
}
"""Colour of every identifier of the results format; planners and learners never share a figure."""

LINES = ("-", (0, (5, 1.6)), (0, (1.2, 1.4)), (0, (6, 1.5, 1.2, 1.5)), (0, (2.5, 1.2)))
"""Line styles that tell variants of one identifier apart."""

SHADES = (("white", 0.0), ("black", 0.45), ("white", 0.4), ("black", 0.25), ("white", 0.2))
"""What the colour of an identifier is mixed with for its variants, and by which share."""

WIDTH = 4.7
"""Width of every figure in inches: on a phone, 340 CSS pixels, its text is still 10 pixels high."""

INK, FAINT = "#222222", "#8A8A8A"

_SETTINGS: Mapping[str, Any] = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib: the same glyphs on every machine
    "text.parse_math": False,  # names are the user's: a dollar sign is one
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.labelsize": 10.5,
    "axes.edgecolor": "#555555",
    "axes.facecolor": "none",  # one background for the whole figure, see `bojax.report.dark`
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.7,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "xtick.labelsize": 9.5,
    "ytick.labelsize": 9.5,
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "lines.linewidth": 1.9,
    "lines.solid_capstyle": "round",
    "savefig.facecolor": "white",
    "savefig.dpi": 200,
    "svg.hashsalt": "bojax",
    "svg.fonttype": "path",
    "path.simplify": True,
}


_FALLBACKS = (
    *("Noto Sans CJK SC", "Noto Sans CJK JP", "Source Han Sans SC", "WenQuanYi Zen Hei"),
    *("PingFang SC", "Hiragino Sans", "Microsoft YaHei", "SimHei", "Yu Gothic", "Malgun Gothic"),
    *("Arial Unicode MS", "Noto Sans Devanagari", "Noto Sans Thai"),
)
"""Fonts for what DejaVu Sans has no glyphs of, used where they are installed."""

_NO_GLYPH = "Glyph .* missing from"


@contextmanager
def settings() -> Iterator[list[str]]:
    """Context in which figures are made and saved; matplotlib's defaults come back after it.

    Yields:
        A list that holds, after the context, matplotlib's warnings of characters that no font has; they are
        not shown, other warnings are.
    """
    fonts = [
        *_SETTINGS["font.family"],
        *(name for name in _FALLBACKS if name in fontManager.get_font_names()),
    ]
    settings: dict[Any, Any] = {**matplotlib.rcParamsDefault, **_SETTINGS, "font.family": fonts}
    missing: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.filterwarnings("always", message=_NO_GLYPH)
        with matplotlib.rc_context({**settings, "backend": "agg"}):
            yield missing
    for warning in caught:
        if re.match(_NO_GLYPH, str(warning.message)):
            missing.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


def figure(height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of the common width and its grid of axes, `[rows, columns]`, laid out without overlap."""
    drawn = Figure(figsize=(WIDTH, height), layout="constrained")
    return drawn, drawn.subplots(rows, columns, squeeze=False, **options)


def encode(drawn: Figure) -> Mapping[str, bytes]:
    """The figure as `png` and `svg`, the same bytes every time: fixed ids, no date."""
    # Panels of equal aspect move once the first layout is known: let it settle, so that nothing is cut off.
    for _ in range(2):
        drawn.draw_without_rendering()
    files = {}
    for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None, "Creator": None})):
        buffer = io.BytesIO()
        drawn.savefig(buffer, format=kind, metadata=metadata)
        files[kind] = buffer.getvalue()
    return files


def colour(label: str, labels: Sequence[str]) -> str:
    """Colour of an identifier; one that the format does not know gets a colour that no other label uses."""
    if label in COLOURS:
        return COLOURS[label]
    unknown = sorted({name for name in labels if name not in COLOURS} | {label})
    taken = {COLOURS[name] for name in labels if name in COLOURS}
    free = [ink for ink in PALETTE if ink not in taken] or [GREY]
    return free[unknown.index(label) % len(free)]


def look(label: str, labels: Sequence[str], variant: int) -> dict[str, Any]:
    """Colour and line style of a variant of a label: a shade of the label's colour, and its own style."""
    ink = mixed(colour(label, labels), *SHADES[variant % len(SHADES)])
    return {"color": ink, "linestyle": LINES[variant % len(LINES)]}


def mixed(ink: str, other: str, share: float) -> str:
    """A colour with a share of another one in it."""
    red, green, blue = ((1 - share) * a + share * b for a, b in zip(to_rgb(ink), to_rgb(other), strict=True))
    return to_hex((red, green, blue)).upper()


def looks(points: Sequence[Point]) -> list[dict[str, Any]]:
    """Colour and line style of each point; the first variant of a label has the label's own colour."""
    labels = [point.label for point in points]
    return [
        look(point.label, labels, labels[:position].count(point.label))
        for position, point in enumerate(points)
    ]


def direct_labels(
    axes: Axes, x: float, heights: Sequence[float], names: Sequence[str], colours: Sequence[str]
) -> None:
    """Names beside the right ends of curves, moved apart until none overlaps, with a leader where moved."""
    figure = axes.figure
    assert isinstance(figure, Figure)
    low, high = axes.get_ylim()
    spec = axes.get_subplotspec()
    rows = 1 if spec is None else spec.get_gridspec().nrows
    gap = 13.0 / (0.8 * figure.get_figheight() / rows * 72) * (high - low)
    places = spread(heights, gap, low + gap / 2, high - gap / 2)
    span = axes.get_xlim()[1] - axes.get_xlim()[0]
    for height, place, name, ink in zip(heights, places, names, colours, strict=True):
        if abs(place - height) > gap / 4:
            axes.plot([x, x + 0.022 * span], [height, place], color=ink, linewidth=0.8, clip_on=False)
        shifted = offset_copy(axes.transData, fig=figure, x=9, units="points")
        axes.text(x, place, name, color=ink, transform=shifted, va="center", ha="left", fontsize=9.5)


def spread(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """The positions nearest to `heights` that keep their order and a gap, within the bounds if they fit."""
    order = np.argsort(np.asarray(heights, dtype=np.float64), kind="stable")
    offsets = gap * np.arange(len(order))
    # Keeping a gap between neighbours is isotonic regression of the heights less their offsets.
    shifted = isotonic_regression(np.asarray(heights, dtype=np.float64)[order] - offsets).x
    positions = np.empty(len(order))
    positions[order] = np.clip(shifted, low, max(low, high - offsets[-1])) + offsets
    return positions.tolist()


def wrapped(name: str, width: int) -> str:
    """A long name on several lines."""
    return "\n".join(textwrap.wrap(name, width)) or name


def plain_ticks(axis: Axis) -> None:
    """Tick labels written out in full, with thousands separators and minus signs."""
    axis.set_major_formatter(lambda value, _: f"{value:,.10g}".replace("-", "\N{MINUS SIGN}"))


def quiet_grid(axes: Axes, which: str = "y") -> None:
    """A faint grid along one axis."""
    axes.grid(True, axis=which)  # type: ignore[arg-type]
    axes.tick_params(length=3)
