"""Tables of numbers in files of the user."""

import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bojax.config.limits import NUMBERS, TEXT, read_within
from bojax.fields.raster import DEGREES, with_holes
from bojax.fields.text_table import parse_table
from bojax.models.settings import GREATEST
from bojax.text import one_line

if TYPE_CHECKING:
    import numpy as np

_WITH_CHOICE = re.compile(r"(.+?\.(?:csv|txt|xyz|nc4?|tiff?)):(.*)", re.IGNORECASE)


def split_choice(file: str) -> tuple[str, str]:
    """The name of the file in `FILE:CHOICE`, and what is chosen of its content, empty for nothing."""
    found = None if os.path.exists(file) else _WITH_CHOICE.fullmatch(file)
    return (found[1], found[2]) if found else (file, "")


@contextmanager
def in_file(file: str) -> Iterator[None]:
    """Context of reading a file: an error becomes a ValueError of one line that begins with its name."""
    path = split_choice(file)[0]
    if os.path.exists(path) and not os.path.isfile(path):  # a pipe or a device may never end
        raise ValueError(f"{file}: is not a regular file")
    try:
        yield
    except ImportError:
        raise
    except OSError as error:
        raise ValueError(f"{file}: {error.strerror or one_line(error)}") from error
    except Exception as error:  # a damaged file raises many types of exceptions
        message = one_line(error)
        raise ValueError(message if message.startswith(path) else f"{file}: {message}") from error


