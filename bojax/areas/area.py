"""Areas to survey: polygons with holes and no-go zones in metres, and the distance to their border."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

Ring = np.ndarray
"""Corners of a closed line, `[P, 2]` in metres; the last corner is joined to the first."""

PAIRS = 4_000_000  # of a point and an edge that are held in memory at once
LARGEST_GRID = 4_000_000  # cells of a grid


@dataclass(frozen=True, eq=False)
class Area:
    """An area in the plane: polygons with holes, minus no-go zones. Immutable.

    Attributes:
        outline: Borders of the polygons and of their holes, in any order: a point is inside if a ray from it
            crosses them an odd number of times.
        avoid: No-go zones, each given by the borders of its polygons and holes; zones may overlap.
    """

    outline: tuple[Ring, ...]
    avoid: tuple[tuple[Ring, ...], ...] = ()

    def __post_init__(self) -> None:
        outline = tuple(map(_ring, () if self.outline is None else self.outline))
        if not outline:
            raise ValueError("area: has no outline; allowed: at least one ring of three corners")
        object.__setattr__(self, "outline", outline)
        object.__setattr__(self, "avoid", tuple(tuple(map(_ring, zone)) for zone in self.avoid))

    @classmethod
    def rectangle(cls, x_min: float, y_min: float, x_max: float, y_max: float) -> "Area":
        """A rectangle, m.

        Raises:
            ValueError: A side has no length.
        """
        if not (x_min < x_max and y_min < y_max):
            raise ValueError(f"area: got sides of {x_max - x_min:g} and {y_max - y_min:g} m; allowed: > 0")
        return cls((np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]]),))

    def without(self, zones: Iterable[Sequence[Ring]]) -> "Area":
        """The area with more no-go zones."""
        return Area(self.outline, (*self.avoid, *map(tuple, zones)))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """`(x_min, y_min, x_max, y_max)` of the outline, m."""
        corners = np.concatenate(self.outline)
        (x_min, y_min), (x_max, y_max) = corners.min(0), corners.max(0)
        return float(x_min), float(y_min), float(x_max), float(y_max)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether each of the points `[N, 2]` is in the area, which its border belongs to up to rounding."""
        points = np.asarray(points, float).reshape(-1, 2)
        inside = _is_inside(self.outline, points)
        for zone in self.avoid:
            inside &= ~_is_inside(zone, points)
        return inside

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Signed distance of the points `[N, 2]` to the border, m, negative outside.

        It is exact inside the area. Outside, where an exact distance would have to follow the border of a
        union, it is the largest distance that one of the outline and the zones asks for, which may be too
        small, but has the right sign.
        """
        points = np.asarray(points, float).reshape(-1, 2)
        distance = _signed_distance(self.outline, points)
        for zone in self.avoid:
            distance = np.minimum(distance, -_signed_distance(zone, points))
        return distance

    def axes(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates x and y of a grid that extends beyond the outline by two cells, m.

        Raises:
            ValueError: The grid would have too many points.
        """
        x_min, y_min, x_max, y_max = self.bounds
        columns, rows = (
            _axis(x_min - 2 * spacing, x_max + 2 * spacing, spacing),
            _axis(y_min - 2 * spacing, y_max + 2 * spacing, spacing),
        )
        _check_size(columns, rows)
        return columns, rows

    def grid(self, spacing: float) -> np.ndarray:
        """Centres `[M, 2]` of the cells of a square grid that are in the area, m.

        Raises:
            ValueError: The grid would have too many cells, or no cell of it is in the area.
        """
        x_min, y_min, x_max, y_max = self.bounds
        half = spacing / 2
        points = _mesh(_axis(x_min + half, x_max, spacing), _axis(y_min + half, y_max, spacing))
        inside = points[self.contains(points)]
        if not len(inside):
            raise ValueError(f"area: no cell of {spacing:g} m lies in it; allowed: a smaller spacing")
        return inside


def longer_side(bounds: tuple[float, float, float, float]) -> float:
    """The longer side of a box `(x_min, y_min, x_max, y_max)`."""
    return max(bounds[2] - bounds[0], bounds[3] - bounds[1])


