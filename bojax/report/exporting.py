"""Exports the results of a folder: as CSV files, or as runs of MLflow, TensorBoard or Weights & Biases.

Of each point these are its settings, its curves averaged over runs, and final numbers.
"""

import csv
import io
import logging
import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bojax.config.extras import needed
from bojax.logs import quiet
from bojax.report.comparing import methods
from bojax.report.source import Point, Results, load
from bojax.report.statistics import Floats
from bojax.report.tables import flatten
from bojax.report.text import file_name, plain
from bojax.results.folder import require_empty
from bojax.results.store import ResultsError, explained, make_folder, write_content
from bojax.text import error_line

_PARAMS, _METRICS = 100, 1000  # most parameters and metrics that MLflow takes at once
_LONGEST = 500  # longest value of a parameter that every store of MLflow takes, in characters


@dataclass(frozen=True, eq=False)
class MeanCurve:
    """A curve averaged over runs."""

    name: str  # phase and column, such as `train/return`; `accumulated_reward` of planning
    axis: str  # what `x` is: `episode` or `step`
    x: Floats  # `[n]` whole numbers in ascending order
    mean: Floats  # `[n]` mean over the runs that have a value there
    deviation: Floats  # `[n]` standard deviation over these runs, of n - 1; 0 for a single run

    def rows(self) -> list[tuple[int, float, float]]:
        """Its places as x, mean and standard deviation."""
        columns = (self.x.astype(np.int64), self.mean, self.deviation)
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def named_rows(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Its places as x, and the values there by name; the standard deviation has the ending `_std`."""
        return ((x, {self.name: mean, f"{self.name}_std": deviation}) for x, mean, deviation in self.rows())


@dataclass(frozen=True)
class ExportedPoint:
    """A point of a sweep, which becomes one run of another library."""

    sweep: str  # name of the sweep
    name: str  # name of the point
    index: int
    settings: Mapping[str, str]  # by dotted path, as text; the number of runs and the seed among them
    # By column of `runs.parquet`, the mean over the runs with a value; with the ending `_std` the standard
    # deviation over them, and `_runs` their number where other runs have none
    scalars: Mapping[str, float]
    curves: list[MeanCurve]

    @property
    def finals(self) -> dict[str, float]:
        """Its scalars, with the prefix `final/` that distinguishes them from curves."""
        return {f"final/{name}": value for name, value in self.scalars.items()}


def exported(results: Results) -> list[ExportedPoint]:
    """The points that have runs."""
    kind = methods.kind_of(results)
    points = []
    for point in results.run_points:
        about = {"runs": str(results.runs_of(point)["run"].size), "seed": plain(results.manifest.seed)}
        settings = dict(flatten(point.config)) | about
        found = settings, _scalars(results, point), _curves(results, point, kind == "learning")
        points.append(ExportedPoint(results.manifest.name, point.name, point.index, *found))
    return points


def _scalars(results: Results, point: Point) -> dict[str, float]:
    runs, scalars = results.runs_of(point), {}
    for name in methods.columns_of(results):
        values = runs.get(name, np.empty(0)).astype(np.float64)
        there = values[np.isfinite(values)]
        if there.size:
            scalars[name] = float(there.mean())
            scalars[f"{name}_std"] = float(there.std(ddof=1)) if there.size > 1 else 0.0
        if 0 < there.size < values.size:
            scalars[f"{name}_runs"] = float(there.size)
    return scalars


def _curves(results: Results, point: Point, is_learning: bool) -> list[MeanCurve]:
    if not is_learning:
        name = methods.PLANNING_CURVE
        return [_mean_curve(name, "step", 0, results.by_step(point, name))] if name in results.steps else []
    columns = [name for name in methods.columns_of(results) if name in results.episodes]
    known = results.episodes["phase"] if results.episodes else ()
    phases = [phase for phase in methods.PHASES if phase in known]
    return [
        _mean_curve(f"{phase}/{name}", "episode", 1, results.by_episode(point, name, phase))
        for phase in phases
        for name in columns
    ]


def _mean_curve(name: str, axis: str, first: int, values: Floats) -> MeanCurve:
    """The mean over the runs with a value at each place, from a first one on."""
    is_there = np.isfinite(values)
    known = is_there.any(axis=0)
    table, count = np.where(is_there, values, 0.0)[:, known], is_there.sum(axis=0)[known]
    mean = table.sum(axis=0) / count
    squares = np.where(is_there[:, known], table - mean, 0.0) ** 2
    deviation = np.sqrt(squares.sum(axis=0) / np.maximum(count - 1, 1))
    return MeanCurve(name, axis, first + np.flatnonzero(known).astype(np.float64), mean, deviation)


def export(folder: Path, target: str, out: Path | None = None) -> Path:
    """Write the points of a results folder as runs of another library, and return the folder written.

    It is new or empty, and by default `export/TARGET` in the results folder, which is not changed otherwise.
    The target is one of `TARGETS`; `MissingExtra` says which extra has the library of a target.
    """
    out = out or folder / "export" / target
    require_empty(out)
    points = exported(load(folder))
    if not points:
        raise ResultsError(f"{folder}: no run has been finished; allowed: at least one")
    TARGETS[target](points, out)
    return out


def to_csv(points: Sequence[ExportedPoint], out: Path) -> None:
    """Write `curves.csv`, `scalars.csv` and `settings.csv` into a folder."""
    curves = [
        (point.name, curve.name, curve.axis, *row)
        for point in points
        for curve in point.curves
        for row in curve.rows()
    ]
    scalars = [(point.name, *item) for point in points for item in point.scalars.items()]
    settings = [(point.name, *item) for point in points for item in point.settings.items()]
    make_folder(out)
    _write_rows(out / "curves.csv", ("point", "curve", "axis", "x", "mean", "std"), curves)
    _write_rows(out / "scalars.csv", ("point", "scalar", "value"), scalars)
    _write_rows(out / "settings.csv", ("point", "setting", "value"), settings)


def _write_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_content(path, text.getvalue())


def to_mlflow(points: Sequence[ExportedPoint], out: Path) -> None:
    """Write a run per point into the SQLite database `mlflow.db`, in an experiment named after the sweep.

    Curves are metrics by step, final numbers are metrics without a step, settings are parameters.
    """
    with needed("mlflow", "mlflow"):
        # mlflow-skinny can be imported without it, but has no database then.
        import sqlalchemy  # noqa: F401 # pyright: ignore[reportMissingImports]
        from mlflow import MlflowClient  # pyright: ignore[reportMissingImports]
        from mlflow.entities import Metric, Param  # pyright: ignore[reportMissingImports]
    make_folder(out)
    folder = out.resolve()
    with _refused(out, "MLflow"):
        with quiet("mlflow.store.db.utils", logging.WARNING):
            client = MlflowClient(tracking_uri=f"sqlite:///{folder / 'mlflow.db'}")
            artifacts = (folder / "artifacts").as_uri()
            experiment = client.create_experiment(points[0].sweep, artifact_location=artifacts)
        for point in points:
            run, now = client.create_run(experiment, run_name=point.name).info.run_id, int(1000 * time.time())
            params = [Param(key, value[:_LONGEST]) for key, value in point.settings.items()]
            metrics = [Metric(name, value, now, 0) for name, value in point.finals.items()]
            for curve in point.curves:
                for x, values in curve.named_rows():
                    metrics += [Metric(name, value, now, x) for name, value in values.items()]
            for start in range(0, len(params), _PARAMS):
                client.log_batch(run, params=params[start : start + _PARAMS])
            for start in range(0, len(metrics), _METRICS):
                client.log_batch(run, metrics=metrics[start : start + _METRICS])
            client.set_terminated(run)


def to_tensorboard(points: Sequence[ExportedPoint], out: Path) -> None:
    """Write a run of TensorBoard per point: its curves are scalars, its settings are hyper-parameters."""
    with needed("tensorboardX", "tensorboard"):
        from tensorboardX import SummaryWriter
        from tensorboardX.summary import hparams
    for point in points:
        folder = out / f"{point.index}-{file_name(point.name)}"
        with explained(folder), SummaryWriter(str(folder)) as writer:
            for curve in point.curves:
                for x, values in curve.named_rows():
                    for name, value in values.items():
                        writer.add_scalar(name, value, x)
            for name, value in point.finals.items():
                writer.add_scalar(name, value)
            events = writer.file_writer
            assert events is not None
            # `add_hparams` would open a second file, which may have the name of the first.
            for summary in hparams(dict(point.settings), dict(point.finals)):
                events.add_summary(summary)


def to_wandb(points: Sequence[ExportedPoint], out: Path) -> None:
    """Write an offline run per point, with its curves, its settings as config, and final numbers as summary.

    Nothing is sent: `wandb sync` uploads the runs. wandb may refuse a variable of the environment such as
    WANDB_BASE_URL, which is a `ResultsError`.
    """
    with needed("wandb", "wandb"):
        import wandb  # pyright: ignore[reportMissingImports]
    with _refused(out, "wandb"):
        silent = wandb.Settings(
            silent=True,
            console="off",
            save_code=False,
            x_disable_stats=True,
            x_disable_meta=True,
            x_save_requirements=False,
        )
        make_folder(out)
        for point in points:
            run = wandb.init(
                mode="offline",  # takes precedence over WANDB_MODE
                id=secrets.token_hex(4),  # over WANDB_RUN_ID, the same for all points
                dir=str(out),
                project=file_name(point.sweep),
                name=point.name,
                config=dict(point.settings),
                settings=silent,
                reinit="finish_previous",
            )
            _log(run, point)
            run.finish()
        wandb.teardown()  # the last file is complete only once the process that writes it has ended


def _log(run: Any, point: ExportedPoint) -> None:
    """Log the curves and the final numbers of a point to a run of wandb."""
    for axis in dict.fromkeys(curve.axis for curve in point.curves):
        rows: dict[int, dict[str, float]] = {}
        run.define_metric(axis)
        for curve in point.curves:
            if curve.axis == axis:
                run.define_metric(curve.name, step_metric=axis)
                run.define_metric(f"{curve.name}_std", step_metric=axis)
                for x, values in curve.named_rows():
                    rows.setdefault(x, {}).update(values)
        for x in sorted(rows):
            run.log({axis: x, **rows[x]})
    run.summary.update(point.finals)


@contextmanager
def _refused(out: Path, library: str) -> Iterator[None]:
    """Turn the errors of another library, which raises many types of exceptions, into a `ResultsError`."""
    try:
        yield
    except ResultsError:
        raise
    except Exception as error:
        told = f"{library} cannot write it ({error_line(error)}); the results are unchanged; try --to csv"
        raise ResultsError(f"{out}: {told}", exit_code=1) from error


TARGETS: Mapping[str, Callable[[Sequence[ExportedPoint], Path], None]] = {
    "csv": to_csv,
    "mlflow": to_mlflow,
    "tensorboard": to_tensorboard,
    "wandb": to_wandb,
}
"""The function that writes each target."""
