"""Tables of numbers in text, with any delimiter, and with or without names of the columns."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

_MISSING = ("", "na", "n/a", "nan", "null", "none", "--", "-")


def parse_table(text: str) -> "tuple[np.ndarray, list[str]]":
    """The numbers `[N, C]` of a table and the names of its columns, none if it has no header.

    Columns are separated by semicolons, tabs, commas or spaces; with semicolons, a comma is a decimal point.
    Text after # is a comment. Empty cells and NA are NaN.

    Raises:
        ValueError: There are no numbers, a cell is not a number, or rows differ in length.
    """
    import numpy as np

    lines = [line for line in (line.partition("#")[0].strip(" \r") for line in text.splitlines()) if line]
    delimiter = _delimiter(lines[0]) if lines else None
    names: list[str] = []
    if lines and not _is_numbers(_cells(lines[0], delimiter)):
        names = [cell.strip('"').lower() for cell in _cells(lines[0], delimiter)]
        lines = lines[1:]
    if not lines:
        raise ValueError("holds no numbers")
    if delimiter == ";":
        lines = [line.replace(",", ".") for line in lines]
    try:
        table = np.loadtxt(lines, delimiter=delimiter, ndmin=2)
    except ValueError:
        rows = [_cells(line, delimiter) for line in lines]
        filled = [["nan" if cell.lower() in _MISSING else cell for cell in row] for row in rows]
        if filled == rows:
            raise
        table = np.loadtxt([";".join(row) for row in filled], delimiter=";", ndmin=2)
    return table, names if len(names) == table.shape[1] else []


def _delimiter(line: str) -> str | None:
    return next((sign for sign in (";", "\t", ",") if sign in line), None)


def _cells(line: str, delimiter: str | None) -> list[str]:
    return [cell.strip() for cell in line.split(delimiter)]


def _is_numbers(cells: list[str]) -> bool:
    try:
        [float(cell.replace(",", ".")) for cell in cells if cell.lower() not in _MISSING]
    except ValueError:
        return False
    return any(cell.lower() not in _MISSING for cell in cells)
