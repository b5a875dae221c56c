"""Small runs of the command line, and what their tables hold."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bojax.cli.main import main
from bojax.results.store import read_table


def run(folder: Path, *words: str, has_report: bool = False) -> Path:
    """The results folder of `bojax run`; the report takes longer than a small run, so it is left out."""
    with pytest.MonkeyPatch.context() as patch:
        if not has_report:
            patch.setattr("bojax.report.progress.report", lambda folder, **_: folder / "report.html")
        assert main(["run", *words, "--out", str(folder)]) == 0
    return folder


def tables(folder: Path, *names: str) -> Iterator[dict[str, list[Any]]]:
    """The columns of tables of a results folder, by default of its runs and of its steps."""
    for name in names or ("runs", "steps"):
        yield read_table(folder / f"{name}.parquet").to_pydict()
