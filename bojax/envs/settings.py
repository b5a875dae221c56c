"""Settings of the environments, except for simulated robots."""

import json
from typing import Annotated, Any, ClassVar, Literal

import pydantic
from pydantic import Field
from typing_extensions import override

from bojax.config.component import Component, Slot
from bojax.problems.pomdp.settings import Hallway, StateProblemSettings


class EnvironmentSettings(Component, frozen=True):
    """An environment."""

    role: ClassVar[str] = "env"
    plural: ClassVar[str] = "environments"
    protocol: ClassVar[str] = "bojax.envs.base:Env"

    observation_names: ClassVar[tuple[str, str]] = ("first observation", "second observation")
    """What figures call the first two observations, with their units."""


MaxSteps = Annotated[int, Field(ge=1, description="number of steps after which an episode is truncated")]


class Environment(EnvironmentSettings, frozen=True):
    """An environment that is stepped inside the compiled program."""

    max_steps: MaxSteps = 500


class ControlTask(Environment, frozen=True):
    """Settings of all domains of Section 5.7.2."""

    reward: Literal["goal-only", "classic"] = Field(
        default="goal-only", description="reward: 1 at the goal, -1 at a failure and 0 otherwise; or Gym's"
    )


ClassicReward = Literal["gym", "published"]


def classic_reward(failure_reward: int) -> Any:
    """The field `classic_reward` of a domain with this reward at a failure in the author's code."""
    return Field(
        default="gym",
        description="classic reward: Gym's; or the one in the author's published code, -1 a step, "
        f"{failure_reward} at a failure and 0 at the goal, both of which end the episode",
    )


class SinglePendulum(ControlTask, frozen=True):
    """Swing a pendulum up with a weak motor (thesis, p. 107; Gym's Pendulum)."""

    target: ClassVar[str] = "bojax.envs.single_pendulum:SinglePendulum"
    observation_names: ClassVar[tuple[str, str]] = ("cosine of the angle", "sine of the angle")
    kind: Literal["single-pendulum"] = "single-pendulum"
    goal_angle: float = Field(default=0.05, gt=0, description="largest |angle| from upright at the goal, rad")
    classic_ends_at_goal: bool = Field(
        default=True, description="whether the goal ends an episode with the classic reward (not in Gym)"
    )
    gravity: float = Field(default=10.0, ge=0, description="gravitational acceleration, m/s^2")
    mass: float = Field(default=1.0, gt=0, description="mass of the rod, kg")
    length: float = Field(default=1.0, gt=0, description="length of the rod, m")
    max_torque: float = Field(default=2.0, gt=0, description="largest torque, N m")
    max_speed: float = Field(default=8.0, gt=0, description="largest angular velocity of the joint, rad/s")
    time_step: float = Field(default=0.05, gt=0, description="time step, s")


class MountainCar(ControlTask, frozen=True):
    """Drive a weak car up a hill by building momentum (thesis, p. 106; Gym's MountainCar)."""

    target: ClassVar[str] = "bojax.envs.mountain_car:MountainCar"
    observation_names: ClassVar[tuple[str, str]] = ("position (Gym's unit)", "velocity (units a step)")
    kind: Literal["mountain-car"] = "mountain-car"
    goal_position: float = Field(
        default=0.5, gt=-1.2, le=0.6, description="smallest position at the goal; 0.42 in Fig. 5.7"
    )
    actions: Literal["continuous", "thresholded"] = Field(
        default="continuous", description="an action in [-1, 1] is a force, or selects left, coast or right"
    )
    threshold: float = Field(
        default=0.33, ge=0, le=1, description="smallest |action| that drives, if actions are thresholded"
    )
    power: float = Field(default=0.001, gt=0, description="velocity change per step by an action of 1")
    gravity: float = Field(default=0.0025, ge=0, description="velocity change per step on the steepest slope")


class Belief(EnvironmentSettings, frozen=True):
    """A state problem seen through the belief of its filter: what a learner can know of the state."""

    target: ClassVar[str] = "bojax.envs.belief:BeliefEnv"
    observation_names: ClassVar[tuple[str, str]] = ("first feature", "second feature")
    kind: Literal["belief"] = "belief"
    problem: Annotated[Component, Slot("problem", only=StateProblemSettings)] = Field(
        default=Hallway(num_particles=500), description="state problem"
    )
    features: Literal["mean-and-spread", "mean", "reading", "state"] = Field(
        default="mean-and-spread",
        description="what is observed: mean and standard deviation of each component of the state; the mean; "
        "or, for comparison, the last observation of the problem, or the true state",
    )
    low: Annotated[tuple[float, ...], Field(strict=False)] = Field(
        default=(0.0,), description="lower bounds of the state; of the problem's observation with reading"
    )
    high: Annotated[tuple[float, ...], Field(strict=False)] = Field(
        default=(10.0,), description="upper bounds of the same"
    )


