"""Settings of the areas that robots drive in."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal

import pydantic
from pydantic import Field

from bojax.config.component import RECORDED, Component
from bojax.fields.data import record_sha256

if TYPE_CHECKING:
    from bojax.areas.place import Place


class AreaSettings(Component, frozen=True):
    """An area that a robot may drive in."""

    role: ClassVar[str] = "area"
    plural: ClassVar[str] = "areas"


class OutlinedArea(AreaSettings, frozen=True):
    """Polygons with holes from a file (GeoJSON, KML), or the cells with data of a raster."""

    target: ClassVar[str] = "bojax.areas.outlined:OutlinedArea"
    kind: Literal["outline"] = "outline"
    file: str = Field(
        min_length=1,
        description="a file of polygons or a raster, relative to the working directory; degrees and map "
        "projections become metres",
    )
    avoid: tuple[str, ...] = Field(
        default=(), strict=False, description="files of no-go zones: polygons, or rasters with data in them"
    )
    below: float | None = Field(
        default=None, description="of a raster, only cells with values below it; null for all cells with data"
    )
    frame: str | None = Field(
        default=None,
        description="file of a field, or of polygons, whose origin and metres the area is given in; null for "
        "those of a field in degrees or a map projection, and otherwise the area's own, with its lower left "
        "corner at [0, 0]",
    )
    resolution: int = Field(
        default=400, ge=10, le=1500, description="cells along the longer side of the table of distances"
    )
    checks: int = Field(
        default=8, ge=1, description="points of the line between two poses of a path that must be inside"
    )
    sha256: str | None = Field(default=None, description="SHA-256 of the files; null to compute it")

    @pydantic.model_validator(mode="after")
    def _readable(self, info: pydantic.ValidationInfo) -> "OutlinedArea":
        if info.context is RECORDED and self.sha256 is not None:
            return self
        try:
            record_sha256(self, self.file, *self.avoid)
        except OSError as error:
            raise ValueError(f"{error.filename}: {error.strerror}") from error
        _ = self.place
        return self

    @property
    def place(self) -> "Place":
        """The area in metres."""
        from bojax.areas.place import read_outlined  # not at the start of every command

        return read_outlined(self.file, self.avoid, self.below, self.frame, self.sha256)

    @property
    def own_frame(self) -> str | None:
        """The file whose frame is that of the area; None for metres without a place on the Earth.

        Raises:
            ValueError: The area is a raster with an origin of its own.
        """
        from bojax.areas.polygons import SUFFIXES

        if self.frame is not None or self.place.projection.crs is None:
            return self.frame
        if not self.file.lower().endswith(SUFFIXES):
            raise ValueError(
                "region: a file needs problem.area.frame if the area is a raster; allowed: one, or an area "
                "of polygons"
            )
        return self.file

    def check_inside(self, points: Mapping[str, tuple[float, float]]) -> None:
        """Refuse points, by the names of their settings, outside the area or in different parts of it."""
        import numpy as np
        import shapely

        from bojax.areas.area import longer_side
        from bojax.areas.shapes import polygons_of, to_shape

        place = self.place
        parts = polygons_of(to_shape(place.area))
        held = [set(range(len(parts)))]
        tolerance = longer_side(place.area.bounds) / self.resolution / 2.0
        for name, (x, y) in points.items():
            near = np.flatnonzero(shapely.dwithin(parts, shapely.Point(x, y), tolerance))
            if not len(near):
                raise ValueError(f"{name}: ({x:g}, {y:g}) is not in the area, or lies in a hole of it")
            held.append(held[-1] & set(near.tolist()))
            if not held[-1]:
                raise ValueError(f"{name}: ({x:g}, {y:g}) lies in another part of the area than the start")
        if "end" in points and "start" not in points and len(parts) > 1:
            raise ValueError(
                f"start: got null; allowed: a point, as the end is in one of {len(parts)} parts of the area"
            )
