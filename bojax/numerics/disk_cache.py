"""A cache on the disk, beside JAX's compiled programs, for what takes seconds to find.

Entries are bytes; those of `EXECUTABLES` are machine code, which XLA runs. `bojax.engine.devices.prepare`
therefore uses a folder only if it belongs to the user and nobody else can write to it.
"""

import contextlib
import hashlib
import os
import stat
import tempfile
import time
from pathlib import Path

import jax

PROGRAMS, EXECUTABLES, KERNELS = FOLDERS = "programs", "executables", "kernels"
"""Folders of traced programs, of compiled ones, and of answers to whether a robot can be a kernel."""

_UNUSED_SECONDS = 30 * 24 * 3600
"""Time after which an entry that was not used is deleted."""

_DIGEST_BYTES = hashlib.sha256().digest_size


def folder_of(what: str) -> Path | None:
    """A folder of the cache, below JAX's; None if JAX's cache is off or not on a local disk."""
    folder, is_on = (
        jax.config.values[f"jax_{name}"] for name in ("compilation_cache_dir", "enable_compilation_cache")
    )
    if folder is None or "://" in folder or not is_on:
        return None
    return Path(folder) / what


def write(name: str, content: bytes, where: str = PROGRAMS) -> bool:
    """Write an entry in one of `FOLDERS`, whole or not at all, with a checksum over its name and content."""
    folder = folder_of(where)
    if folder is None:
        return False
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            try:
                # The name is part of the checksum: an entry that was copied to another name is refused.
                file.write(_checksum(name, content) + content)
                file.flush()
                os.replace(file.name, folder / name)
            except OSError:  # a full disk must not be filled further
                os.unlink(file.name)
                raise
    except OSError:  # the next sweep compiles again
        return False
    return True


def read(name: str, where: str = PROGRAMS) -> bytes | None:
    """The content of an entry in one of `FOLDERS`; None if it is missing, damaged, or no regular file."""
    folder = folder_of(where)
    try:
        content = b"" if folder is None else content_of(folder / name)
    except OSError:
        return None
    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    return content if digest == _checksum(name, content) else None


def _checksum(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + b"\0" + content).digest()


def content_of(path: Path) -> bytes:
    """The content of a regular file, which is marked as used; opening a pipe would block.

    Raises:
        OSError: There is no such file, or it is not a regular one.
    """
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(f"{path} is not a regular file")
        with contextlib.suppress(OSError):  # of a file system that is mounted for reading
            os.utime(file.fileno())
        return file.read()


def drop_unused() -> None:
    """Delete the entries that were not used for a month."""
    oldest = time.time() - _UNUSED_SECONDS
    for folder in filter(None, map(folder_of, FOLDERS)):
        with contextlib.suppress(OSError):  # there is none, or another process is deleting them
            for path in folder.iterdir():
                if path.stat().st_mtime < oldest:
                    path.unlink()
