"""A mean over a swept number."""

from bojax.report import style
from bojax.report.drawing.base import Drawing
from bojax.report.drawing.swept import add_legend, add_swept, caption_of, ends_of, heading, read_curves
from bojax.report.source import Results

RANK = 90


def draw(results: Results) -> Drawing:
    """The mean of `report.column` over the swept number `report.over`, one curve per setting."""
    over, column, curves = read_curves(results)
    figure, grid = style.figure(3.6)
    add_swept(grid[0, 0], curves)
    grid[0, 0].set_xlabel(heading(over))
    grid[0, 0].set_ylabel(f"mean {heading(column)}")
    add_legend(figure, grid[0, 0], curves)
    return Drawing(
        figure=figure,
        title=f"{heading(column)} over {heading(over)}".capitalize(),
        caption=caption_of(column, over, curves),
        alt=f"Line chart of the mean {heading(column)} over {heading(over)}. {ends_of(curves)}.",
    )
