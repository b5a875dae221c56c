"""Settings of planning problems, their objectives and their sensors."""

from collections.abc import Mapping
from itertools import product
from math import dist, pi
from typing import Annotated, Any, ClassVar, Literal

import pydantic
from pydantic import Field
from typing_extensions import override

from bojax.areas.settings import OutlinedArea
from bojax.config.component import RECORDED, Component, Slot
from bojax.config.limits import CELLS, square
from bojax.fields.raster_files import frame_of
from bojax.fields.settings import Blocks, Box, Bumps, Grid, Pair, Scattered, Step
from bojax.models.settings import RBF, ConstantMean, Matern32, Scaled, ZeroMean
from bojax.problems.budgets import check_one_budget, check_reach, distance_of
from bojax.problems.vehicles.settings import Exact, Quadrotor, WheeledRobot
from bojax.results.outline import Outline

_BOX = pydantic.TypeAdapter(Box)


class ObjectiveSettings(Component, frozen=True):
    """The reward of a sample of a field."""

    role: ClassVar[str] = "objective"
    plural: ClassVar[str] = "objectives of field problems"
    protocol: ClassVar[str] = "bojax.problems.objectives:FieldObjective"


class _OfUncertainty(ObjectiveSettings, frozen=True):
    uncertainty: Literal["std", "variance"] = Field(
        default="std", description="measure of uncertainty: standard deviation or variance"
    )


class Gradient(_OfUncertainty, frozen=True):
    """Norm of the gradient plus kappa standard deviations (thesis, equation 3.2)."""

    target: ClassVar[str] = "bojax.problems.objectives:GradientObjective"
    kind: Literal["gradient"] = "gradient"
    kappa: float = Field(default=5.0, ge=0, description="weight of the uncertainty")


class Value(_OfUncertainty, frozen=True):
    """Mean plus kappa standard deviations (thesis, equation 4.11; SBO)."""

    target: ClassVar[str] = "bojax.problems.objectives:ValueObjective"
    kind: Literal["value"] = "value"
    kappa: float = Field(default=10.0, ge=0, description="weight of the uncertainty")


class Uncertainty(_OfUncertainty, frozen=True):
    """The standard deviation alone (thesis, Section 3.5.1: the explorer)."""

    target: ClassVar[str] = "bojax.problems.objectives:UncertaintyObjective"
    kind: Literal["uncertainty"] = "uncertainty"


class Information(ObjectiveSettings, frozen=True):
    """Reduction of the mean variance over the domain; samples close together do not count twice."""

    target: ClassVar[str] = "bojax.problems.objectives:InformationObjective"
    kind: Literal["information"] = "information"


class Entropy(ObjectiveSettings, frozen=True):
    """Entropy that samples take from the belief about the field, in nats (a rho-POMDP, exactly)."""

    target: ClassVar[str] = "bojax.problems.objectives:EntropyObjective"
    kind: Literal["entropy"] = "entropy"


class SensorSettings(Component, frozen=True):
    """A sensor."""

    role: ClassVar[str] = "sensor"
    plural: ClassVar[str] = "sensors"
    protocol: ClassVar[str] = "bojax.problems.sensors:Sensor"


class Point(SensorSettings, frozen=True):
    """A sensor that measures the field at the robot's position."""

    target: ClassVar[str] = "bojax.problems.sensors:PointSensor"
    kind: Literal["point"] = "point"


class Range(SensorSettings, frozen=True):
    """A downward range finder that measures the height of the ground (thesis, p. 76-78)."""

    target: ClassVar[str] = "bojax.problems.sensors:RangeSensor"
    kind: Literal["range"] = "range"
    beam: float = Field(default=pi / 60, ge=0, lt=pi, description="full opening angle of the beam, rad")
    max_range: float = Field(default=5.0, gt=0, description="range, m; a larger distance reads as this one")
    altitude_noise: float = Field(default=0.02, ge=0, description="standard deviation of the altimeter, m")
    rays: int = Field(default=7, ge=1, description="number of rays in the beam")
    reading: Literal["mean", "minimum"] = Field(
        default="mean", description="statistic of the distances along the rays that is reported"
    )
    upright: bool = Field(default=True, description="whether the range is projected onto the vertical")


class ProblemSettings(Component, frozen=True):
    """A planning problem."""

    role: ClassVar[str] = "problem"
    plural: ClassVar[str] = "problems"
    protocol: ClassVar[str] = "bojax.problems.base:Problem"

    ends_at_success: ClassVar[bool] = True
    """Whether a run is over once it has succeeded."""

    @property
    def outline(self) -> Outline:
        """The world seen from above, as figures draw it."""
        return Outline()

    @property
    def has_success(self) -> bool:
        """Whether a run can succeed."""
        return True

    @property
    def ends_at_exit(self) -> bool:
        """Whether a run is over once the robot has left the domain."""
        return False


