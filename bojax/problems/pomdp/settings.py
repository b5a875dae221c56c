"""Settings of state problems; the defaults are the published constants."""

from math import sqrt
from typing import Annotated, ClassVar, Literal

from pydantic import Field
from typing_extensions import override

from bojax.config.component import Component, Slot
from bojax.fields.settings import Pair
from bojax.motions.settings import ContinuousMotions, CubicCurves
from bojax.problems.settings import MaxSteps, Parking, ParkingSettings, ProblemSettings
from bojax.results.outline import Outline


class StateProblemSettings(ProblemSettings, frozen=True):
    """A problem whose state, action and observation are vectors."""

    num_particles: int = Field(default=10_000, ge=1, description="particles of the belief between plans")

    ends_at_success: ClassVar[bool] = False

    @property
    @override
    def has_success(self) -> bool:
        return self.ends_at_success


_Discount = Annotated[float, Field(gt=0, le=1, description="discount of the reward per step")]
_Noise = Annotated[float, Field(gt=0)]
_Noises = Annotated[tuple[_Noise, _Noise, _Noise], Field(strict=False)]
_Matrix = Annotated[tuple[Pair, Pair], Field(strict=False)]
_EYE = ((1.0, 0.0), (0.0, 1.0))


class VdpTag(StateProblemSettings, frozen=True):
    """Tag a target that follows a Van der Pol oscillator (Sunberg and Kochenderfer, ICAPS 2018)."""

    target: ClassVar[str] = "bojax.problems.pomdp.vdp_tag:VdpTag"
    kind: Literal["vdp-tag"] = "vdp-tag"
    damping: float = Field(default=2.0, gt=0, description="mu of the target's oscillator")
    time_step: float = Field(default=0.1, gt=0, description="step of the Runge-Kutta method")
    num_substeps: int = Field(default=5, ge=1, description="steps of the Runge-Kutta method per action")
    target_noise: float = Field(default=0.05, ge=0, description="standard deviation added to the target")
    step_length: float = Field(default=0.5, gt=0, description="length of the agent's moves")
    barrier_start: float = Field(default=0.2, ge=0, description="distance of the barriers from the origin")
    barrier_end: float = Field(default=3.0, ge=0, description="distance from the origin to their ends")
    half_width: float = Field(default=4.0, gt=0, description="half the side of the target's initial square")
    tag_radius: float = Field(default=0.1, gt=0, description="distance below which the target is tagged")
    tag_reward: float = Field(default=100.0, description="reward of the tag")
    step_reward: float = Field(default=-1.0, description="reward of any other step")
    look_reward: float = Field(default=-5.0, description="reward of a look, added at each look")
    look_noise: _Noise = Field(default=0.1, description="standard deviation of the distance after a look")
    noise: _Noise = Field(default=5.0, description="standard deviation of any other reading")
    empty_reading: float = Field(default=1.0, description="mean reading of a beam without the target")
    num_beams: int = Field(default=8, ge=1, description="number of beams")
    discount: _Discount = 0.95
    max_steps: MaxSteps = 100


class LightDark(StateProblemSettings, frozen=True):
    """Localise in the light, then stop at 0 (Sunberg and Kochenderfer, ICAPS 2018)."""

    target: ClassVar[str] = "bojax.problems.pomdp.light_dark:LightDark"
    kind: Literal["light-dark"] = "light-dark"
    moves: Annotated[tuple[int, ...], Field(strict=False)] = Field(
        default=(-10, -1, 0, 1, 10), min_length=1, description="the actions; 0 stops"
    )
    light: float = Field(default=10.0, description="position with the least noise")
    least_noise: _Noise = Field(
        default=1e-4,
        description="standard deviation of an observation in the light; elsewhere, plus distance",
    )
    belief_update: Literal["bootstrap", "published"] = Field(
        default="bootstrap",
        description="filter: the bootstrap filter, or that of the published runs, which replaces particles",
    )
    radius: int = Field(default=60, ge=1, description="positions are from -radius to radius")
    start_radius: int = Field(default=30, ge=0, description="initial positions are from - to + this")
    stop_reward: float = Field(default=100.0, description="reward of stopping at 0")
    wrong_stop_reward: float = Field(default=-100.0, description="reward of stopping elsewhere")
    step_reward: float = Field(default=-1.0, description="reward of a move")
    discount: _Discount = 0.95
    max_steps: MaxSteps = 100


