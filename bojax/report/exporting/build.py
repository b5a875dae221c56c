"""Exports the results of a folder to one of the targets."""

import importlib
from pathlib import Path

from bojax.report.exporting.content import exported
from bojax.report.source import load
from bojax.results.folder import require_empty
from bojax.results.store import ResultsError


def export(folder: Path, target: str, out: Path | None = None) -> Path:
    """Write the points of a results folder as runs of another library, and return the folder written.

    Args:
        folder: The results folder, which is not changed apart from its subfolder `export`.
        target: `csv`, `mlflow`, `tensorboard` or `wandb`: the module `to_TARGET` of this package.
        out: Folder to write, new or empty; None for `export/TARGET` in the results folder.

    Raises:
        ResultsError: The results are missing, unfinished or damaged, no run was finished, or the folder is
            not empty; one line.
        MissingExtra: The library is not installed.
    """
    out = out or folder / "export" / target
    require_empty(out)
    points = exported(load(folder))
    if not points:
        raise ResultsError(f"{folder}: no run has been finished; allowed: at least one")
    importlib.import_module(f"bojax.report.exporting.to_{target}").write(points, out)
    return out
