"""The figures of a report, found by discovery: their names are known without importing what draws them."""

from pathlib import Path

_FOLDER = Path(__file__).resolve().parent.parent / "report" / "figures"

TABLES = ("latency",)
"""Names that `report.figures` may also hold: tables that are on every page."""


def figure_modules() -> dict[str, str]:
    """The module of every figure, by the name that `report.figures` uses, in alphabetical order.

    The figure `steps-to-goal` is the file `bojax/report/figures/steps_to_goal.py`. A trailing underscore is
    not part of the name: the figure `settings` is `settings_.py`, because every module called `settings` is
    imported as one of schemas, see `bojax.config.catalog`.
    """
    stems = sorted(file.stem for file in _FOLDER.glob("[!_]*.py"))
    return {stem.rstrip("_").replace("_", "-"): f"bojax.report.figures.{stem}" for stem in stems}