class SubHunt(StateProblemSettings, frozen=True):
    """Hunt a submarine that crosses a grid (Sunberg and Kochenderfer, ICAPS 2018)."""

    target: ClassVar[str] = "bojax.problems.pomdp.sub_hunt:SubHunt"
    kind: Literal["sub-hunt"] = "sub-hunt"
    size: int = Field(default=20, ge=2, description="cells per side of the grid")
    speed: int = Field(default=3, ge=1, description="cells of an own move")
    straight_probability: float = Field(
        default=0.5, ge=0, le=1, description="probability that the target moves two cells ahead"
    )
    kill_radius: float = Field(default=2.0, gt=0, description="greatest distance of a kill")
    kill_probability: float = Field(
        default=0.6, ge=0, le=1, description="probability of the kill of a target that is aware"
    )
    kill_reward: float = Field(default=100.0, description="reward of a kill")
    ping_noise: _Noise = Field(default=0.5, description="standard deviation of every reading after a ping")
    detection_radius: float = Field(
        default=3.0, gt=0, description="distance of detection without a ping, and mean of empty readings"
    )
    detection_noise: _Noise = Field(
        default=0.5, description="standard deviation of the distance of a target that is detected"
    )
    empty_noise: _Noise = Field(default=5.0, description="standard deviation of an empty reading")
    num_beams: int = Field(default=8, ge=1, description="number of beams")
    discount: _Discount = 0.99
    max_steps: MaxSteps = 100


class PomdpLander(StateProblemSettings, frozen=True):
    """A lunar lander with noisy sensors (Lim, Tomlin and Sunberg, 2021)."""

    target: ClassVar[str] = "bojax.problems.pomdp.pomdp_lander:PomdpLander"
    kind: Literal["pomdp-lander"] = "pomdp-lander"
    time_step: float = Field(default=0.4, gt=0, description="time of a step, s")
    mass: float = Field(default=1.0, gt=0, description="mass, kg")
    inertia: float = Field(default=10.0, gt=0, description="moment of inertia, kg m^2")
    gravity: float = Field(default=9.0, ge=0, description="gravity, m/s^2")
    velocity_noise: _Noises = Field(
        default=(0.1, 0.1, 0.01),
        description="standard deviations added to the velocities at each step, [m/s, m/s, rad/s]",
    )
    sensor_noise: _Noises = Field(
        default=(1.0, 0.01, 0.1),
        description="standard deviations of range, angular and horizontal velocity, [m, rad/s, m/s]",
    )
    initial_mean: Annotated[tuple[float, ...], Field(strict=False)] = Field(
        default=(0.0, 50.0, 0.0, 0.0, -10.0, 0.0),
        min_length=6,
        max_length=6,
        description="mean initial state, [x, z, theta, v_x, v_z, omega]",
    )
    initial_noise: Annotated[tuple[_Noise, ...], Field(strict=False)] = Field(
        default=(sqrt(0.1), sqrt(0.1), 0.1, sqrt(0.1), sqrt(0.1), 0.1),
        min_length=6,
        max_length=6,
        description="standard deviations of the initial state",
    )
    action_low: Annotated[tuple[float, float, float], Field(strict=False)] = Field(
        default=(-5.0, 0.0, -1.0), description="least lateral force, thrust (N) and offset (m)"
    )
    action_high: Annotated[tuple[float, float, float], Field(strict=False)] = Field(
        default=(5.0, 15.0, 1.0), description="greatest lateral force, thrust (N) and offset (m)"
    )
    max_distance: float = Field(default=15.0, gt=0, description="|x| at which the lander is lost, m")
    max_tilt: float = Field(default=0.5, gt=0, description="|theta| at which the lander is lost, rad")
    landing_height: float = Field(default=1.0, ge=0, description="height at which the lander lands, m")
    crash_reward: float = Field(default=-1000.0, description="reward of losing the lander")
    landing_reward: float = Field(
        default=100.0, description="reward of landing, less |x| and the square of the vertical velocity"
    )
    step_reward: float = Field(
        default=-0.8,
        description="reward of any other step; minus twice the time step in the original program",
    )
    braking_gain: float = Field(
        default=0.5, ge=0, description="force of the policy slow-down for each unit of velocity, N s/m"
    )
    belief_update: Literal["bootstrap", "gaussian"] = Field(
        default="bootstrap",
        description="filter: the bootstrap filter, or, as published, an extended Kalman filter",
    )
    discount: _Discount = 0.99
    max_steps: MaxSteps = 200