# Settings whose defaults differ between problems.
MaxSteps = Annotated[int, Field(ge=1, description="number of steps after which an episode ends")]
_HalfWidth = Annotated[float, Field(gt=0, description="half the side of the square domain, m")]
_Vehicle = Annotated[
    Component,
    Slot("vehicle"),
    Field(description="vehicle that follows the paths; planners assume that paths are followed exactly"),
]
_TrueField = Annotated[Component, Slot("field"), Field(description="true field")]
_Domain = Annotated[Box, Field(description="border, [x_min, y_min, x_max, y_max], m")]
_Walls = Annotated[
    tuple[Box, ...] | None,
    Field(strict=False, min_length=1, description="walls, a list of [x_min, y_min, x_max, y_max], m"),
]
_Start = Annotated[
    Annotated[tuple[float, float, float], Field(strict=False)] | None,
    Field(description="initial pose, [x, y, heading], m and rad; null: random in the free space"),
]
_TargetArea = Annotated[
    Box | None, Field(description="area to reach for success, [x_min, y_min, x_max, y_max], m")
]
_Task = Annotated[Component, Slot("objective"), Field(description="reward of a sample in the task")]
_NoiseVariance = Annotated[float, Field(ge=0, description="noise variance of an observation in the belief")]
_Covariance = Annotated[Component, Slot("kernel"), Field(description="prior covariance, m and m^2")]
_Spread = Annotated[float, Field(ge=0)]
_PoseNoise = Annotated[
    Annotated[tuple[_Spread, _Spread], Field(strict=False)] | None,
    Field(description="standard deviations of a pose measurement, [m, rad]; null: exact measurements"),
]
_Resolution = Annotated[
    int, Field(ge=2, description="points per side of the grid of the error measures"), CELLS.bound(square)
]
_Weighting = Annotated[
    Literal["gradient", "gradient-norm", "value"],
    Field(description="weights of wrmse: the gradient as printed in (3.7), its norm, or the value"),
]


class ParkingSettings(ProblemSettings, frozen=True):
    """Parking of a robot."""

    target: ClassVar[str] = "bojax.problems.parking:Parking"

    half_width: _HalfWidth = 4.0
    max_steps: MaxSteps = 15
    distance_tolerance: float = Field(default=0.1, gt=0, description="largest distance of a parked robot, m")
    heading_tolerance: float = Field(
        default=pi / 10, gt=0, description="largest |sin alpha| when parked; either direction, as in (4.13)"
    )
    bearing_tolerance: float = Field(default=pi / 10, gt=0, description="largest |sin beta| when parked")
    success_reward: float = Field(default=1000.0, description="reward for parking")
    exit_reward: float = Field(default=-1000.0, description="reward for leaving the domain")
    position_noise: float = Field(default=0.02, ge=0, description="standard deviation of measured x and y, m")
    heading_noise: float = Field(
        default=0.02, ge=0, description="standard deviation of a heading measurement, rad"
    )
    bearing: Literal["world", "robot"] = Field(
        default="world",
        description="the bearing (beta): direction of the robot seen from the spot, or of the spot relative "
        "to the robot's heading",
    )
    rule: Literal["printed", "bearing-dropped", "anywhere", "anywhere-bearing-dropped"] = Field(
        default="printed",
        description="when the robot is parked: (4.13) as printed, with distance, heading and bearing at the "
        "end of a path; without the bearing; at any pose of a path; or at any pose without the bearing",
    )
    exit_terminates: bool = Field(
        default=True,
        description="whether leaving the domain ends the episode; otherwise exit_reward is paid each time "
        "that a path leads out of it",
    )
    vehicle: _Vehicle = Exact()

    @property
    @override
    def outline(self) -> Outline:
        half = self.half_width
        return Outline(
            border=(-half, -half, half, half), goals=((0.0, 0.0, self.distance_tolerance),), heading=0.0
        )

    @property
    @override
    def ends_at_exit(self) -> bool:
        return self.exit_terminates


class Parking(ParkingSettings, frozen=True):
    """Robot parking: reach the centre of a square at a given heading (thesis, Section 4.7.2)."""

    kind: Literal["parking"] = "parking"


class RobotParking(ParkingSettings, frozen=True):
    """Parking of a wheeled robot that drives forward only, in 3 x 3 m (thesis, p. 101-102, Fig. 4.8)."""

    kind: Literal["robot-parking"] = "robot-parking"
    half_width: _HalfWidth = 1.5
    vehicle: _Vehicle = WheeledRobot()


