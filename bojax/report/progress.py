"""Builds a report, and shows its progress and its verdicts on standard error."""

import time
from pathlib import Path

from rich.console import Console
from rich.status import Status

from bojax.report.build import build_report
from bojax.report.verdicts import print_verdicts

PATIENCE = 1.0  # seconds before progress is shown


def report(folder: Path, *, is_brief: bool = False) -> Path:
    """Write the report of a sweep, and return the path of the page.

    Meanwhile a terminal shows the stage, and a log file gets one line. The verdicts are printed at the end,
    or only counted if `is_brief`.
    """
    console, begin = Console(stderr=True), time.monotonic()
    status, has_spoken = Status("", console=console), False

    def at(stage: str) -> None:
        nonlocal has_spoken
        if time.monotonic() - begin < PATIENCE:
            return
        if console.is_terminal:
            status.update(f"report: {stage}")
            status.start()
        elif not has_spoken:
            console.print(
                f"writing the report of {folder} ...", markup=False, highlight=False, soft_wrap=True
            )
        has_spoken = True

    try:
        page = build_report(folder, at)
    finally:
        status.stop()
    print_verdicts(folder, is_brief=is_brief)
    return page