@dataclass(frozen=True, eq=False)
class Points:
    """Values at points, from a file."""

    rows: "np.ndarray"  # `[N, 3]`: x, y and value
    names: list[str]  # names of these columns; none if the file has none
    left_out: int = 0  # number of rows without data, which are left out

    @property
    def label(self) -> str:
        """Name of the values; empty if the file has none."""
        return self.names[2] if self.names else ""

    @property
    def cells(self) -> "tuple[np.ndarray, np.ndarray]":
        """The points `[N, 2]`, and their values `[N]`."""
        return self.rows[:, :2], self.rows[:, 2]

    def thinned(self, most: int) -> "Points":
        """The points, or every nth of them so that at most `most` remain."""
        return replace(self, rows=self.rows[:: -(-len(self.rows) // most)])

    @property
    def crs(self) -> str | None:
        """Coordinate reference system: degrees if a column is a longitude by its name; None if unknown."""
        return DEGREES if self.names and self.names[0].lower().startswith("lon") else None

    def check_degrees(self) -> None:
        """Refuse positions that cannot be longitudes and latitudes."""
        import numpy as np

        for column, (kind, largest) in enumerate((("longitudes", 360), ("latitudes", 90))):
            name = self.names[column] if self.names else str(column + 1)
            most = self.rows[np.abs(self.rows[:, column]).argmax(), column]
            if abs(most) > largest:
                allowed = f"{kind} from -{largest} to {largest}, in degrees"
                raise ValueError(f"column {name}: got {most:.10g}; allowed: {allowed}")


def read_array(file: str, allows_holes: bool = False) -> "np.ndarray":
    """The table in a `.npy` or `.csv` file with any delimiter; a header line of a CSV file is skipped.

    With `allows_holes`, numbers may be NaN, which also replaces those that mean missing data.
    """
    return _checked(_read_table(file)[0], file, allows_holes)


def read_points(file: str) -> Points:
    """Rows of x, y and value in a `.csv`, `.xyz`, `.txt` or `.npy` file.

    Columns are chosen by their names (x or lon, y or lat, and z, value, depth, ... or the only other one);
    `FILE.csv:NAME` chooses the values. Without the names of x and y there must be three columns. Columns of
    text are ignored, and rows without data are left out.
    """
    path, chosen = split_choice(file)
    table, names = _read_table(path, ignores_text=True)
    columns = _columns(table, names, chosen, path)
    table = _checked(table[:, columns], path, allows_holes=True)
    has_data = (table == table).all(axis=1)
    if not has_data.any():
        raise ValueError(f"{path}: no row has data")
    names = [names[column] for column in columns] if names else []
    points = Points(table[has_data], names, int((~has_data).sum()))
    if points.crs == DEGREES:
        with in_file(path):
            points.check_degrees()
    return points


def read_waypoints(file: str) -> "np.ndarray":
    """Waypoints `[W, 2]` in a `.csv` or `.npy` file, m: its columns x and y, or its only two columns."""
    table, names = _read_table(file)
    table = _checked(table, file, allows_holes=False)
    lowered = [name.lower() for name in names]
    if {"x", "y"} <= set(lowered):
        table = table[:, [lowered.index("x"), lowered.index("y")]]
    if table.shape[1] != 2 or len(table) < 2:
        shape = f"{table.shape[0]} rows and {table.shape[1]} columns"
        raise ValueError(f"{file}: got {shape}; allowed: columns x and y, and at least 2 rows")
    return table


X_NAMES = ("x", "lon", "longitude", "east", "easting")
Y_NAMES = ("y", "lat", "latitude", "north", "northing")
VALUE_NAMES = ("z", "value", "values", "depth", "elevation", "height", "measurement")


def _columns(table: "np.ndarray", names: list[str], chosen: str, file: str) -> list[int]:
    """The columns of x, y and value: by their names, or the only three if neither x nor y has a name."""
    if chosen and not names:
        raise ValueError(f"{file}: got column {chosen}, but the columns have no names; allowed: {file}")
    lowered = [name.lower() for name in names]
    x, y = (next((lowered.index(n) for n in known if n in lowered), None) for known in (X_NAMES, Y_NAMES))
    if x is None or y is None:
        if x is None and y is None and len(table.T) == 3 and not chosen:
            return [0, 1, 2]
        if not names:
            raise ValueError(f"{file}: got {table.shape[1]} columns; allowed: 3, which are x, y and value")
        unknown = [known for column, known in ((x, X_NAMES), (y, Y_NAMES)) if column is None]
        missing = ", and ".join(f"a column {' or '.join(known)}" for known in unknown)
        raise ValueError(f"{file}: got columns {', '.join(names)}; missing: {missing}")
    rest = [column for column in range(len(names)) if column not in (x, y)]
    rest = [column for column in rest if (table[:, column] == table[:, column]).any()] or rest
    if chosen:
        values = [column for column in rest if lowered[column] == chosen.lower()]
    else:
        values = [column for column in rest if lowered[column] in VALUE_NAMES] or rest
    if len(values) == 1:
        return [x, y, values[0]]
    if not rest:
        raise ValueError(f"{file}: has no column of values beside {names[x]} and {names[y]}")
    listed = ", ".join(names[column] for column in rest)
    if chosen:
        raise ValueError(f"{file}: got column {chosen}; allowed: {listed}")
    raise ValueError(f"{file}: holds several columns of values; allowed: {file}:NAME with one of {listed}")


def _read_table(file: str, ignores_text: bool = False) -> "tuple[np.ndarray, list[str]]":
    import numpy as np  # not at the start of every command

    path, names = Path(file), list[str]()
    with in_file(file):
        if (suffix := path.suffix.lower()) == ".npy":
            # Mapped rather than read: a header may claim more numbers than the file or the memory holds.
            with np.errstate(over="ignore"):  # of the size that the header claims
                table = np.load(path, allow_pickle=False, mmap_mode="r")
        elif suffix in (".csv", ".xyz", ".txt"):
            # Names may be written in another encoding; numbers are the same in all that are common.
            text = read_within(TEXT, path, file).decode("utf-8-sig", errors="replace")
            table, names = parse_table(text, ignores_text)
        else:
            raise ValueError(f"{file}: the name has to end in .npy or .csv")
    if not isinstance(table, np.ndarray):
        raise ValueError(f"{file}: is an archive (.npz); a single array (.npy) is expected")
    is_real = table.dtype == bool or table.dtype.kind in "iuf"
    if table.ndim != 2 or not is_real or table.size == 0:
        raise ValueError(
            f"{file}: holds {table.dtype} of shape {table.shape}; a table of real numbers is expected"
        )
    NUMBERS.check(table.size, file)
    return table, names


def _checked(table: "np.ndarray", file: str, allows_holes: bool) -> "np.ndarray":
    """The numbers of a table of the file, NaN for those that mean missing data if holes are allowed."""
    import numpy as np

    with np.errstate(over="ignore"):  # numbers beyond the range of float64 become infinite
        table = np.array(table, np.float64)
    if allows_holes:
        table = with_holes(table)
    bad = int((~np.isfinite(table)).sum())
    if bad and not allows_holes:
        raise ValueError(f"{file}: {bad} of {table.size} numbers are not finite")
    if bad == table.size:
        raise ValueError(f"{file}: no cell has data")
    if (largest := np.nanmax(np.abs(table))) > GREATEST:
        raise ValueError(f"{file}: got {largest:g}; allowed: numbers up to {GREATEST:g} in magnitude")
    return table


def sha256_of_files(*files: str) -> str:
    """The SHA-256 of the content of a file, or of those of several; `FILE:CHOICE` stands for its file."""
    digests = []
    for file in files:
        with Path(split_choice(file)[0]).open("rb") as content:
            digests.append(hashlib.file_digest(content, "sha256").hexdigest())
    return digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()


def record_sha256(settings: Any, *files: str) -> None:
    """Set `sha256` of settings to that of their files, so that a run resumes with the same files only.

    A file that cannot be read is an `OSError`.
    """
    digest = sha256_of_files(*files)
    if settings.sha256 is None:
        object.__setattr__(settings, "sha256", digest)
    elif settings.sha256 != digest:
        name, its = ("the file", "its") if len(files) == 1 else (f"one of {len(files)} files", "their")
        raise ValueError(f"{files[0]}: {name} has changed: {its} SHA-256 differs")
