"""The figures of a report, by module: the figure `steps-to-goal` is the function `steps_to_goal` of `curves`.

Its function takes the results, and returns a `bojax.report.drawing.base.Drawing`, or raises
`FigureUnavailable` with the reason why these results do not allow the figure. A column that they lack is such
a reason by itself.
"""

import importlib

from bojax.config.figures import FIGURES
from bojax.report.columns import NoColumn
from bojax.report.drawing.base import Drawing, FigureUnavailable
from bojax.report.source import Results


def draw(name: str, results: Results) -> Drawing:
    """Draw a figure; its module is imported only now."""
    module = importlib.import_module(f"bojax.report.figures.{FIGURES[name]}")
    try:
        return getattr(module, name.replace("-", "_"))(results)
    except NoColumn as error:
        raise FigureUnavailable(str(error)) from None
