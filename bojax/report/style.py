"""The look of figures: one colour per identifier, text readable on a phone, files without dates."""

import io
import logging
import re
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend
from matplotlib.transforms import offset_copy

from bojax.logs import quiet
from bojax.report.source import Point
from bojax.report.text import distinct, minus, printed, shortened
from bojax.results.store import make_folder, write_content

BLUE, ORANGE, GREEN, PINK, SKY, YELLOW, BROWN, GREY = PALETTE = (
    "#0072B2",
    "#C45000",
    "#009E73",
    "#BC5A97",
    "#3A97D1",
    "#C98A00",
    "#7A4B2A",
    "#6B6B6B",
)
"""The palette of Okabe and Ito, darkened for text; its colours differ under protanopia and deuteranopia, too.

Identifiers without a colour of their own take them in this order.
"""

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
    "dora": GREEN,
    "rnd": SKY,
    "bootstrapped-q": YELLOW,
    "vime": PINK,
    "exploration-values": BLUE,
    "additive": ORANGE,
    "epsilon-greedy": GREY,
}
"""Colour of each built-in planner and learner, which never share a figure."""

LINES = ("-", (0, (5, 1.6)), (0, (1.2, 1.4)), (0, (6, 1.5, 1.2, 1.5)), (0, (2.5, 1.2)))
MARKERS = ("", "o", "s", "^", "D")
"""Line styles and markers that distinguish the variants of one identifier, which share its colour."""

FIGURES = "figures"  # name of the folder of figures
WIDTH = 4.7  # width of every figure in inches: on a phone of 340 CSS pixels, text is still 10 pixels high
LONGEST = 48  # columns of a name in a figure, so that one fits the width below the panels
LINE_POINTS = 12.5  # distance of two lines of names beside curves
INK, FAINT = "#222222", "#8A8A8A"

_SETTINGS: Mapping[str, Any] = {
    "font.family": ["DejaVu Sans"],  # part of matplotlib: the same glyphs on every machine
    "text.parse_math": False,  # names are given by users and may contain dollar signs
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.labelsize": 10.5,
    "axes.edgecolor": "#555555",
    "axes.facecolor": "none",  # the figure has the only background, see `adapted`
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
    "figure.dpi": 200,
    "svg.hashsalt": "bojax",
    "svg.fonttype": "path",
    "path.simplify": True,
}

_FALLBACKS = (
    *("Noto Sans CJK SC", "Noto Sans CJK JP", "Source Han Sans SC", "WenQuanYi Zen Hei"),
    *("PingFang SC", "Hiragino Sans", "Microsoft YaHei", "SimHei", "Yu Gothic", "Malgun Gothic"),
    *("Arial Unicode MS", "Noto Sans Devanagari", "Noto Sans Thai"),
)
"""Fonts for characters that DejaVu Sans lacks, used where they are installed."""

_NO_GLYPH = "Glyph .* missing from"


@contextmanager
def settings() -> Iterator[list[str]]:
    """Context with the settings of matplotlib under which figures are made and saved.

    Its list has, at the end, matplotlib's warnings of characters that no font has, which alone are not shown.
    """
    installed = fontManager.get_font_names()
    fonts = [*_SETTINGS["font.family"], *(name for name in _FALLBACKS if name in installed)]
    settings: dict[Any, Any] = {**matplotlib.rcParamsDefault, **_SETTINGS, "font.family": fonts}
    del settings["backend"]  # a notebook keeps its own, which `rc_context` would not restore
    missing: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.filterwarnings("always", message=_NO_GLYPH)
        # Without this, matplotlib logs a message for each fallback font that lacks the normal weight.
        no_messages = quiet("matplotlib.font_manager", logging.ERROR)
        with matplotlib.rc_context(settings), no_messages:
            yield missing
    for warning in caught:
        if re.match(_NO_GLYPH, str(warning.message)):
            missing.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


def figure(
    height: float, rows: int = 1, columns: int = 1, *, is_compressed: bool = False, **options: Any
) -> tuple[Figure, np.ndarray]:
    """A figure of the common width, and its grid of axes `[rows, columns]`.

    Panels of equal aspect and a common scale may be compressed: put side by side without gaps.
    """
    drawn = Figure(figsize=(WIDTH, height), layout=_Compressed() if is_compressed else "constrained")
    return drawn, drawn.subplots(rows, columns, squeeze=False, **options)


