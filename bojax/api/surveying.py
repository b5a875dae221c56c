"""`bojax.survey`: plan the route of a survey from Python."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
from typing_extensions import override

from bojax.api.command import run_in_child
from bojax.api.errors import BojaxError, in_one_line
from bojax.api.plain_values import path_of
from bojax.api.start import Folder
from bojax.config.errors import shown
from bojax.report.surveying import SURVEY, survey_summary
from bojax.results.folder import dated_folder, require_empty
from bojax.results.store import read_json


@dataclass(frozen=True)
class SurveyResult:
    """A planned survey.

    Attributes:
        folder: Its folder, with the waypoints, the figures and `report.html`.
    """

    folder: Path

    @cached_property
    def _plan(self) -> dict[str, Any]:
        return read_json(self.folder / SURVEY)

    @cached_property
    def _table(self) -> pyarrow.Table:
        name = "waypoints.csv" if len(self.routes) == 1 else "waypoints-1.csv"
        return pyarrow.csv.read_csv(self.folder / name)

    @property
    def waypoints(self) -> np.ndarray:
        """The proposed route, `[W, 2]` in metres; of several robots, the first one's."""
        return self.routes[0]

    @property
    def routes(self) -> list[np.ndarray]:
        """The proposed route of each robot, `[W, 2]` in metres."""
        return [np.array(route) for route in self.candidates[0]["routes"]]

    @property
    def degrees(self) -> np.ndarray | None:
        """Its longitudes and latitudes, `[W, 2]`; None for an area without a place on the Earth."""
        if "longitude" not in self._table.column_names:
            return None
        return np.stack([self._table[name].to_numpy() for name in ("longitude", "latitude")], axis=1)

    @property
    def candidates(self) -> list[dict[str, Any]]:
        """All routes that were compared, the proposed one first.

        Each has `name`, `method`, `length`, `routes`, and the expected `errors` after `distances`.
        """
        return self._plan["candidates"]

    @override
    def __str__(self) -> str:
        return survey_summary(self.folder)


def survey(
    area: str | Path | tuple[float, float],
    *,
    budget: float | str | None = None,
    time: str | None = None,
    speed: float | None = None,
    start: Sequence[float] | Sequence[Sequence[float]] | None = None,
    end: Sequence[float] | Sequence[Sequence[float]] | None = None,
    avoid: str | Path | Sequence[str | Path] = (),
    below: float | None = None,
    prior: str | Path | None = None,
    goal: str = "map",
    lengthscale: float | None = None,
    spacing: float | None = None,
    sampling: float | None = None,
    robots: int = 1,
    separation: float | None = None,
    turning_radius: float | str | None = None,
    lawnmower: bool = False,
    out: Folder | None = None,
) -> SurveyResult:
    """Plan the route of a survey, as `bojax survey`, in a process of its own.

    Args:
        area: File of polygons or of a raster, or the width and height of a rectangle, m.
        budget: Maximum length of the route, m, or text such as `"2km"`; without it, the area is covered.
        time: Maximum duration instead, such as `"40min"`; needs `speed`.
        speed: Speed of the robot, m/s.
        start: First point, in the coordinates of `area`; of all robots, or a list with one for each.
        end: Last point, or points.
        avoid: File of no-go zones, or files.
        below: Of a raster, only cells with values below this number are surveyed.
        prior: File of an earlier survey of the field, from which the model is learned.
        goal: Places that count: `"map"` for all, `"hotspots"` for the highest tenth, `"threshold=V"` for
            those near a value, `"region=FILE"` for those in the polygons of a file.
        lengthscale: Distance over which values are alike, m; learned or assumed by default.
        spacing: Least distance between two lines of a lawnmower, m.
        sampling: Distance between two measurements, m.
        robots: Number of robots that survey at once, 1 to 4; each has the budget.
        separation: Least distance of two robots at equal times, m, but for twice as many metres from a common
            start or to a common end.
        turning_radius: Least radius of the turns of the route, m; turns on the spot by default.
        lawnmower: Whether to compare lawnmowers only.
        out: New or empty folder; `results/survey/TIME` by default.

    Raises:
        BojaxError: The input is wrong; the message is one line.
    """
    with in_one_line():
        allowed = "a path, or a tuple (width, height)"
        is_size = isinstance(area, tuple)
        name = "x".join(f"{side:g}" for side in area) if is_size else path_of(area, "area", allowed)
        folder = dated_folder("survey") if out is None else Path(path_of(out, "out"))
        require_empty(folder)
    options = {"budget": budget, "time": time, "speed": speed, "below": below, "prior": prior}
    options |= {"goal": goal}
    options |= {"lengthscale": lengthscale, "spacing": spacing, "sampling": sampling, "out": folder}
    options |= {"robots": robots, "separation": separation, "turning-radius": turning_radius}
    words = [f"--{option}={value}" for option, value in options.items() if value is not None]
    for option, given in (("start", start), ("end", end)):
        try:
            points = np.empty((0, 2)) if given is None else np.atleast_2d(np.asarray(given, float))
        except (TypeError, ValueError) as error:
            allowed = "two numbers, or a list of two for each robot"
            raise BojaxError(f"{option}: got {shown(given)}; allowed: {allowed}") from error
        words += [f"--{option}={','.join(repr(float(value)) for value in point)}" for point in points]
    zones = [avoid] if isinstance(avoid, str | Path) else avoid
    words += [f"--avoid={file}" for file in zones] + (["--lawnmower"] if lawnmower else [])
    ended = run_in_child(["survey", name, *words], None)
    if ended.code != 0:
        raise BojaxError(ended.error, "\n".join(ended.lines))
    return SurveyResult(folder.absolute())
