"""Export to event files of TensorBoard, one folder per point."""

from collections.abc import Sequence
from pathlib import Path

from bojax.config.extras import MissingExtra
from bojax.report.exporting.content import ExportedPoint
from bojax.report.text import file_name
from bojax.results.store import explained


def write(points: Sequence[ExportedPoint], out: Path) -> None:
    """Write a run of TensorBoard per point, with its curves as scalars and its settings as hyper-parameters.

    Raises:
        MissingExtra: tensorboardX is not installed.
    """
    try:
        from tensorboardX import SummaryWriter
        from tensorboardX.summary import hparams
    except ImportError as error:
        raise MissingExtra("tensorboardX", "tensorboard") from error
    for point in points:
        folder = out / f"{point.index}-{file_name(point.name)}"
        with explained(folder), SummaryWriter(str(folder)) as writer:
            for curve in point.curves:
                for x, mean, deviation in curve.rows():
                    writer.add_scalar(curve.name, mean, x)
                    writer.add_scalar(f"{curve.name}_std", deviation, x)
            scalars = {f"final/{name}": value for name, value in point.scalars.items()}
            for name, value in scalars.items():
                writer.add_scalar(name, value)
            events = writer.file_writer
            assert events is not None
            # `add_hparams` would open a second file, whose name may be that of the first.
            for summary in hparams(dict(point.settings), scalars):
                events.add_summary(summary)