class _Compressed(ConstrainedLayoutEngine):
    """A layout without gaps between panels of equal aspect, which need no second layout."""

    def __init__(self):
        super().__init__(compress=True)


def encode(drawn: Figure) -> Mapping[str, bytes]:
    """The figure as `png` and `svg`. Equal figures give equal bytes: ids are fixed and dates left out."""
    if (engine := drawn.get_layout_engine()) is not None:
        # Panels of equal aspect move in the second layout; without it they would be cut off.
        for _ in range(1 if isinstance(engine, _Compressed) else 2):
            engine.execute(drawn)
        # Both files have this layout. `Figure.savefig` would repeat it, with two more drawings, for each.
        drawn.set_layout_engine("none")
    png, svg = io.BytesIO(), io.BytesIO()
    FigureCanvasAgg(drawn).print_png(png, metadata={"Software": None})
    FigureCanvasSVG(drawn).print_svg(svg, metadata={"Date": None, "Creator": None})
    return {"png": png.getvalue(), "svg": svg.getvalue()}


def write_images(folder: Path, images: Mapping[str, Mapping[str, bytes]]) -> None:
    """Write figures as encoded by `encode` into the subfolder `figures` of a folder."""
    make_folder(folder / FIGURES)
    for name, files in images.items():
        for suffix, content in files.items():
            write_content(folder / FIGURES / f"{name}.{suffix}", content)


def colour(label: str, labels: Sequence[str]) -> str:
    """Colour of an identifier; one without a colour of its own gets a colour that no other label uses."""
    if label in COLOURS:
        return COLOURS[label]
    unknown = sorted({name for name in labels if name not in COLOURS} | {label})
    taken = {COLOURS[name] for name in labels if name in COLOURS}
    free = [ink for ink in PALETTE if ink not in taken] or [GREY]
    return free[unknown.index(label) % len(free)]


def look(label: str, labels: Sequence[str], variant: int) -> dict[str, Any]:
    """Colour of a label, with the line style and the marker of a variant, as options of `Axes.plot`."""
    row, place = divmod(variant, len(LINES))
    return {
        "color": colour(label, labels),
        "linestyle": LINES[place],
        "marker": MARKERS[(place + row) % len(MARKERS)],
        "markersize": 4.5,
        # In shares of the diagonal, so that curves of any length have about six, at places of their own.
        "markevery": (0.02 + 0.03 * place, 0.18),
    }


def looks(points: Sequence[Point]) -> list[dict[str, Any]]:
    """Colour, line style and marker of each point; the first variant of a label is a line without markers.

    Variants of a label share its colour, unless there is no other label: then each has a colour of its own,
    as far as the palette reaches. Labels that share a colour, because there are more of them than colours,
    are distinguished like variants.
    """
    labels = [point.label for point in points]
    if len(set(labels)) == 1:
        first = colour(labels[0], labels)
        inks = [first, *(ink for ink in PALETTE if ink != first)]
        found = [look(labels[0], labels, number) for number in range(len(labels))]
        return [each | {"color": inks[number % len(inks)]} for number, each in enumerate(found)]
    inks = [colour(label, labels) for label in labels]
    return [
        look(label, labels, inks[:position].count(ink))
        for position, (label, ink) in enumerate(zip(labels, inks, strict=True))
    ]


def direct_labels(
    axes: Axes, x: float, heights: Sequence[float], names: Sequence[str], colours: Sequence[str]
) -> None:
    """Write names beside the right ends of curves, apart from each other; a line leads to a moved name.

    Their ids in the SVG are those of `Chart.mark` of `bojax.report.drawing.curves`.
    """
    figure = axes.figure
    assert isinstance(figure, Figure)
    low, high = axes.get_ylim()
    spec = axes.get_subplotspec()
    rows = 1 if spec is None else spec.get_gridspec().nrows
    lines = max(name.count("\n") + 1 for name in names)
    gap = LINE_POINTS * lines / (0.8 * figure.get_figheight() / rows * 72) * (high - low)
    places = spread(heights, gap, low + gap / 2, high - gap / 2)
    span = axes.get_xlim()[1] - axes.get_xlim()[0]
    entries = zip(heights, places, names, colours, strict=True)
    for number, (height, place, name, ink) in enumerate(entries):
        if abs(place - height) > gap / 4:
            moved: dict[str, Any] = {"linewidth": 0.8, "clip_on": False, "gid": f"curve-{number}-lead"}
            axes.plot([x, x + 0.022 * span], [height, place], color=ink, **moved)
        shifted = offset_copy(axes.transData, fig=figure, x=9, units="points")
        options: dict[str, Any] = {"va": "center", "ha": "left", "fontsize": 9.5, "linespacing": 1.0}
        text = axes.text(x, place, name, color=ink, transform=shifted, **options)
        text.set_gid(f"name-{number}-text")


