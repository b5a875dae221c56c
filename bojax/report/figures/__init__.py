"""The figures of a report, one file each: the figure `steps-to-goal` is `steps_to_goal.py`.

The module of a figure defines two names:

- `draw(results)` returns a `bojax.report.drawing.base.Drawing`, or raises `FigureUnavailable` with the reason
  why these results do not allow the figure. A column that they lack is such a reason by itself.
- `RANK` is its position on the page of a sweep that does not list its figures; the lowest comes first.
"""

import importlib
from types import ModuleType

from bojax.config.figures import figure_modules
from bojax.report.columns import NoColumn
from bojax.report.drawing.base import Drawing, FigureUnavailable
from bojax.report.source import Results


def draw(name: str, results: Results) -> Drawing:
    """Draw a figure; its module is imported only now."""
    try:
        return _module(name).draw(results)
    except NoColumn as error:
        raise FigureUnavailable(str(error)) from None


def ranked() -> list[str]:
    """The names of all figures, in the order of a page."""
    return sorted(figure_modules(), key=lambda name: _module(name).RANK)


def _module(name: str) -> ModuleType:
    return importlib.import_module(figure_modules()[name])