class FieldProblem(ProblemSettings, frozen=True):
    """A problem of learning a field."""

    target: ClassVar[str] = "bojax.problems.field_problem:FieldProblem"
    ends_at_success: ClassVar[bool] = False

    field: Annotated[Component | None, Slot("field", optional=True)] = Field(
        default=Bumps(centres=((3.0, 3.0),)),
        description="true field that a run samples; null for none, to plan with a robot of your own. With an "
        "area or a domain of your own, the default is null",
    )
    domain: _Domain = (0.0, 0.0, 6.0, 6.0)
    margin: float = Field(default=0.0, ge=0, description="how far the robot may drive beyond the domain, m")
    walls: _Walls = None
    area: Annotated[Component | None, Slot("area", optional=True)] = Field(
        default=None,
        description="area that the robot may drive in: its border stops paths as a wall does. The domain, if "
        "not set, is the rectangle around it",
    )
    start: _Start = None
    target_area: _TargetArea = None
    objective: _Task = Value()
    kernel: Annotated[Component, Slot("kernel")] = Field(
        default=Scaled(kernel=RBF(lengthscale=1.0)), description="prior covariance of the field"
    )
    mean: Annotated[Component, Slot("mean")] = Field(default=ZeroMean(), description="field's prior mean")
    noise_variance: _NoiseVariance = 0.01
    noise: float = Field(default=0.1, ge=0, description="standard deviation of the noise in the world")
    pose_noise: _PoseNoise = None
    vehicle: _Vehicle = Exact()
    sensor: Annotated[Component, Slot("sensor")] = Field(default=Point(), description="sensor of the field")
    collision_reward: float = Field(default=-100.0, le=0, description="reward when a wall stops the robot")
    exit_reward: float = Field(default=-100.0, le=0, description="reward when the border stops the robot")
    budget: float | None = Field(
        default=None,
        gt=0,
        description="distance after which an episode ends, m; `null`: it ends after `max_steps`. The robot "
        "stops at the last pose of a path that it allows, in simulations too",
    )
    time_budget: float | None = Field(
        default=None, gt=0, description="time after which an episode ends instead, s; needs `speed`"
    )
    speed: float | None = Field(default=None, gt=0, description="constant speed of the robot, m/s")
    end: Annotated[Pair | None, Field(strict=False)] = Field(
        default=None,
        description="point at which an episode with a budget ends, [x, y], m. Paths stop at the last pose "
        "from which it can be reached; then the robot drives the shortest way there, and measures on it",
    )
    max_steps: MaxSteps = 25
    resolution: _Resolution = 31
    errors_by_step: bool = Field(
        default=False,
        description="whether steps.parquet has the distance driven and, of the belief after every step, "
        "rmse, mnll and mean_std",
    )
    region: Box | OutlinedArea | None = Field(
        default=None,
        description="part of the domain, [x_min, y_min, x_max, y_max], m, or a file of polygons, whose "
        "errors steps.parquet has as well, as rmse_region, mnll_region and mean_std_region; needs "
        "`errors_by_step`",
    )
    relearn_every: int = Field(default=0, ge=0, description="steps between hyper-parameter updates; 0: none")
    relearn_spread: float = Field(
        default=0.5, gt=0, description="prior standard deviation of each hyper-parameter's logarithm"
    )
    imagined: Literal["sample", "mean"] = Field(
        default="sample", description="simulated observations are drawn from the belief or are its mean"
    )
    after_collision: Literal["stop", "turn"] = Field(
        default="turn",
        description="whether a robot that was stopped stands still, or turns round on the spot, which a "
        "vehicle with a turning radius cannot; the same in the world and in simulations",
    )
    weighting: _Weighting = "value"

    @pydantic.field_validator("region", mode="wrap")
    @classmethod
    def _box_or_file(cls, region: Any, handler: Any, info: Any) -> Any:
        del handler  # a union would name its members in messages
        if region is None or isinstance(region, OutlinedArea):
            return region
        if isinstance(region, str | Mapping):
            settings = {"file": region} if isinstance(region, str) else region
            return OutlinedArea.model_validate(settings, context=info.context)
        return _BOX.validate_python(region)

    @pydantic.model_validator(mode="after")
    def _placed_area(self, info: Any) -> "FieldProblem":
        area = self.area
        if not isinstance(area, OutlinedArea) or info.context is RECORDED:
            return self
        is_placed = area.place.projection.crs is not None
        if area.frame is None and is_placed and isinstance(self.field, Grid | Scattered):
            # Results record the frame, as they do the extent of the field.
            if frame_of(self.field.file).crs is not None:
                area = area.model_copy(update={"frame": self.field.file})
                object.__setattr__(self, "area", area)
        if "domain" not in self.model_fields_set:
            object.__setattr__(self, "domain", area.place.area.bounds)
        return self

    @pydantic.model_validator(mode="after")
    def _placed_region(self, info: Any) -> "FieldProblem":
        if not isinstance(self.region, OutlinedArea) or self.region.frame or info.context is RECORDED:
            return self
        frame = None
        if isinstance(self.area, OutlinedArea):
            frame = self.area.own_frame
        elif isinstance(self.field, Grid | Scattered):
            frame = self.field.file if frame_of(self.field.file).crs is not None else None
        if frame is not None:
            object.__setattr__(self, "region", self.region.model_copy(update={"frame": frame}))
        # In another system than the frame, it is refused.
        if self.region.place.projection.crs is not None and frame is None:
            raise ValueError(
                f"region: {self.region.file} is in degrees or a map projection, and the problem has no place "
                "on the Earth; allowed: a file in metres, or region.frame"
            )
        return self

    @pydantic.model_validator(mode="after")
    def _fitting(self, info: Any) -> "FieldProblem":
        if self.region is not None and not self.errors_by_step:
            raise ValueError("region: needs errors_by_step: true")
        if self.relearn_every > 0 and self.noise_variance == 0.0:
            raise ValueError(
                "noise_variance: got 0; allowed: > 0 where relearn_every is: it is the median of a prior"
            )
        if self.target_area is not None:
            low_x, low_y, high_x, high_y = self.target_area
            is_beside = low_x > self.domain[2] or high_x < self.domain[0]
            if is_beside or low_y > self.domain[3] or high_y < self.domain[1]:
                raise ValueError("target_area: lies outside the domain")
        ends = {"start": self.start, "end": self.end}
        for name, point in ends.items():
            if point is not None:
                self._check_free(name, *point[:2])
        if isinstance(self.area, OutlinedArea) and info.context is not RECORDED:
            known = {name: point[:2] for name, point in ends.items() if point is not None}
            self.area.check_inside(known)
        check_one_budget(self.budget, self.time_budget, self.speed, self.end is not None)
        budget = self.distance_budget
        has_starts = self.start is not None or self.area is None  # else, the problem knows how far they are
        if self.end is not None and budget is not None and has_starts:
            corners = product(self.domain[::2], self.domain[1::2])
            starts = corners if self.start is None else (self.start[:2],)
            least = max(dist(self.end, start) for start in starts)
            check_reach(budget, least, self.speed, self.start is not None)
        return self

    def _check_free(self, name: str, x: float, y: float) -> None:
        """Refuse a point outside the domain or inside a wall, or raise ValueError."""
        low_x, low_y, high_x, high_y = self.domain
        if not (low_x <= x <= high_x and low_y <= y <= high_y):
            raise ValueError(f"{name}: ({x:g}, {y:g}) lies outside the domain")
        for number, wall in enumerate(self.walls or ()):
            if wall[0] <= x <= wall[2] and wall[1] <= y <= wall[3]:
                raise ValueError(f"{name}: ({x:g}, {y:g}) lies inside walls[{number}]")

    @property
    def distance_budget(self) -> float | None:
        """The distance that may be driven, m; None without a budget."""
        return distance_of(self.budget, self.time_budget, self.speed)

    @property
    @override
    def outline(self) -> Outline:
        return Outline(
            border=self.domain,
            obstacles=self.walls or (),
            goals=() if self.target_area is None else (self.target_area,),
            start=None if self.start is None else self.start[:2],
            blocks=self.field.blocks if isinstance(self.field, Blocks) else (),
        )

    @property
    @override
    def has_success(self) -> bool:
        return self.target_area is not None or self.end is not None

    @property
    def maps_heights(self) -> bool:
        """Whether the field is the height of the ground."""
        return isinstance(self.sensor, Range)


