"""The page of a league, in HTML and in Markdown."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bojax.report import style
from bojax.report.drawing.base import Drawing
from bojax.report.league.aims import MISSED, OPEN, REACHED, Aim, Comparison, judged
from bojax.report.league.results import CELLS, League
from bojax.report.tables import Cell, Table
from bojax.report.template import fill
from bojax.report.text import counted, joined, line, number, ranged
from bojax.results.store import read_json, write_content

METHODS = ("bojax", "lawnmower", "lawnmower from a corner", "SGP-Tools", "myopic", "random")
"""Methods whose routes do not depend on values; the first is the route of `bojax survey`."""

TABLES = {
    "rmse": ("RMSE", (), 3),
    "rmse_learned": ("RMSE with learned hyper-parameters", (), 3),
    "deviation": ("Mean deviation that the process expects", (), 3),
    "regret": ("Hot spots: regret of the best place found", ("bojax, hotspots",), 3),
    "missed": ("Threshold: share of the area on its wrong side", ("bojax, threshold",), 4),
}
"""Measures with their titles, the methods that plan for them, and digits."""

PAGES = ("league.html", "league.md")

DRAWN, TICKS = (0.45, 2.2), (0.5, 0.7, 1.0, 1.4, 2.0)
"""Limits and ticks of the axis of ratios."""

COLOURS = {REACHED: style.BLUE, OPEN: style.GREY, MISSED: style.ORANGE}
"""Colours of verdicts."""


def write_pages(folder: Path) -> list[Path]:
    """Write the page of the league in a folder, and its figures, and return the paths."""
    league = League.read(folder)
    aims = judged(league)
    with style.settings():
        drawings = {"ratios": draw_ratios(aims).encoded()}
        if routes := _routes(folder, league):
            drawings["routes"] = draw_routes(*routes).encoded()
    images = {f"surveys-league-{name}": each.files for name, each in drawings.items()}
    style.write_images(folder, {name: {"svg": files["svg"]} for name, files in images.items()})
    values = {
        "title": "League of surveys",
        "summary": _summary(league, aims),
        "counts": [],
        "aims": aims,
        "comparisons": _comparisons(aims),
        "tables": _tables(league),
        "drawings": drawings,
        "about": _about(league),
        "provenance": [(key, line(value)) for key, value in league.about["provenance"].items()],
        "footer": "Written by bojax from the files of this folder, which hold every route and error.",
    }
    paths = [folder / name for name in PAGES]
    for path in paths:
        write_content(path, fill(f"{path.name}.j2", **values))
    return paths


def _summary(league: League, aims: list[Aim]) -> str:
    verdicts = [aim.verdict for aim in aims]
    kinds = joined(f"{verdicts.count(kind)} {kind}" for kind in (REACHED, MISSED, OPEN) if kind in verdicts)
    real = sum(field["is_real"] for field in league.about["fields"].values())
    starts = ranged((len(by_start) for by_start in league.errors.values()), "start")
    return (
        f"{counted(real, 'real field')} and {len(league.fields) - real} synthetic ones on 10 x 10 units, "
        f"routes of length {joined(league.lengths)} from {starts}. "
        f"Of {counted(len(aims), 'aim')}, {kinds}."
    )


def _tables(league: League) -> dict[str, Table]:
    """Means over the starts, a table for each measure and length."""
    tables = {}
    for measure, (title, adaptive, digits) in TABLES.items():
        methods = [*adaptive, *METHODS]
        for length in league.lengths:
            if adaptive and not any(
                (measure, field, length, adaptive[0]) in league.errors for field in league.fields
            ):
                continue  # a length for maps alone
            rows = []
            for field in league.fields:
                found = [league.errors.get((measure, field, length, method)) for method in methods]
                texts = [f"{np.mean([*each.values()]):.{digits}f}" if each else "" for each in found]
                rows.append((field, [Cell(text) for text in texts]))
            tables[f"{measure}-{length}"] = Table(methods, rows, f"{title}, length {length}")
    return tables


def _comparisons(aims: list[Aim]) -> Table:
    rows = []
    for aim in aims:
        for each in aim.comparisons:
            texts = each.where, each.rival, in_words(each), f"{each.starts}", each.verdict
            rows.append((aim.short, [Cell(text) for text in texts]))
    headings = ["where", "against", "error relative to it", "starts", "verdict"]
    return Table(headings, rows, "Change of the error [95% interval over starts]")


def _routes(folder: Path, league: League) -> tuple[Mapping[str, Any], str] | None:
    """The routes of the first start in the square, of the largest length with most of the goals."""
    field = league.fields[0]
    pieces = ("map-square", f"hotspots-{field}", f"threshold-{field}")
    by_length = {
        length: [file for piece in pieces if (file := folder / CELLS / f"{piece}-{length}-00.json").exists()]
        for length in league.lengths
    }
    length = max(by_length, key=lambda length: (len(by_length[length]), length))
    routes = {name: route for file in by_length[length] for name, route in read_json(file)["routes"].items()}
    title = f"Routes of length {length} from the first start; those for goals on the field {field}."
    return (routes, title) if routes else None


def _about(league: League) -> list[tuple[str, str]]:
    about = league.about
    fields = about["fields"]
    real = [name for name in fields if fields[name]["is_real"]]
    return [
        ("real fields", ", ".join(real)),
        ("synthetic fields", ", ".join(name for name in fields if name not in real)),
        ("process that maps all measurements", line(about["process"])),
        ("distance between measurements", f"{about['sampling']:g}"),
        ("standard deviation of their noise", f"{about['noise']:g}"),
        ("missions are planned anew after", f"{about['leg']:g}"),
        ("share of the area above the threshold", f"{about['share_above']:g}"),
        ("stored routes", about["peers"]),
    ]


def draw_ratios(judged: Sequence[Aim]) -> Drawing:
    """Every comparison behind an aim, with the bound that the aim sets."""
    rows = [(each, comparison) for each in judged for comparison in each.comparisons]
    figure, grid = style.figure(0.9 + 0.23 * len(rows))
    axes = grid[0, 0]
    for row, (each, comparison) in enumerate(rows):
        ratio, colour = comparison.ratio, COLOURS[comparison.verdict]
        axes.plot([ratio.low, ratio.high], [row, row], color=colour, linewidth=2)
        axes.scatter([ratio.estimate], [row], s=20, color=colour, zorder=3)
        axes.plot([each.bound, each.bound], [row - 0.5, row + 0.5], color=style.INK, linewidth=0.9)
    axes.set_yticks(range(len(rows)), [_heading(*row) for row in rows], fontsize=7.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    style.quiet_grid(axes, "x")
    axes.set_xscale("log")
    axes.set_xlim(*DRAWN)
    axes.set_xticks(TICKS, [f"{100 * (tick - 1):+.0f}%".replace("+0%", "0%") for tick in TICKS])
    axes.minorticks_off()
    axes.set_xlabel("error against the rival's")
    return Drawing(
        figure,
        "Errors relative to the rivals'",
        "Ratio of sums of errors with its 95% interval over starts; the vertical line is the bound of the "
        "aim. Blue: within it; orange: beyond it; grey: not told apart by these starts. Some intervals are "
        "longer than the axis.",
        f"{counted(len(rows), 'ratio')} of errors with intervals.",
    )


def draw_routes(routes: Mapping[str, Any], title: str) -> Drawing:
    """The routes of each method from one start, in a panel each."""
    columns = 3
    figure, grid = style.figure(1.75 * -(-len(routes) // columns), -(-len(routes) // columns), columns)
    for axes in grid.flat[len(routes) :]:
        axes.set_visible(False)
    for axes, (method, waypoints) in zip(grid.flat, routes.items(), strict=False):
        route = np.asarray(waypoints)
        axes.plot(*route.T, color=style.BLUE, linewidth=1.0)
        axes.plot(*route[0], marker="o", color=style.BLUE, markersize=4)
        axes.set_title(style.wrapped(method, 18), fontsize=8.5)
        axes.set_aspect("equal")
        axes.set_xlim(0.0, 10.0)
        axes.set_ylim(0.0, 10.0)
        axes.set_xticks([])
        axes.set_yticks([])
    return Drawing(figure, "Routes", title, f"Routes of {counted(len(routes), 'method')} from one start.")


def _heading(each: Aim, comparison: Comparison) -> str:
    where = f", {comparison.where}" if comparison.where else ""
    return f"{each.short}{where}: {comparison.rival.replace('lawnmower from a corner', 'corner')}"


def in_words(comparison: Comparison) -> str:
    """The ratio as a change in percent, with its interval."""
    ratio = comparison.ratio
    if not np.isfinite([ratio.low, ratio.high]).all():
        return f"{100 * (ratio.estimate - 1):+.1f}%"
    low, high = (number(round(100 * (bound - 1), 1)) for bound in (ratio.low, ratio.high))
    return f"{100 * (ratio.estimate - 1):+.1f}% [{low}, {high}]"
