"""Export to three CSV files in long format."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from bojax.report.exporting.content import ExportedPoint
from bojax.results.store import make_folder, write_content


def write(points: Sequence[ExportedPoint], out: Path) -> None:
    """Write `curves.csv`, `scalars.csv` and `settings.csv` into a folder.

    Raises:
        ResultsError: The files cannot be written; one line.
    """
    curves = [
        (point.name, curve.name, curve.axis, *row)
        for point in points
        for curve in point.curves
        for row in curve.rows()
    ]
    scalars = [(point.name, *item) for point in points for item in point.scalars.items()]
    settings = [(point.name, *item) for point in points for item in point.settings.items()]
    make_folder(out)
    _write(out / "curves.csv", ("point", "curve", "axis", "x", "mean", "std"), curves)
    _write(out / "scalars.csv", ("point", "scalar", "value"), scalars)
    _write(out / "settings.csv", ("point", "setting", "value"), settings)


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_content(path, text.getvalue())
