"""Export to offline runs of Weights & Biases, one per point."""

from collections.abc import Sequence
from pathlib import Path

from bojax.config.extras import MissingExtra
from bojax.report.exporting.content import ExportedPoint
from bojax.results.store import make_folder


def write(points: Sequence[ExportedPoint], out: Path) -> None:
    """Write an offline run per point, with its curves, its settings as config, and final numbers as summary.

    Nothing is sent: `wandb sync` uploads the runs.

    Raises:
        MissingExtra: wandb is not installed.
    """
    try:
        import wandb  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtra("wandb", "wandb") from error
    make_folder(out)
    quiet = wandb.Settings(
        silent=True,
        console="off",
        save_code=False,
        x_disable_stats=True,
        x_disable_meta=True,
        x_save_requirements=False,
    )
    for point in points:
        run = wandb.init(
            mode="offline",
            dir=str(out),
            project=point.sweep,
            name=point.name,
            config=dict(point.settings),
            settings=quiet,
            reinit="finish_previous",
        )
        for axis in dict.fromkeys(curve.axis for curve in point.curves):
            rows: dict[int, dict[str, float]] = {}
            run.define_metric(axis)
            for curve in point.curves:
                if curve.axis == axis:
                    run.define_metric(curve.name, step_metric=axis)
                    run.define_metric(f"{curve.name}_std", step_metric=axis)
                    for x, mean, deviation in curve.rows():
                        rows.setdefault(x, {}).update({curve.name: mean, f"{curve.name}_std": deviation})
            for x in sorted(rows):
                run.log({axis: x, **rows[x]})
        run.summary.update({f"final/{name}": value for name, value in point.scalars.items()})
        run.finish()
    wandb.teardown()  # the last file is complete only once the process that writes it has ended
