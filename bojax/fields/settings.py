"""Settings of the fields that robots monitor."""

import abc
import math
from typing import Annotated, Any, ClassVar, Literal

import pydantic
from pydantic import Field
from typing_extensions import override

from bojax.config.component import RECORDED, Component
from bojax.config.errors import note_once
from bojax.config.limits import CELLS, square
from bojax.fields.data import record_sha256
from bojax.fields.raster_files import FORMATS, local_extent, read_local_points, read_raster
from bojax.models.settings import GREATEST

Pair = Annotated[tuple[float, float], Field(strict=False)]


def proper_box(box: tuple[float, ...]) -> tuple[float, ...]:
    """`box`; a ValueError unless its lower bounds are below its upper ones."""
    if not (box[0] < box[2] and box[1] < box[3]):
        raise ValueError("allowed: [x_min, y_min, x_max, y_max] with x_min < x_max and y_min < y_max")
    return box


Box = Annotated[tuple[float, float, float, float], Field(strict=False), pydantic.AfterValidator(proper_box)]
"""`[x_min, y_min, x_max, y_max]`, m."""


class FieldSettings(Component, frozen=True):
    """A field: a scalar function of position."""

    role: ClassVar[str] = "field"
    plural: ClassVar[str] = "fields"
    protocol: ClassVar[str] = "bojax.fields.base:Field"


class Bumps(FieldSettings, frozen=True):
    """A sum of Gaussian bumps and pits."""

    target: ClassVar[str] = "bojax.fields.closed_form:Bumps"
    kind: Literal["bumps"] = "bumps"
    heights: tuple[float, ...] = Field(
        default=(1.0,), strict=False, min_length=1, description="heights of the bumps; negative for a pit"
    )
    centres: tuple[Pair, ...] = Field(
        default=((0.0, 0.0),), strict=False, min_length=1, description="centres, a list of [x, y], m"
    )
    widths: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        default=(1.0,), strict=False, min_length=1, description="standard deviations, m"
    )

    @pydantic.model_validator(mode="after")
    def _as_many_of_each(self) -> "Bumps":
        if not len(self.heights) == len(self.centres) == len(self.widths):
            raise ValueError(
                f"heights, centres, widths: got {len(self.heights)}, {len(self.centres)} and "
                f"{len(self.widths)} entries; allowed: the same number of each"
            )
        return self


class Step(FieldSettings, frozen=True):
    """A smooth step across a straight line (thesis, Fig. 3.1)."""

    target: ClassVar[str] = "bojax.fields.closed_form:Step"
    kind: Literal["step"] = "step"
    point: Pair = Field(default=(0.0, 0.0), description="a point on the line, [x, y], m")
    direction: float = Field(default=math.pi / 4, description="direction of the rise, across the line, rad")
    height: float = Field(default=1.0, description="half the difference between the two levels")
    width: float = Field(default=0.5, gt=0, description="width, m; the slope on the line is height / width")


class Blocks(FieldSettings, frozen=True):
    """Axis-parallel blocks with sharp edges on a floor of height 0 (thesis, Section 3.5.2)."""

    target: ClassVar[str] = "bojax.fields.closed_form:Blocks"
    kind: Literal["blocks"] = "blocks"
    boxes: tuple[Box, ...] = Field(
        default=((0.0, 0.0, 1.0, 1.0),),
        strict=False,
        min_length=1,
        description="footprints, a list of [x_min, y_min, x_max, y_max], m",
    )
    heights: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        default=(1.0,), strict=False, min_length=1, description="heights, m; overlapping: the highest"
    )

    @pydantic.model_validator(mode="after")
    def _as_many_of_each(self) -> "Blocks":
        if len(self.boxes) != len(self.heights):
            raise ValueError(
                f"boxes, heights: got {len(self.boxes)} and {len(self.heights)} entries; allowed: the same "
                "number of each"
            )
        return self

    @property
    def blocks(self) -> tuple[tuple[float, ...], ...]:
        """`(x_min, y_min, x_max, y_max, height)` of each block, m."""
        return tuple((*box, height) for box, height in zip(self.boxes, self.heights, strict=True))


class _Measured(FieldSettings, frozen=True):
    file: str = Field(min_length=1, description=f"a file relative to the working directory: {FORMATS}")
    extent: Box | None = Field(
        default=None,
        description="area of the data or outermost grid points, [x_min, y_min, x_max, y_max], m; null for "
        "that of the file, from [0, 0] if its coordinates are degrees or a map projection",
    )
    sha256: str | None = Field(default=None, description="SHA-256 of the file; null to compute it")

    @pydantic.field_validator("extent")
    @classmethod
    def _limited_extent(cls, extent: Any) -> Any:
        if extent is not None and max(map(abs, extent)) > GREATEST:
            raise ValueError(f"allowed: numbers up to {GREATEST:g} in magnitude")
        return extent

    @pydantic.model_validator(mode="after")
    def _readable(self, info: pydantic.ValidationInfo) -> "_Measured":
        if info.context is RECORDED and self.sha256 is not None:
            return self
        extent = self._check()
        if self.extent is None:
            # The results record the extent, as drawings of them need it without the file.
            object.__setattr__(self, "extent", proper_box(extent))
        record_sha256(self, self.file)
        return self

    @abc.abstractmethod
    def _check(self) -> tuple[float, float, float, float]:
        """The extent of the data in the file, m, whose values are checked."""


class Grid(_Measured, frozen=True):
    """Values on a regular grid; in a table of numbers, the first axis is y, the second x, both increasing."""

    target: ClassVar[str] = "bojax.fields.measured:GridField"
    kind: Literal["grid"] = "grid"
    holes: Literal["refuse", "nearest"] = Field(
        default="refuse",
        description="cells without data are an error, or have the value of the nearest cell with data",
    )

    @override
    def _check(self) -> tuple[float, float, float, float]:
        raster = read_raster(self.file)
        number, size = int(raster.is_hole.sum()), raster.values.size
        if number and self.holes == "refuse":
            allowed = 'allowed: data in all, or holes: "nearest"'
            raise ValueError(f"{self.file}: {number} of {size} cells have no data; {allowed}")
        for note in raster.notes if self.extent is None else ():
            note_once(f"note: {self.file}: {note} Set `extent` to give the size of the grid.")
        return local_extent(raster)


class Scattered(_Measured, frozen=True):
    """Linear interpolation of measurements at scattered points: rows of x, y and value."""

    target: ClassVar[str] = "bojax.fields.measured:ScatteredField"
    kind: Literal["scattered"] = "scattered"
    resolution: Annotated[int, CELLS.bound(square)] = Field(
        default=101, ge=2, description="points per side of the grid that the measurements are interpolated on"
    )

    @override
    def _check(self) -> tuple[float, float, float, float]:
        rows = read_local_points(self.file)
        (x_min, y_min), (x_max, y_max) = rows[:, :2].min(0), rows[:, :2].max(0)
        return float(x_min), float(y_min), float(x_max), float(y_max)
