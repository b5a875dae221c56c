"""Tables of numbers in text, with any delimiter, and with or without names of the columns."""

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

_MISSING = ("", "na", "n/a", "nan", "null", "none", "--", "-")


def parse_table(text: str, ignores_text: bool = False) -> "tuple[np.ndarray, list[str]]":
    """The numbers `[N, C]` of a table and the names of its columns, none if it has no header.

    Columns are separated by semicolons, tabs, commas or spaces; with semicolons, a comma is a decimal point.
    Text after # is a comment, quotation marks are left out, and empty cells and NA are NaN. With
    `ignores_text`, columns without a number, such as times or names, are left out. Messages name the line of
    the text, from 1.
    """
    import numpy as np

    lines = [line.partition("#")[0].replace('"', "").strip(" \r") for line in text.splitlines()]
    numbers = [number for number, line in enumerate(lines, start=1) if line]
    lines = [line for line in lines if line]
    delimiter = _delimiter(lines[0]) if lines else None
    names: list[str] = []
    if lines and not _is_numbers(_cells(lines[0], delimiter)):
        names = _cells(lines[0], delimiter)
        lines, numbers = lines[1:], numbers[1:]
    if not lines:
        raise ValueError("holds no numbers")
    if delimiter == ";":
        lines = [line.replace(",", ".") for line in lines]
    try:
        table = _load(lines, delimiter, numbers)
    except ValueError:
        rows = [_cells(line, delimiter) for line in lines]
        for number, row in zip(numbers, rows, strict=True):
            if len(row) != len(rows[0]):
                columns = f"line {number} has {len(row)} columns, and line {numbers[0]} has {len(rows[0])}"
                raise ValueError(f"{columns}; allowed: rows of equal length") from None
        filled = [["nan" if cell.lower() in _MISSING else cell for cell in row] for row in rows]
        is_text = _text_columns(filled) if ignores_text else [False] * len(rows[0])
        if filled == rows and not any(is_text):
            raise
        if any(is_text):
            filled = [
                ["nan" if no else cell for no, cell in zip(is_text, row, strict=True)] for row in filled
            ]
        table = _load([(delimiter or " ").join(row) for row in filled], delimiter, numbers)
        names = names if len(names) == len(is_text) else []
        names = [name for name, no in zip(names, is_text, strict=False) if not no]
        if _is_numbers(names):  # the first line is a row
            raise ValueError("columns of text have no names; allowed: a first line with names") from None
        table = table[:, ~np.array(is_text)]
    return table, names if len(names) == table.shape[1] else []


def _load(lines: list[str], delimiter: str | None, numbers: list[int]) -> "np.ndarray":
    """The table in lines with these numbers, one of which an error names instead of NumPy's row, from 0."""
    import numpy as np

    try:
        return np.loadtxt(lines, delimiter=delimiter, ndmin=2)
    except ValueError as error:
        place = re.compile(r"at row (\d+)(?=, column)")
        raise ValueError(place.sub(lambda row: f"on line {numbers[int(row[1])]}", str(error))) from error


def _text_columns(rows: list[list[str]]) -> list[bool]:
    """Whether each column holds text and no number."""
    columns = [[cell for cell in column if cell != "nan"] for column in zip(*rows, strict=True)]
    return [bool(cells) and not any(_is_numbers([cell]) for cell in cells) for cells in columns]


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