class Monitoring(FieldProblem, frozen=True):
    """Learn a field from samples along trajectories (thesis, Chapter 3 and Section 4.7.1)."""

    kind: Literal["monitoring"] = "monitoring"

    @pydantic.model_validator(mode="after")
    def _no_field_of_another_area(self) -> "Monitoring":
        if "field" not in self.model_fields_set and self.model_fields_set & {"area", "domain"}:
            object.__setattr__(self, "field", None)
        return self


class _Gradients(FieldProblem, frozen=True):
    objective: _Task = Gradient(kappa=5.0)
    exit_reward: float = Field(default=0.0, le=0, description="reward at the border; none in Chapter 3")
    weighting: _Weighting = "gradient"


class Diagonal(_Gradients, frozen=True):
    """A field with a steep diagonal (thesis, Section 3.5.1, Fig. 3.1)."""

    kind: Literal["diagonal"] = "diagonal"
    field: _TrueField = Step(point=(3.0, 3.0), direction=pi / 4, height=1.0, width=0.6)
    start: _Start = (1.0, 1.0, 0.0)
    max_steps: MaxSteps = 35


class TwoPits(_Gradients, frozen=True):
    """Two pits farther apart than one action, one of them steeper (thesis, Section 3.5.1, Fig. 3.2)."""

    kind: Literal["two-pits"] = "two-pits"
    field: _TrueField = Bumps(heights=(-0.8, -1.0), centres=((1.5, 4.5), (4.5, 1.5)), widths=(0.8, 0.4))
    max_steps: MaxSteps = 50