def spread(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """The positions nearest to `heights` in the same order with at least a gap between them.

    They are within the bounds if there is enough room.
    """
    order = np.argsort(np.asarray(heights, dtype=np.float64), kind="stable")
    offsets = gap * np.arange(len(order))
    # Keeping a gap between neighbours is isotonic regression of the heights less their offsets.
    shifted = np.asarray(heights, dtype=np.float64)[order] - offsets
    if (np.diff(shifted) < 0).any():
        from scipy.optimize import isotonic_regression  # imported late: it takes longer than two figures

        shifted = isotonic_regression(shifted).x
    positions = np.empty(len(order))
    positions[order] = np.clip(shifted, low, max(low, high - offsets[-1])) + offsets
    return positions.tolist()


def drawn_names(points: Sequence[Point]) -> list[str]:
    """The names of points as figures write them: a long one without its middle, all different."""
    return distinct(shortened(printed(point.name), LONGEST) for point in points)


def drawn_text(text: str) -> str:
    """A text with words from a file, such as the label of an axis, as figures write it."""
    return shortened(printed(text), LONGEST)


def legend(drawn: Figure, handles: Sequence[Any], names: Sequence[str], **options: Any) -> Legend:
    """Add a legend. Its names come last, since Matplotlib leaves out one that begins with an underscore."""
    found = drawn.legend(handles, [str(place) for place in range(len(names))], **options)
    for text, name in zip(found.get_texts(), names, strict=True):
        text.set_text(name)
    return found


def wrapped(name: str, width: int) -> str:
    """A name as figures write it, in lines of at most `width` characters.

    Longer words are broken after a dot, an underscore or a slash.
    """
    short = drawn_text(name)
    marked = re.sub(rf"\S{{{width + 1},}}", lambda word: re.sub(r"([._/])(?=\w)", "\\1\0 ", word[0]), short)
    return "\n".join(textwrap.wrap(marked, width)).replace("\0 ", "").replace("\0", "") or short


def plain_ticks(axis: Axis) -> None:
    """Tick labels written out in full, with thousands separators and minus signs."""
    axis.set_major_formatter(lambda value, _: minus(f"{value:,.10g}"))


def quiet_grid(axes: Axes, which: str = "y") -> None:
    """Add a faint grid along one axis."""
    axes.grid(True, axis=which)  # type: ignore[arg-type]
    axes.tick_params(length=3)


_GREYS: Mapping[str, str] = {
    INK: "#e7e9ec",
    "#444444": "#b9c0c9",
    "#555555": "#8d96a1",
    GREY: "#a3abb5",
    "#E4E4E4": "#343a42",
    "#F6F6F4": "#252a31",
    "#4A4A4A": "#9aa3ad",
    BLUE: "#4ba3e3",
    ORANGE: "#cd5b24",
    SKY: "#8ccbf0",
    BROWN: "#b78853",
}
"""Replacements of the colours that are too dark or too bright on a dark page."""

_CARD = "#1c2025"


def adapted(svg: bytes) -> bytes:
    """Add dark colours to an SVG of matplotlib; they apply only where the reader prefers dark pages.

    The colours of a map, which is an image, do not change, and the colours of lines were chosen to stand out
    from it. In a figure with a map, only the background and the text change.
    """
    where = "[id^=text_] " if b"<image" in svg else ""
    rules = [f"#patch_1 path{{fill:{_CARD}!important}}", "svg{fill:#e7e9ec}"]
    for light, dark in _GREYS.items():
        for kind in ("fill", "stroke"):
            rules.append(f'{where}[style*="{kind}: {light.lower()}"]{{{kind}:{dark}!important}}')
    sheet = f"<style>@media (prefers-color-scheme: dark){{{''.join(rules)}}}</style>"
    begin, found, rest = svg.partition(b"<metadata>")
    return begin + sheet.encode() + found + rest if found else svg