class LightDarkNd(StateProblemSettings, frozen=True):
    """Reach a goal in several dimensions with the help of a beacon (arXiv 2503.12181)."""

    target: ClassVar[str] = "bojax.problems.pomdp.light_dark_nd:LightDarkNd"
    kind: Literal["light-dark-nd"] = "light-dark-nd"
    num_dims: int = Field(default=2, ge=2, description="dimensions of the space")
    num_agents: int = Field(default=1, ge=1, description="number of agents")
    start_radius: float = Field(default=0.3, gt=0, description="distance of the agents' start from 0")
    goal_distance: float = Field(default=2.5, gt=0, description="distance of the goal, on the last axis")
    goal_tolerance: float = Field(
        default=0.2, gt=0, description="distance from the goal that ends the episode; scale of the rewards"
    )
    beacon_offset: float = Field(default=2.5, description="distance of the beacon from the midpoint")
    action_radius: float = Field(default=1.5, gt=0, description="greatest length of a move")
    process_noise: float = Field(default=0.03, ge=0, description="standard deviation added to a move")
    noise_scale: float = Field(default=0.01, gt=0, description="scale of an observation's deviation")
    noise_power: float = Field(
        default=8.0, ge=0, description="power p: the deviation is the scale times (d + d^p)"
    )
    max_noise: _Noise = Field(default=15.0, description="greatest standard deviation of an observation")
    distance_reward: float = Field(default=-0.02, description="reward of the squared distance to the goal")
    goal_reward: float = Field(default=10.0, description="reward at the goal")
    ring_reward: float = Field(default=-2.0, description="reward on a ring about the goal")
    discount: _Discount = 0.99
    max_steps: MaxSteps = 8


class PomdpMountainCar(StateProblemSettings, frozen=True):
    """Mountain car without a sensor of the velocity, with rewards of 1 at the goal and 0 elsewhere."""

    target: ClassVar[str] = "bojax.problems.pomdp.mountain_car:PomdpMountainCar"
    kind: Literal["pomdp-mountain-car"] = "pomdp-mountain-car"
    goal_position: float = Field(default=0.5, gt=-0.4, le=0.6, description="smallest position at the goal")
    power: float = Field(default=0.001, gt=0, description="velocity change per step by an action of 1")
    gravity: float = Field(default=0.0025, ge=0, description="velocity change per step on the steepest slope")
    velocity_noise: float = Field(
        default=0.0002, ge=0, description="standard deviation added to the velocity at each step"
    )
    sensor_noise: _Noise = Field(default=0.1, description="standard deviation of a measured position")
    discount: _Discount = 0.99
    max_steps: MaxSteps = 500


