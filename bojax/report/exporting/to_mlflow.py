"""Export to runs of MLflow, one per point."""

import logging
import time
from collections.abc import Sequence
from pathlib import Path

from bojax.config.extras import MissingExtra
from bojax.logs import quiet
from bojax.report.exporting.content import ExportedPoint
from bojax.results.store import ResultsError, make_folder
from bojax.text import error_line

_PARAMS, _METRICS = 100, 1000
"""Most parameters and metrics that MLflow takes at once."""

_LONGEST = 500
"""Longest value of a parameter that every store of MLflow takes, in characters."""


def write(points: Sequence[ExportedPoint], out: Path) -> None:
    """Write a run per point into the SQLite database `mlflow.db`, in an experiment named after the sweep.

    Curves are metrics by step, final numbers are metrics without a step, settings are parameters.

    Raises:
        MissingExtra: MLflow is not installed.
        ResultsError: MLflow refuses the store; one line.
    """
    try:
        # mlflow-skinny can be imported without it, but has no database then.
        import sqlalchemy  # noqa: F401 # pyright: ignore[reportMissingImports]
        from mlflow import MlflowClient  # pyright: ignore[reportMissingImports]
        from mlflow.entities import Metric, Param  # pyright: ignore[reportMissingImports]
        from mlflow.exceptions import MlflowException  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtra("mlflow", "mlflow") from error
    make_folder(out)
    folder = out.resolve()
    try:
        with quiet("mlflow.store.db.utils", logging.WARNING):
            client = MlflowClient(tracking_uri=f"sqlite:///{folder / 'mlflow.db'}")
            artifacts = (folder / "artifacts").as_uri()
            experiment = client.create_experiment(points[0].sweep, artifact_location=artifacts)
        for point in points:
            run, now = client.create_run(experiment, run_name=point.name).info.run_id, int(1000 * time.time())
            params = [Param(key, value[:_LONGEST]) for key, value in point.settings.items()]
            metrics = [Metric(f"final/{name}", value, now, 0) for name, value in point.scalars.items()]
            for curve in point.curves:
                for x, mean, deviation in curve.rows():
                    metrics.append(Metric(curve.name, mean, now, x))
                    metrics.append(Metric(f"{curve.name}_std", deviation, now, x))
            for start in range(0, len(params), _PARAMS):
                client.log_batch(run, params=params[start : start + _PARAMS])
            for start in range(0, len(metrics), _METRICS):
                client.log_batch(run, metrics=metrics[start : start + _METRICS])
            client.set_terminated(run)
    except MlflowException as error:
        raise ResultsError(f"{out}: MLflow: {error_line(error)}") from error
