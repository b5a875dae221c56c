"""Schemas of results tables: the name, type, unit and meaning of each column."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

DType: TypeAlias = Literal["float64", "float32", "int32", "int64", "bool", "string"]


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: Name in the file.
        dtype: Type of the values.
        unit: Unit of the values ("m", "rad", "s"); empty if they have none.
        doc: Meaning, one sentence.
        nullable: Whether -1 in a column of integers, and NaN in a column of floats, are stored as null.
        words: The values of a column of text. Compiled code, which has no text, gives their index.
    """

    name: str
    dtype: DType
    unit: str = ""
    doc: str = ""
    nullable: bool = False
    words: tuple[str, ...] = ()

    def __post_init__(self):
        if self.nullable and self.dtype in ("bool", "string"):
            raise ValueError(f"column {self.name}: only columns of numbers can be nullable, not {self.dtype}")
        if self.words and self.dtype != "string":
            raise ValueError(f"column {self.name}: only columns of text have words, not {self.dtype}")


Table: TypeAlias = tuple[Column, ...]


COMMON_COLUMNS = ("point", "label", "variant", "run", "seed", "nans")
"""Names of the columns that every `runs.parquet` has besides those of its experiment."""


def column_names(table: Sequence[Column]) -> tuple[str, ...]:
    """The names of a table's columns, in order."""
    return tuple(column.name for column in table)