class SpaceModelling(FieldProblem, frozen=True):
    """Two high areas behind a wall with a narrow gap (thesis, Section 4.7.1, Fig. 4.3)."""

    kind: Literal["space-modelling"] = "space-modelling"
    field: _TrueField = Bumps(heights=(1.0, 1.0), centres=((1.2, 4.5), (4.8, 1.5)), widths=(1.0, 1.0))
    walls: _Walls = ((2.9, 0.0, 3.1, 2.85), (2.9, 3.15, 3.1, 6.0))
    start: _Start = (1.0, 1.0, pi / 2)
    target_area: _TargetArea = (3.1, 0.0, 6.0, 6.0)


class _Heights(_Gradients, frozen=True):
    vehicle: _Vehicle = Quadrotor(altitude=2.0)
    sensor: Annotated[Component, Slot("sensor")] = Field(default=Range(), description="sensor of heights")
    noise: float = Field(default=0.04, ge=0, description="standard deviation of a range measurement, m")
    pose_noise: _PoseNoise = (0.02, 0.02)


class HillyTerrain(_Heights, frozen=True):
    """Map a terrain with hills from the air (thesis, Section 3.5.1, Fig. 3.5)."""

    target: ClassVar[str] = "bojax.problems.mapping:HeightMapping"
    kind: Literal["hilly-terrain"] = "hilly-terrain"
    field: Annotated[Component, Slot("field")] = Field(
        default=Bumps(
            heights=(1.2, 0.8, 1.0, 0.6),
            centres=((1.5, 3.5), (3.7, 3.8), (3.3, 1.4), (1.2, 1.2)),
            widths=(0.7, 0.5, 0.75, 0.45),
        ),
        description="true heights of the terrain, m",
    )
    domain: _Domain = (0.0, 0.0, 5.0, 5.0)
    objective: _Task = Gradient(kappa=10.0)
    mean: Annotated[Component, Slot("mean")] = Field(
        default=ConstantMean(value=0.4), description="prior mean of the terrain, m"
    )
    kernel: _Covariance = Scaled(kernel=RBF(lengthscale=0.8), variance=0.25)
    noise_variance: _NoiseVariance = 0.005


class IndoorProps(_Heights, frozen=True):
    """Map a room with sharp-edged props from the air (thesis, Section 3.5.2, Figs. 3.7 and 3.8)."""

    target: ClassVar[str] = "bojax.problems.mapping:PropMapping"
    kind: Literal["indoor-props"] = "indoor-props"
    field: Annotated[Component, Slot("field", only=Blocks)] = Field(
        default=Blocks(
            boxes=((0.4, 0.5, 1.0, 1.2), (0.4, 1.6, 1.0, 2.4), (1.9, 1.2, 2.5, 1.9)),
            heights=(0.2, 0.25, 0.15),
        ),
        description="true props, m",
    )
    domain: _Domain = (0.0, 0.0, 3.0, 3.0)
    vehicle: _Vehicle = Quadrotor()
    objective: _Task = Gradient(kappa=10.0)
    mean: Annotated[Component, Slot("mean")] = Field(
        default=ConstantMean(value=0.05), description="prior mean of the heights, m"
    )
    kernel: _Covariance = Scaled(kernel=Matern32(lengthscale=0.25), variance=0.0073)
    map_kernel: Annotated[
        Component | None,
        Slot("kernel", optional=True),
        Field(description="prior covariance of the final map of the flight's samples; null for `kernel`"),
    ] = None
    noise_variance: _NoiseVariance = 0.0025
    max_steps: MaxSteps = 15
    resolution: _Resolution = 61
    weighting: _Weighting = "value"
