"""Errors of the route of `bojax survey` over those of its best lawnmower on the odd fields of the league.

    python benchmarks/odd_fields.py --starts 4 --json odd.json

Odd fields have holes or walls, or are not stationary. Each is surveyed twice: to a free end, and back to the
start. A ratio is that of the sums over the lengths, with its 95% interval over the starts.
"""

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from bojax.report.league.aims import ODD
from bojax.report.statistics import ratio_interval
from bojax.surveys.league.cells import LENGTHS
from bojax.surveys.league.fields import MODEL, Field, league
from bojax.surveys.league.routes import SPACING, start_of, surveyed
from bojax.surveys.league.scores import scores_of
from bojax.surveys.planning import Demand, plan_survey

ENDS, MEASURES = ("free", "start"), ("rmse", "deviation")
Errors = dict[tuple[str, str, str], list[tuple[float, float]]]
"""By field, end and measure: for each start, the sums over the lengths of the route and of the lawnmower."""


def main(argv: Sequence[str]) -> int:
    """Plan and score all routes, and print a table after each start."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--starts", type=int, default=4, choices=range(1, 21), help="number of starts (4)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the errors to a file")
    args = parser.parse_args(argv)
    jax.config.update("jax_enable_x64", True)
    fields = [field for field in league() if field.name in ODD]
    errors: Errors = defaultdict(list)
    for index in range(args.starts):
        for field in fields:
            for end in ENDS:
                scores = np.array(list(_scores(field, index, end))).sum(axis=0)
                for measure, (own, lawnmower) in zip(MEASURES, scores, strict=True):
                    errors[field.name, end, measure].append((float(own), float(lawnmower)))
        if index:  # an interval needs two
            Console().print(_table(errors, [field.name for field in fields]))
        if args.json:
            args.json.write_text(json.dumps({"/".join(key): rows for key, rows in errors.items()}, indent=1))
    return 0


def _scores(field: Field, index: int, end: str) -> Iterator[list[tuple[float, float]]]:
    """For each length, the measures of the proposed route and of the best lawnmower."""
    part = surveyed(field.area)
    start = start_of(part, index)
    for length in LENGTHS:
        demand = Demand(length, start, None if end == "free" else start, sampling=SPACING)
        survey = plan_survey(part, MODEL, demand)
        found = [
            scores_of(field, each.routes[0], length, index) for each in (survey.chosen, survey.lawnmower)
        ]
        yield [(found[0][measure], found[1][measure]) for measure in MEASURES]


def _table(errors: Errors, fields: Sequence[str]) -> Table:
    table = Table(title=f"bojax over its lawnmower, {len(next(iter(errors.values())))} starts")
    for heading in ("field", "end", *MEASURES):
        table.add_column(heading)
    for end in ENDS:
        for name, together in [*((field, [field]) for field in fields), ("all", fields)]:
            cells = []
            for measure in MEASURES:
                sums = np.sum([errors[field, end, measure] for field in together], axis=0)
                ratio = ratio_interval(sums[:, 0], sums[:, 1])
                cells.append(f"{100 * (ratio.estimate - 1):+.1f}% [{100 * (ratio.low - 1):.1f}, "
                             f"{100 * (ratio.high - 1):.1f}]")  # fmt: skip
            table.add_row(name, end, *cells)
    return table


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
