"""Tables of numbers in files of the user."""

import hashlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from bojax.config.limits import NUMBERS, TEXT, read_within
from bojax.models.settings import GREATEST
from bojax.text import one_line

if TYPE_CHECKING:
    import numpy as np


def read_array(file: str) -> "np.ndarray":
    """The table in a `.npy` or `.csv` file; a header line of a CSV file is skipped.

    Raises:
        ValueError: The file cannot be read, or is not a table of finite numbers. The message is one line.
    """
    import numpy as np  # not at the start of every command

    path = Path(file)
    if os.path.exists(path) and not os.path.isfile(path):  # a pipe or a device may never end
        raise ValueError(f"{file}: is not a regular file")
    try:
        if path.suffix == ".npy":
            # Mapped rather than read: a header may claim more numbers than the file or the memory holds.
            with np.errstate(over="ignore"):  # of the size that the header claims
                table = np.load(path, allow_pickle=False, mmap_mode="r")
        elif path.suffix == ".csv":
            lines = _rows(read_within(TEXT, path, file).decode())
            if not lines:
                raise ValueError(f"{file}: holds no numbers")
            table = np.loadtxt(lines, delimiter=",", ndmin=2)
        else:
            raise ValueError(f"{file}: the name has to end in .npy or .csv")
    except OSError as error:
        raise ValueError(f"{file}: {error.strerror or error}") from error
    except Exception as error:  # a damaged file raises many types of exceptions
        message = one_line(error)
        raise ValueError(message if message.startswith(file) else f"{file}: {message}") from error
    if not isinstance(table, np.ndarray):
        raise ValueError(f"{file}: is an archive (.npz); a single array (.npy) is expected")
    is_real = table.dtype == bool or table.dtype.kind in "iuf"
    if table.ndim != 2 or not is_real or table.size == 0:
        raise ValueError(
            f"{file}: holds {table.dtype} of shape {table.shape}; a table of real numbers is expected"
        )
    NUMBERS.check(table.size, file)
    with np.errstate(over="ignore"):  # numbers beyond the range of float64 become infinite
        table = np.array(table, np.float64)
    bad = int((~np.isfinite(table)).sum())
    if bad:
        raise ValueError(f"{file}: {bad} of {table.size} numbers are not finite")
    if (largest := np.abs(table).max()) > GREATEST:
        raise ValueError(f"{file}: got {largest:g}; allowed: numbers up to {GREATEST:g} in magnitude")
    return table


def sha256_of(file: str) -> str:
    """The SHA-256 of a file's content."""
    with Path(file).open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def _rows(text: str) -> list[str]:
    """The lines without comments, and without the header if there is one."""
    lines = [line for line in (line.partition("#")[0] for line in text.splitlines()) if line.strip()]
    return lines if not lines or _is_numbers(lines[0]) else lines[1:]


def _is_numbers(line: str) -> bool:
    try:
        [float(cell) for cell in line.split(",")]
    except ValueError:
        return False
    return True
