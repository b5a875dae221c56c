"""What a column of a results table is: name, type, unit, meaning."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

DType: TypeAlias = Literal["float64", "float32", "int32", "int64", "bool", "string"]


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: The column's name in the file.
        dtype: Type of its values.
        unit: Unit of its values ("m", "rad", "s"); empty where there is none.
        doc: One sentence on its meaning.
        nullable: Compiled code has no null: there, a nullable integer says -1 and a nullable number NaN,
            which are stored as null.
        words: Compiled code has no text: there, a column of text says the place of its word in this list.
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


def column_names(table: Sequence[Column]) -> tuple[str, ...]:
    """The names of a table's columns, in order."""
    return tuple(column.name for column in table)
