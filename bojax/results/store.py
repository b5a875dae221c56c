"""Files of a results folder: names, atomic writes, checksums, and readers with one-line errors."""

import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

from bojax.errors import UserError
from bojax.text import one_line

MANIFEST = "manifest.json"
ARRAYS = "arrays"
LEARNERS = "learners"
WORK = ".work"
TUNING = "tuning.json"  # of a search by `bojax tune`: its plan, its points, and the posterior of its model
"""Name of the hidden folder of pieces and checkpoints, which only an unfinished results folder has."""

OUTPUT = "slurm-{}.out"
"""Name of the file in `.work` that holds the output of a task of Slurm."""

CHECKSUM = "sha256"
"""Key of the checksum in a JSON file with a checksum."""

ROW_GROUP_SIZE = 1 << 16
"""Rows of a row group, fixed so that equal tables give equal files."""


_WRONG_PATH = (
    errno.EACCES,
    errno.EEXIST,
    errno.EISDIR,
    errno.ELOOP,
    errno.ENAMETOOLONG,
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EPERM,
    errno.EROFS,
)
"""Errors caused by a wrong path; all others are failures of the machine."""


class ResultsError(UserError):
    """An error in a results folder."""


@contextmanager
def explained(path: Path, action: str = "written") -> Iterator[None]:
    """Turn errors of the file system at `path` into a `ResultsError` with advice."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            advice = "free some space, then run the command again, a sweep with --resume"
            raise ResultsError(f"{path}: the disk is full; {advice}", exit_code=1) from error
        code = 2 if error.errno in _WRONG_PATH else 1
        raise ResultsError(f"{path}: cannot be {action}: {error.strerror or error}", code) from error


def make_folder(folder: Path) -> None:
    """Create a folder and its parents if they do not exist."""
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)


def write_atomically(path: Path, write: Callable[[Path], Any], *, durably: bool = True) -> None:
    """Call `write` on a temporary file, sync the file to the disk if `durably`, then rename it to `path`."""
    temporary = path.with_name(f".{path.name}.tmp")
    with explained(path):
        try:
            write(temporary)
            if durably:
                sync(temporary)
            os.replace(temporary, path)
        except BaseException:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise


def sync(*paths: Path) -> None:
    """Sync files and the entries of folders to the disk, so that they survive a power failure."""
    for path in paths:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        except OSError as error:
            if error.errno != errno.EINVAL or not path.is_dir():  # some file systems cannot sync a folder
                raise
        finally:
            os.close(descriptor)


def link(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the file system has no links.

    Raises:
        FileNotFoundError: The file is gone.
        FileExistsError: The second name is taken. Of several processes, one succeeds.
        ResultsError: The second name cannot be written.
    """
    try:
        os.link(source, target)
    except (FileNotFoundError, FileExistsError):
        raise
    except OSError:
        with explained(target):
            with source.open("rb") as old, target.open("xb") as new:
                shutil.copyfileobj(old, new)
            sync(target)


def remove(path: Path) -> None:
    """Delete a file, or a folder with its content, if there is one; of a link, the link itself."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def fingerprint(path: Path) -> dict[str, Any] | None:
    """Size and SHA-256 of a file; None unless it is a regular file."""
    with explained(path, "read"):
        if not path.is_file():
            return None
        with path.open("rb") as file:
            return {"size": path.stat().st_size, "sha256": hashlib.file_digest(file, "sha256").hexdigest()}


def fingerprints(folder: Path) -> dict[str, Any]:
    """Size and SHA-256 of every file in a folder, by path in it."""
    with explained(folder, "read"):
        files = sorted(path for path in folder.rglob("*") if not path.is_dir())
    return {path.relative_to(folder).as_posix(): fingerprint(path) for path in files}


def require_unchanged(path: Path, sha256: str) -> None:
    """Refuse a file whose SHA-256 differs from the one in the manifest, or that is no regular file."""
    _require_file(path)
    found = fingerprint(path)
    if found is None or found["sha256"] != sha256:
        raise ResultsError(f"{path}: damaged or edited: its SHA-256 is not the one in {MANIFEST}")


def write_content(path: Path, content: str | bytes, *, durably: bool = True) -> None:
    """Write a file as `write_atomically` does; text is encoded as UTF-8, unpaired surrogates as `?`."""
    encoded = content.encode(errors="replace") if isinstance(content, str) else content
    write_atomically(path, lambda temporary: temporary.write_bytes(encoded), durably=durably)


def write_json(path: Path, content: Any, *, durably: bool = True, indent: int | None = 1) -> None:
    """Write a JSON file; non-finite numbers, which JSON lacks, become null."""
    write_content(path, json.dumps(_finite(content), indent=indent, allow_nan=False) + "\n", durably=durably)


def read_json(path: Path) -> Any:
    """Read a JSON file, or raise a `ResultsError`."""
    _require_file(path)
    try:
        return json.loads(path.read_text())
    except RecursionError:
        raise ResultsError(f"{path}: cannot be read: its values are nested too deeply") from None
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path}: cannot be read ({error}): was it truncated?") from error


def write_checked_json(path: Path, content: Mapping[str, Any], name: str | None = None) -> None:
    """Write a mapping as a JSON file with a checksum, in one line: Python is slow to indent.

    `name` is that under which the file is read, if it is another one: another file's content is refused.
    """
    plain = _finite(dict(content))
    write_json(path, {**plain, CHECKSUM: _digest(plain, name or path.name)}, indent=None)


def publish_checked_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file as `write_checked_json` does, unless it exists: of several processes, one succeeds."""
    own = path.with_name(f".{path.name}-{secrets.token_hex(6)}")
    write_checked_json(own, content, path.name)
    with suppress(FileExistsError):
        link(own, path)
    own.unlink()