class PointMaze(ControlTask, frozen=True):
    """Move a point without inertia to a disc behind walls; not in the thesis."""

    target: ClassVar[str] = "bojax.envs.point_maze:PointMaze"
    observation_names: ClassVar[tuple[str, str]] = ("x (sides)", "y (sides)")
    kind: Literal["point-maze"] = "point-maze"
    layout: Literal["open", "wall", "maze", "rooms"] = Field(
        default="wall",
        description="walls: none, one with a gap at its upper end, two with gaps in turn, or four rooms with "
        "doors",
    )
    move: float = Field(
        default=0.05, gt=0, le=0.1, description="longest move along an axis, in sides of the square"
    )
    goal_radius: float = Field(default=0.1, gt=0, description="radius of the goal, in sides of the square")
    max_steps: MaxSteps = 150


class DoublePendulum(ControlTask, frozen=True):
    """Swing a two-link pendulum up with one weak motor (thesis, p. 107; Gym's Acrobot)."""

    target: ClassVar[str] = "bojax.envs.double_pendulum:DoublePendulum"
    kind: Literal["double-pendulum"] = "double-pendulum"
    actuated: Literal["base", "elbow"] = Field(
        default="base", description="driven joint: the base (p. 107), or the elbow (Gym, author's code)"
    )
    goal: Literal["distance", "height"] = Field(
        default="distance",
        description="quantity measured at the goal: distance of the tip to the highest point (p. 107), or "
        "height of the tip (Gym)",
    )
    goal_distance: float = Field(
        default=1.0, gt=0, description="largest distance to the highest point, or depth below it, m"
    )
    actions: Literal["continuous", "sign"] = Field(
        default="continuous", description="the torque is the action, or max_torque with the action's sign"
    )
    max_torque: float = Field(default=1.0, gt=0, description="largest torque, N m")
    time_step: float = Field(default=0.2, gt=0, description="time step, s")


class CartpoleSwingUp(ControlTask, frozen=True):
    """Swing a pole up by moving its cart (thesis, p. 107; Gym's CartPole, with the pole hanging at first)."""

    target: ClassVar[str] = "bojax.envs.cartpole_swing_up:CartpoleSwingUp"
    observation_names: ClassVar[tuple[str, str]] = ("position (m)", "velocity (m/s)")
    kind: Literal["cartpole-swing-up"] = "cartpole-swing-up"
    goal_cosine: float = Field(default=0.8, ge=-1, lt=1, description="least cosine of the angle at the goal")
    limit: float = Field(default=2.4, gt=0, description="half the track's length, m; 3 in the author's code")
    actions: Literal["continuous", "sign"] = Field(
        default="continuous", description="the force is the action, or max_force with the action's sign"
    )
    max_force: float = Field(default=10.0, gt=0, description="largest force, N")
    time_step: float = Field(default=0.02, gt=0, description="time step, s")


class CliffWalking(Environment, frozen=True):
    """Walk along a cliff to a goal, on a grid of 4 x 12 (Sutton & Barto, Example 6.6)."""

    target: ClassVar[str] = "bojax.envs.cliff_walking:CliffWalking"
    kind: Literal["cliff-walking"] = "cliff-walking"
    max_steps: MaxSteps = 1000
    slip: float = Field(
        default=0.01, ge=0, le=1, description="probability of a direction drawn uniformly from all four"
    )
    reward_scale: float = Field(default=1.0, gt=0, description="factor of every reward")
    reward: Literal["goal-only", "classic"] = Field(
        default="goal-only",
        description="reward: 1 for the goal, -1 for a fall and 0 otherwise; or -100 for a fall and -1 for "
        "any other step, as in Gymnasium",
    )


class Taxi(Environment, frozen=True):
    """Fetch a passenger on a grid of 5 x 5 and bring them to their destination (Dietterich 2000)."""

    target: ClassVar[str] = "bojax.envs.taxi:Taxi"
    kind: Literal["taxi"] = "taxi"
    max_steps: MaxSteps = 1000
    reward_scale: float = Field(default=1.0, gt=0, description="factor of every reward")
    reward: Literal["goal-only", "classic"] = Field(
        default="goal-only",
        description="reward: 1 for the right drop-off, -0.1 for any other drop-off and for a pick-up where "
        "nobody waits, and 0 otherwise; or 20, -10 and -1, but -1 for a drop-off at a wrong place, as in "
        "Gymnasium",
    )