def check_inside(
    area: Area,
    point: np.ndarray,
    name: str,
    given: Sequence[float] | None = None,
    bounds: tuple[float, float, float, float] | None = None,
) -> None:
    """Refuse a point `[2]` outside an area, m; up to a thousandth of a millimetre, it is on the border.

    The message calls the point `name`. `given` and `bounds` are the point and the bounds of the area in the
    coordinates that it shows, if these are others.
    """
    if area.contains(point[None])[0] or area.distances(point[None])[0] >= -1e-6:
        return
    x_min, y_min, x_max, y_max = area.bounds if bounds is None else bounds
    within = f"x from {x_min:.8g} to {x_max:.8g} and y from {y_min:.8g} to {y_max:.8g}"
    got = ",".join(f"{value:.8g}" for value in (point if given is None else given))
    raise ValueError(f"{name}: got {got}, which is not in the area; allowed: points in it, with {within}")


def _ring(corners: np.ndarray) -> Ring:
    """The corners of a ring as read-only numbers, without a last one that repeats the first."""
    try:
        ring = np.array(corners, float)
    except (TypeError, ValueError) as error:  # text, or rows of different lengths
        raise ValueError("area: a ring is not an array of numbers; allowed: rows of x and y") from error
    if ring.ndim != 2 or ring.shape[1] != 2:
        raise ValueError(f"area: got a ring of shape {ring.shape}; allowed: rows of x and y")
    if not np.isfinite(ring).all():
        raise ValueError("area: a corner is not finite; allowed: numbers in metres")
    if len(ring) > 1 and (ring[0] == ring[-1]).all():
        ring = ring[:-1]
    if len(ring) < 3:
        raise ValueError(f"area: got a ring of {len(ring)} corners; allowed: at least 3")
    ring.flags.writeable = False
    return ring


def _axis(low: float, high: float, spacing: float) -> np.ndarray:
    if not spacing > 0 or not np.isfinite(spacing):
        raise ValueError(f"spacing: got {spacing:g}; allowed: > 0 m")
    number = int(min(np.ceil((high - low) / spacing), LARGEST_GRID)) + 1
    return low + spacing * np.arange(number)


def _mesh(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Points `[H * W, 2]` of a grid, row by row."""
    _check_size(columns, rows)
    x, y = np.meshgrid(columns, rows)
    return np.stack([x.ravel(), y.ravel()], axis=1)


def _check_size(columns: np.ndarray, rows: np.ndarray) -> None:
    if len(columns) * len(rows) > LARGEST_GRID:
        raise ValueError(
            f"spacing: the grid would have more than {LARGEST_GRID:,} points; allowed: a larger one"
        )


def edges_of(rings: Sequence[Ring]) -> tuple[np.ndarray, np.ndarray]:
    """First and last points `[E, 2]` of the edges of some rings."""
    return np.concatenate(list(rings)), np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])


def _is_inside(rings: Sequence[Ring], points: np.ndarray) -> np.ndarray:
    """Whether a ray in the direction of x crosses the rings an odd number of times, for each point."""
    first, last = edges_of(rings)
    rise = last[:, 1] - first[:, 1]
    slope = (last[:, 0] - first[:, 0]) / np.where(rise == 0.0, 1.0, rise)  # a level edge is never crossed
    inside = np.zeros(len(points), bool)
    step = max(1, PAIRS // len(first))
    for begin in range(0, len(points), step):
        x, y = points[begin : begin + step, :, None].transpose(1, 0, 2)
        spans = (first[:, 1] > y) != (last[:, 1] > y)
        crossed = spans & (x < first[:, 0] + (y - first[:, 1]) * slope)
        inside[begin : begin + step] = crossed.sum(1) % 2 == 1
    return inside


def _signed_distance(rings: Sequence[Ring], points: np.ndarray) -> np.ndarray:
    """Distance to the nearest edge of the rings, negative outside."""
    first, last = edges_of(rings)
    along = last - first
    squared = np.maximum((along**2).sum(1), np.finfo(float).tiny)  # a repeated corner has no length
    distance = np.empty(len(points))
    step = max(1, PAIRS // len(first))
    for begin in range(0, len(points), step):
        offset = points[begin : begin + step, None] - first
        share = np.clip((offset * along).sum(-1) / squared, 0.0, 1.0)
        nearest = ((offset - share[..., None] * along) ** 2).sum(-1).min(1)
        distance[begin : begin + step] = np.sqrt(nearest)
    return np.where(_is_inside(rings, points), distance, -distance)
