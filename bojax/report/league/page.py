"""The page of a league, in HTML and in Markdown."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bojax.report import style
from bojax.report.league.aims import MISSED, OPEN, REACHED, Aim, judged
from bojax.report.league.figures import draw_ratios, draw_routes, in_words
from bojax.report.league.results import CELLS, League
from bojax.report.tables import Cell, Table
from bojax.report.template import fill
from bojax.report.text import counted, joined, line
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


def write_pages(folder: Path) -> list[Path]:
    """Write the page of the league in a folder, and its figures, and return the paths.

    Raises:
        ResultsError: There are no results in it.
    """
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
    starts = {len(by_start) for by_start in league.errors.values()}
    few, many = min(starts), max(starts)
    count = f"{many}" if few == many else f"{few} to {many}"
    return (
        f"{counted(real, 'real field')} and {len(league.fields) - real} synthetic ones on 10 x 10 units, "
        f"routes of length {joined(league.lengths)} from {count} starts. "
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
                means = [league.mean(measure, field, length, method) for method in methods]
                texts = ["" if mean is None else f"{mean.estimate:.{digits}f}" for mean in means]
                rows.append((field, [Cell(text) for text in texts]))
            tables[f"{measure}-{length}"] = Table(methods, rows, f"{title}, length {length}")
    return tables


def _comparisons(aims: list[Aim]) -> Table:
    rows = [
        (
            each.short,
            [Cell(text) for text in (
                comparison.where, comparison.rival, in_words(comparison), f"{comparison.starts}",
                comparison.verdict,
            )],
        )
        for each in aims
        for comparison in each.comparisons
    ]  # fmt: skip
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
