"""Numbers that a user brings in a file."""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np


def read_array(file: str) -> "np.ndarray":
    """The table in a `.npy` or `.csv` file; a first line of names in a CSV file is passed over.

    Raises:
        ValueError: The file cannot be read, or holds no table of finite numbers; one line.
    """
    import numpy as np  # not at the start of every command

    path = Path(file)
    try:
        if path.suffix == ".npy":
            table = np.load(path, allow_pickle=False)
        elif path.suffix == ".csv":
            first, _, rest = path.read_text().partition("\n")
            if not (rest if not _is_numbers(first) else first).strip():
                raise ValueError(f"{file}: holds no numbers")
            table = np.loadtxt(path, delimiter=",", ndmin=2, skiprows=0 if _is_numbers(first) else 1)
        else:
            raise ValueError(f"{file}: the name has to end in .npy or .csv")
    except OSError as error:
        raise ValueError(f"{file}: {error.strerror or error}") from error
    except (ValueError, EOFError, UnicodeDecodeError) as error:
        message = " ".join(str(error).split())
        raise ValueError(message if message.startswith(file) else f"{file}: {message}") from error
    if table.ndim != 2 or not (np.issubdtype(table.dtype, np.number) or table.dtype == bool):
        raise ValueError(f"{file}: holds {table.dtype} of shape {table.shape}, not a table of numbers")
    table = table.astype(np.float64)
    bad = int((~np.isfinite(table)).sum())
    if bad:
        raise ValueError(f"{file}: {bad} of {table.size} numbers are not finite")
    return table


def sha256_of(file: str) -> str:
    """The SHA-256 of a file's content."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def _is_numbers(line: str) -> bool:
    try:
        [float(cell) for cell in line.split(",")]
    except ValueError:
        return False
    return True