class Hallway(StateProblemSettings, frozen=True):
    """Stop at the right one of several doors that look the same (after Porta et al., JMLR 2006)."""

    target: ClassVar[str] = "bojax.problems.pomdp.hallway:Hallway"
    kind: Literal["hallway"] = "hallway"
    length: float = Field(default=10.0, gt=0, description="distance between the walls, m")
    doors: Annotated[tuple[float, ...], Field(strict=False)] = Field(
        default=(2.0, 4.0, 7.0), min_length=1, description="positions of the doors, the right one last, m"
    )
    half_width: float = Field(
        default=0.5, gt=0, description="distance from which door and wall are beside, m"
    )
    stop: float = Field(
        default=0.1, gt=0, lt=1, description="length of a move below which the robot stops, m"
    )
    wrong_reward: float = Field(default=-1.0, description="reward of a stop that is not at the right door")
    move_noise: float = Field(default=0.1, ge=0, description="standard deviation added to a move, m")
    accuracy: float = Field(default=0.9, gt=0, lt=1, description="probability that a sensor is right")
    discount: _Discount = 0.95
    max_steps: MaxSteps = 50


class Tiger(StateProblemSettings, frozen=True):
    """Listen for a tiger behind one of two doors, then open the other (Kaelbling et al., 1998)."""

    target: ClassVar[str] = "bojax.problems.pomdp.tiger:Tiger"
    kind: Literal["tiger"] = "tiger"
    listen_reward: float = Field(default=-1.0, description="reward of listening")
    tiger_reward: float = Field(default=-100.0, description="reward of opening the tiger's door")
    treasure_reward: float = Field(default=10.0, description="reward of opening the other door")
    accuracy: float = Field(default=0.85, ge=0, le=1, description="probability of hearing the right side")
    discount: _Discount = 0.95
    max_steps: MaxSteps = 100


class Lqg(StateProblemSettings, frozen=True):
    """A linear problem with quadratic costs, solved exactly (Lim, Tomlin and Sunberg, 2021)."""

    target: ClassVar[str] = "bojax.problems.pomdp.lqg:Lqg"
    kind: Literal["lqg"] = "lqg"
    transition: _Matrix = Field(default=_EYE, description="matrix of the state in the next state")
    control: _Matrix = Field(default=_EYE, description="matrix of the action in the next state")
    sensor: _Matrix = Field(default=_EYE, description="matrix of the state in the observation")
    state_cost: _Matrix = Field(default=_EYE, description="matrix of the cost of a state")
    action_cost: _Matrix = Field(default=_EYE, description="matrix of the cost of an action")
    process_noise: float = Field(default=0.1, ge=0, description="standard deviation added to the state")
    sensor_noise: _Noise = Field(default=0.1, description="standard deviation of an observation")
    initial_mean: Pair = Field(default=(-10.0, 10.0), description="mean of the initial state")
    initial_noise: _Noise = Field(default=0.1, description="standard deviation of the initial state")
    action_bound: float = Field(default=10.0, gt=0, description="greatest component of an action")
    discount: _Discount = 1.0
    max_steps: MaxSteps = 2


class UncertainPose(StateProblemSettings, frozen=True):
    """Parking, or another problem of a robot's pose, with a belief of particles about the pose."""

    target: ClassVar[str] = "bojax.problems.pomdp.uncertain_pose:UncertainPose"
    ends_at_success: ClassVar[bool] = True
    kind: Literal["uncertain-pose"] = "uncertain-pose"
    problem: Annotated[Component, Slot("problem", only=ParkingSettings)] = Field(
        default=Parking(), description="problem of the robot's pose, with its noise; the vehicle is exact"
    )
    motions: Annotated[Component, Slot("motions", only=ContinuousMotions)] = Field(
        default=CubicCurves(), description="family of trajectories; an action is its parameters"
    )
    discount: _Discount = 1.0

    @property
    @override
    def outline(self) -> Outline:
        problem = self.problem
        return problem.outline if isinstance(problem, ProblemSettings) else Outline()

    @property
    @override
    def ends_at_exit(self) -> bool:
        problem = self.problem
        return isinstance(problem, ProblemSettings) and problem.ends_at_exit