def read_checked_json(path: Path) -> dict[str, Any]:
    """Read a file of `write_checked_json`, or raise a `ResultsError` if a value has changed."""
    content = read_json(path)
    if not isinstance(content, dict) or content.pop(CHECKSUM, None) != _digest(content, path.name):
        raise ResultsError(f"{path}: the content does not match the checksum")
    return content


def write_table(path: Path, table: pa.Table) -> None:
    """Write a Parquet file with page checksums; equal tables give equal files."""
    whole = table.combine_chunks()

    def write(temporary: Path) -> None:
        pq.write_table(whole, temporary, row_group_size=ROW_GROUP_SIZE, write_page_checksum=True)

    write_atomically(path, write)


def write_tables(path: Path, tables: Iterable[pa.Table]) -> None:
    """Write tables of one schema one after the other, as `write_table` would write them in one."""

    def write(temporary: Path) -> None:
        writer, left = None, None
        try:
            for table in tables:
                if writer is None:
                    writer = pq.ParquetWriter(temporary, table.schema, write_page_checksum=True)
                left = table if left is None else pa.concat_tables([left, table])
                whole = left.num_rows - left.num_rows % ROW_GROUP_SIZE
                for start in range(0, whole, ROW_GROUP_SIZE):
                    rows = left.slice(start, ROW_GROUP_SIZE).combine_chunks()
                    writer.write_table(rows, row_group_size=ROW_GROUP_SIZE)
                left = left.slice(whole)
            if writer is not None and left is not None and left.num_rows:
                writer.write_table(left.combine_chunks(), row_group_size=ROW_GROUP_SIZE)
        finally:
            if writer is not None:
                writer.close()

    write_atomically(path, write)


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a Parquet file and verify the checksums, or raise a `ResultsError`."""
    with _decoded(path), pq.ParquetFile(path, page_checksum_verification=True) as file:
        return file.read(columns=columns)


def read_footer(path: Path) -> pq.FileMetaData:
    """Schema and statistics of a Parquet file, or a `ResultsError`."""
    with _decoded(path):
        return pq.read_metadata(path)


@contextmanager
def _decoded(path: Path) -> Iterator[None]:
    """Turn errors of the decoders at `path`, which raise many types of exceptions, into a `ResultsError`."""
    _require_file(path)
    try:
        yield
    except Exception as error:
        reason = one_line(error).rstrip(".")
        raise ResultsError(f"{path}: not a readable parquet file ({reason}): was it truncated?") from error


def write_arrays(path: Path, arrays: Mapping[str, ArrayLike]) -> None:
    """Write named arrays to an npz file."""

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    write_atomically(path, write)


def array_file(point: int, run: int, name: str) -> str:
    """File name of a snapshot in `arrays/`, which is taken at the end of the run."""
    return f"{point}-{run}-{name}-end.npz"


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a results folder; raises a `ResultsError` if it is missing or damaged."""
    path = folder / MANIFEST
    if not os.path.isfile(path):
        raise ResultsError(f"{folder}: not a results folder (no {MANIFEST})")
    manifest = read_json(path)
    if not isinstance(manifest, dict):
        raise ResultsError(f"{path}: got a {type(manifest).__name__}; allowed: a mapping")
    return manifest


def _require_file(path: Path) -> None:
    """Refuse a missing file, and one that is not regular: opening a pipe would block."""
    if not os.path.lexists(path):
        raise ResultsError(f"{path}: no such file")
    if not os.path.isfile(path):
        raise ResultsError(f"{path}: cannot be read: not a regular file")


def _digest(content: Any, name: str) -> str:
    return hashlib.sha256(json.dumps([name, content]).encode()).hexdigest()


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
