"""The mean of a column of `runs.parquet` over a swept number."""

from bojax.report.drawing.base import Drawing
from bojax.report.drawing.curves import Chart
from bojax.report.drawing.swept import swept_panel
from bojax.report.source import Results

RANK = 90


def draw(results: Results) -> Drawing:
    """The mean of `report.column` over the swept number `report.over`, one curve per setting."""
    panel, over, column = swept_panel(results)
    return Chart([panel], over, is_swept=True).drawing(f"{column} over {over}".capitalize())
