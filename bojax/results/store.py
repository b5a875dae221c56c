"""Files of a results folder: names, atomic writes, and reading with errors of one line."""

import errno
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

MANIFEST = "manifest.json"
ARRAYS = "arrays"
LEARNERS = "learners"
WORK = ".work"
"""Hidden subfolder of parts and checkpoints: a results folder that has one is unfinished."""

ROW_GROUP_SIZE = 1 << 16
"""Rows of a row group, fixed so that equal tables are equal files."""


class ResultsError(Exception):
    """What is wrong with a results folder, in one line.

    Attributes:
        exit_code: 2 where the input is to be mended, 1 where the machine failed.
    """

    def __init__(self, message: str, exit_code: int = 2):
        super().__init__(message)
        self.exit_code = exit_code


def one_line(error: BaseException) -> str:
    """The type of an exception and the first line of its message."""
    text = str(error).strip().splitlines()
    return f"{type(error).__name__}: {text[0]}" if text else type(error).__name__


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn failures of writing at `path` into one line that says what to do."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            message = f"{path}: the disk is full: free some space, then run again with --resume"
            raise ResultsError(message, exit_code=1) from error
        raise ResultsError(f"{path}: cannot be written: {error.strerror or error}") from error


def write_atomically(path: Path, write: Callable[[Path], Any]) -> None:
    """Let `write` fill a file under a temporary name, then rename it to `path`."""
    temporary = path.with_name(f".{path.name}.tmp")
    with explained(path):
        try:
            write(temporary)
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file; non-finite numbers become null, which JSON has no word for."""
    text = json.dumps(_finite(content), indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text))


def read_json(path: Path) -> Any:
    """Read a JSON file, or raise a `ResultsError`."""
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise ResultsError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path}: cannot be read ({error}): was it truncated?") from error


def write_table(path: Path, table: pa.Table) -> None:
    """Write a parquet file that depends on nothing but the table."""
    whole = table.combine_chunks()
    write_atomically(path, lambda temporary: pq.write_table(whole, temporary, row_group_size=ROW_GROUP_SIZE))


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a parquet file, or raise a `ResultsError`."""
    try:
        with pq.ParquetFile(path) as file:
            return file.read(columns=columns)
    except FileNotFoundError:
        raise ResultsError(f"{path}: no such file") from None
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise ResultsError(f"{path}: not a readable parquet file ({reason}): was it truncated?") from error


def write_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write an npz file of named arrays."""

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    write_atomically(path, write)


def array_file(point: int, run: int, name: str, when: str) -> str:
    """Name of a snapshot's file in `arrays/`."""
    return f"{point}-{run}-{name}-{when}.npz"


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a results folder, or a `ResultsError` if it is none."""
    if not (folder / MANIFEST).is_file():
        raise ResultsError(f"{folder}: not a results folder (it has no {MANIFEST})")
    return read_json(folder / MANIFEST)


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
