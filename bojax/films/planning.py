"""A film of a run of a planner: the path, the plan of each step, the robot, and its belief about a field."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.markers import MarkerStyle
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D
from PIL import Image
from typing_extensions import override

from bojax.config.component import External
from bojax.films.film import MAX_FRAMES, SLOWEST, STILL, Film, blank, photograph
from bojax.films.recorded import Drive, Leg
from bojax.films.scenes import RobotScene
from bojax.report.drawing.domains import draw_outline, fit_square
from bojax.report.drawing.maps import QUIET, draw_map
from bojax.report.drawing.smooth import smooth
from bojax.report.statistics import Floats
from bojax.report.style import BLUE, INK, ORANGE, drawn_text
from bojax.report.text import file_name
from bojax.results.store import ResultsError

if TYPE_CHECKING:
    from bojax.robots.models import RobotModel

MAX_IMAGES_PER_STEP = 12  # images per step of a robot without a body, whose path is interpolated

_BOTTOM, _TOP = 0.03, 0.84
_ARROW = Outline([(1.0, 0.0), (-0.9, 0.75), (-0.45, 0.0), (-0.9, -0.75), (1.0, 0.0)])


class PlanningFilm(Film):
    """The steps of a run, one after the other.

    The main image shows a robot with a body in its world, or else the map of the domain with the path and
    the plan. Beside it are mean and standard deviation of the belief about a field, if there is one, or else
    the map if the main image shows the robot, which may be drawn from another MJCF file.
    """

    def __init__(self, drive: Drive, model: Path | None = None):
        self._drive = drive
        self._model, is_free, longest = None, False, MAX_IMAGES_PER_STEP
        if drive.legs[0].frames is not None:
            (self._model, is_free), longest = _robot_of(drive, model), len(drive.legs[0].frames)
        self._per_step = min(max(1, MAX_FRAMES // len(drive.legs)), longest)
        self._curves = [_poses(leg, is_free) for leg in drive.legs]
        self.name = f"{file_name(drive.point.name)}-run{drive.run}"
        self.num_images = self._per_step * len(drive.legs) + 1
        self.seconds = SLOWEST
        self._maps = ("truth", *_BELIEF) if "truth" in drive.belief else (None,)

    @override
    def images(self) -> Iterator[Image.Image]:
        num_beside = len(self._maps) - 1 or int(self._model is not None)
        figure = blank(4.2 + (0.0, 3.0, 2.0)[num_beside], 4.6)
        main, *beside = _panels(figure, num_beside)
        with self._drawn(main) as (body, views):
            shown = zip(beside, self._maps[-num_beside:], strict=False)
            views += [_Map(each, self._drive, name) for each, name in shown]
            legs, edge = self._drive.legs, 0.1 / figure.get_figwidth()
            problem = self._drive.point.problem
            title = f"{problem.kind if problem else ''}: {self._drive.point.name}, run {self._drive.run}"
            figure.text(edge, 0.945, drawn_text(title), color=INK, fontsize=10)
            status = figure.text(edge, 0.89, "", color=INK, fontsize=10)
            outcome = figure.text(1.0 - edge, 0.945, "", color=BLUE, fontsize=10, ha="right", weight="bold")
            if any(leg.plan is not None for leg in legs) and any(view.shows_plan for view in views):
                planned = {"color": ORANGE, "fontsize": 10, "ha": "right"}
                figure.text(1.0 - edge, 0.89, "dashed: plan", **planned)
            for index in range(len(legs)):
                is_last = index == len(legs) - 1
                for share in (np.arange(self._per_step + is_last) / self._per_step).tolist():
                    paid = [0.0, *(leg.accumulated for leg in legs)][index + (share == 1.0)]
                    status.set_text(f"step {index + 1} of {len(legs)}, return so far {paid:.4g}")
                    outcome.set_text(self._drive.outcome if share == 1.0 else "")
                    self._show(index, share, body, views)
                    yield photograph(figure)

    @override
    def still(self, share: float) -> Image.Image:
        figure = blank(*STILL)
        at = share * len(self._drive.legs)
        index = min(int(at), len(self._drive.legs) - 1)
        with self._drawn(figure.add_axes((0.0, 0.0, 1.0, 1.0))) as (body, views):
            self._show(index, at - index, body, views)
            return photograph(figure)

    def _show(self, index: int, share: float, body: RobotScene | None, views: "list[_Map]") -> None:
        """Update all views to the given fraction of a step."""
        leg, curve = self._drive.legs[index], self._curves[index]
        at = round(share * (len(curve) - 1))
        if body is not None and leg.frames is not None:
            body.show(leg.frames[round(share * (len(leg.frames) - 1))])
        path = np.concatenate([curve[:, :2] for curve in self._curves[:index]] + [curve[: at + 1, :2]])
        for view in views:
            view.believe(index + (share == 1.0))
            view.move(path, curve[at], leg if share < 1.0 else None)

    @contextmanager
    def _drawn(self, axes: Axes) -> "Iterator[tuple[RobotScene | None, list[_Map]]]":
        """The main image: the robot in its world, or a map."""
        if self._model is None:
            yield None, [_Map(axes, self._drive, self._maps[0])]
            return
        with closing(RobotScene(axes, self._model)) as body:
            yield body, []


class _Map:
    """The domain from above, with the path so far, the plan, the robot, and possibly values of a field."""

    def __init__(self, axes: Axes, drive: Drive, name: Literal["truth", "mean", "std"] | None = None):
        self.name = name
        self.shows_plan = name != "std"  # there, path and plan would hide the values
        self._drive = drive
        draw_outline(axes, drive.point.outline)
        if drive.point.outline.border is None:
            plans = [leg.plan for leg in drive.legs if leg.plan is not None]
            shown = [drive.legs[0].before[None], *(leg.poses for leg in drive.legs), *plans]
            fit_square(axes, np.concatenate(shown)[:, :2], 1.0)
        axes.set_xticks([])
        axes.set_yticks([])
        self._image: AxesImage | None = None
        if name is not None:
            self._image = _values(axes, drive, name)
            axes.set_title(_TITLES[name], fontsize=9, pad=3)
        spot = "white" if name in _BELIEF else BLUE
        # The deviation is dark blue at first, and nearly white where samples were taken.
        line = "white" if name == "mean" else INK
        scale = 1.0 if axes.get_window_extent().width > 300 else 0.7
        style: dict[str, Any] = {"zorder": 5, "solid_capstyle": "round"}
        (self._path,) = axes.plot([], [], color=spot, linewidth=1.8 * scale, **style)
        dashes = (0, (2.5, 1.5))
        (self._plan,) = axes.plot([], [], color=ORANGE, linewidth=1.8 * scale, linestyle=dashes, zorder=6)
        start = drive.legs[0].before
        axes.plot(*start[:2], "o", ms=5 * scale, mfc="white", mec=line, mew=1.2 * scale, zorder=4.8)
        (self._robot,) = axes.plot([], [], color=spot, markersize=13 * scale, mec=INK, mew=0.8, zorder=7)

    def believe(self, step: int) -> None:
        """Show the belief after the given number of steps."""
        if self._image is not None and self.name in _BELIEF:
            maps = self._drive.belief.get(f"{self.name}s")
            self._image.set_data(self._drive.belief[self.name] if maps is None else maps[step])

    def move(self, path: Floats, pose: Floats, leg: Leg | None) -> None:
        """Show the path so far, the robot at a pose, and the plan of a leg; None for no plan."""
        self._robot.set_data([pose[0]], [pose[1]])
        self._robot.set_marker(MarkerStyle(_ARROW, transform=Affine2D().rotate(float(pose[2]))))
        if not self.shows_plan:
            return
        self._path.set_data(*path.T)
        line = smooth(leg.before, leg.plan) if leg is not None and leg.plan is not None else np.zeros((0, 2))
        self._plan.set_data(*line.T)


_BELIEF = ("mean", "std")
_TITLES = {"truth": "true field", "mean": "mean of the belief", "std": "its standard deviation"}


def _values(axes: Axes, drive: Drive, name: str) -> AxesImage:
    """A map with one scale for all steps, which true field and mean share."""
    belief = drive.belief
    if name == "std":
        largest = np.nanmax(belief.get("stds", belief["std"]))
        return draw_map(axes, belief, belief["std"], Normalize(0.0, float(largest)), "PuBu")
    norm = Normalize(float(belief["truth"].min()), float(belief["truth"].max()))
    return draw_map(axes, belief, belief[name], norm, QUIET if name == "truth" else "viridis")


def _panels(figure: Figure, num_beside: int) -> list[Axes]:
    """Axes of the main image and of the images beside it: one large, or two small ones stacked."""
    width = figure.get_figwidth()
    y, height = _BOTTOM, _TOP - _BOTTOM
    main = figure.add_axes((0.08 / width, y, 4.04 / width, height))
    left, right = 4.24 / width, 1.0 - 0.08 / width
    if num_beside == 1:
        return [main, figure.add_axes((left, y, right - left, height))]
    lows = (y + height - 0.375, y)[:num_beside]
    return [main, *(figure.add_axes((left, low, right - left, 0.375)) for low in lows)]


def _poses(leg: Leg, is_free: bool) -> Floats:
    """Poses at which the robot is drawn along a leg, `[N, 3]`: of its free body, or interpolated."""
    if leg.frames is not None and leg.frames.shape[1] >= 7 and is_free:
        x, y, (w, i, j, k) = leg.frames[:, 0], leg.frames[:, 1], leg.frames[:, 3:7].T
        return np.stack([x, y, np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))], axis=-1)
    points = smooth(leg.before, leg.poses)
    headings = np.unwrap(np.concatenate([leg.before[2:], leg.poses[:, 2]]))
    at = np.linspace(0.0, len(headings) - 1.0, len(points))
    return np.column_stack([points, np.interp(at, np.arange(len(headings)), headings)])


def _robot_of(drive: Drive, path: Path | None) -> "tuple[RobotModel, bool]":
    """The model of the robot, and whether its body is free."""
    from bojax.films.robot_worlds import VEHICLES, compiled, is_free

    problem = drive.point.problem
    settings = problem.params if isinstance(problem, External) else vars(problem)
    vehicle = settings.get("vehicle", "this robot")
    kind = str(vehicle.get("kind") if isinstance(vehicle, dict) else getattr(vehicle, "kind", vehicle))
    if path is None and kind not in VEHICLES:
        raise ResultsError(f"no model of {kind} is known: give its MJCF by --model FILE")
    model = compiled(path, lambda: VEHICLES[kind](drive.point.outline, drive.belief.get("truth")))
    return model, is_free(model)