class Chain(Environment, frozen=True):
    """Walk to the end of a chain of N states, where a step to the right may lead left (thesis, Fig. 5.6a)."""

    target: ClassVar[str] = "bojax.envs.chain:Chain"
    kind: Literal["chain"] = "chain"
    max_steps: MaxSteps = 1000
    length: int = Field(
        default=10, ge=2, description="number of states (N), up to max_length; a sweep over it compiles once"
    )
    sparsity: float = Field(
        default=1.0,
        ge=0,
        le=1,
        description="sparsity (p): a step not to the goal pays -1 with probability 1 - p",
    )
    start: int = Field(default=0, ge=0, description="initial state; 0 is the first (S_1)")
    max_length: int = Field(default=20, ge=2, description="number of declared observations")

    @pydantic.model_validator(mode="after")
    def _fits(self) -> "Chain":
        if self.length > self.max_length:
            raise ValueError(f"length: at most max_length, which is {self.max_length}; got {self.length}")
        if self.start >= self.length - 1:
            raise ValueError(f"start: less than length - 1, which is the goal; got {self.start}")
        return self


class LunarLander(ControlTask, frozen=True):
    """Land on a pad between hills (thesis, p. 107; Gym's LunarLander, continuous)."""

    target: ClassVar[str] = "bojax.envs.lunar_lander:LunarLander"
    kind: Literal["lunar-lander"] = "lunar-lander"
    goal_distance: float = Field(
        default=0.05,
        gt=0,
        description="distance from the pad's centre below which the goal is reached, in units of the "
        "observation: 0.05 is 0.5 m across and 0.33 m up",
    )
    goal: Literal["distance", "box"] = Field(
        default="distance",
        description="quantity that is below goal_distance at the goal: the distance from the pad's centre "
        "(p. 107), or the larger of its two components (the author's code)",
    )
    classic_reward: ClassicReward = classic_reward(-100)
    gravity: float = Field(default=10.0, ge=0, description="gravitational acceleration, m/s^2")
    main_power: float = Field(
        default=13.0,
        ge=0,
        description="impulse of the main engine at full power, N s per m from the hull's origin",
    )
    side_power: float = Field(default=0.6, ge=0, description="the same for the side engines, N s / m")
    dispersion: float = Field(
        default=1.0, ge=0, description="scale of the noise on direction and magnitude of an impulse; 1 in Gym"
    )
    max_push: float = Field(default=1000.0, ge=0, description="largest component of the initial force, N")
    max_speed: float = Field(default=1000.0, gt=0, description="speed that means divergence, m/s or rad/s")


Bounds = float | Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
"""One number, or one for each component."""


class Brax(Environment, frozen=True):
    """An environment of Brax, compiled."""

    target: ClassVar[str] = "bojax.envs.brax:BraxEnv"
    kind: Literal["brax"] = "brax"
    name: str = Field(min_length=1, description="name in the registry of Brax, such as reacher")
    backend: Literal["mjx", "generalized", "positional", "spring"] = Field(
        default="mjx", description="physics backend"
    )
    low: Bounds = Field(
        default=-10.0,
        description="lower bound of observations, one number or one for each component; Brax declares none",
    )
    high: Bounds = Field(
        default=10.0, description="upper bound of observations, one number or one for each component"
    )
    success_reward: float | None = Field(
        default=None, description="smallest reward of a successful step; null if no step is a success"
    )


class Gymnasium(EnvironmentSettings, frozen=True):
    """An environment of Gymnasium, stepped on the host while the learner is compiled (extra `gym`)."""

    target: ClassVar[str] = "bojax.envs.gymnasium:HostEnv"
    kind: Literal["gymnasium"] = "gymnasium"
    id: str = Field(
        min_length=1,
        description="id in Gymnasium, such as MountainCar-v0; module:Name-v0 imports the module first",
    )
    kwargs: dict[str, Any] = Field(default={}, description="arguments of the environment's constructor")
    low: Bounds | None = Field(
        default=None,
        description="lower bound of observations, one number or one for each component; null for the "
        "declared bound, which has to be finite",
    )
    high: Bounds | None = Field(
        default=None,
        description="upper bound of observations; null for the declared bound, which has to be finite",
    )
    max_steps: int | None = Field(
        default=None,
        ge=1,
        description="number of steps after which an episode is truncated; null for the registered limit",
    )
    success: Literal["never", "terminated", "reward", "info"] = Field(
        default="never",
        description="success: never; an episode that ends in a terminal state, even one of failure; "
        "a step whose reward is at least success_reward; or a step whose info says so",
    )
    success_reward: float = Field(
        default=1.0, description="smallest reward of a successful step, if success is reward"
    )
    success_key: str | None = Field(
        default=None,
        min_length=1,
        description="key of info that tells success, if success is info; null for is_success or success",
    )

    @pydantic.model_validator(mode="after")
    def _can_be_made(self) -> "Gymnasium":
        if self.success_key is not None and self.success != "info":
            raise ValueError(f'success_key: got "{self.success_key}"; allowed: null, unless success is info')
        try:
            json.dumps(self.kwargs)
        except TypeError as error:
            raise ValueError(f"kwargs: {error}") from error
        return self

    @property
    @override
    def imported_module(self) -> tuple[str, str] | None:
        """The module that registers the environment, if the id names one (`module:Name-v0`)."""
        module, colon, _ = self.id.partition(":")
        return (module, "id") if colon else None
