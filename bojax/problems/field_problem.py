"""Field monitoring (Chapter 3 and Section 4.7.1): learn a field from noisy samples along trajectories."""

from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar
from typing_extensions import override

from bojax.areas.outlined import OutlinedArea, check_sampling
from bojax.fields.base import Field
from bojax.models.checks import cast, check_takes, is_known
from bojax.models.evidence import log_normal_prior, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.information import Places
from bojax.models.kernels import Kernel
from bojax.models.lookahead import LookaheadRoot
from bojax.models.means import Mean
from bojax.motions.base import Motions, Path, Pose
from bojax.numerics.lanes import any_lane
from bojax.problems.arena import Arena
from bojax.problems.budgets import check_steps, distance_of
from bojax.problems.field_belief import FieldBelief, Samples
from bojax.problems.field_errors import (
    DISTANCE,
    FIELD_COLUMNS,
    REGION_COLUMNS,
    STEP_COLUMNS,
    STEP_ERRORS,
    Weighting,
    field_errors,
)
from bojax.problems.field_simulation import FieldNode, root_node, simulate_paths
from bojax.problems.objectives import FieldObjective, JointObjective
from bojax.problems.path_problem import PathEvents, PathProblem, Simulation
from bojax.problems.sensors import PointSensor, Sensor
from bojax.problems.vehicles.base import Exact, Vehicle, VehicleState
from bojax.problems.walls import Boxes, is_inside
from bojax.problems.ways_to_end import WaysToEnd, check_budget, ways_around
from bojax.results.outline import Outline
from bojax.results.schema import Table

FILM_RESOLUTION = 31
"""Largest number of grid points per side at which the belief after every step is recorded."""

STARTS = 101  # points per side from which an end point must be in reach, if the start is random
PLACES = 15  # points per side at which the variance of the domain is integrated

RELEARN_STARTS = 2  # number of starts of hyper-parameter learning: the current values, and a draw around them


class FieldWorld(eqx.Module):
    """True state of an episode."""

    vehicle: VehicleState  # state of the vehicle
    collisions: Int[Array, ""]  # number of collisions with a wall
    gradient: Float[Array, ""]  # sum of the norm of the true field's gradient over the samples taken
    # Distance driven along the poses of the paths, m; None if it is not a column
    distance: Float[Array, ""] | None = None
    left: Float[Array, ""] | None = None  # distance left of the budget, m; None without a budget


class FieldProblem(PathProblem):
    """Learn a field from noisy samples along trajectories, judged by the errors of the final belief.

    The reward of a path is the sum of the rewards of its samples, under the belief before the path (3.2,
    4.11), plus the cost of collisions and of leaving the domain. The planner knows the walls, the border and
    the pose of the robot, but not the field. A wall or the border stops the robot at the last reachable pose
    of the path; later samples are neither taken nor rewarded. The robot then keeps its heading
    (`after_collision: "stop"`) or turns round on the spot (`"turn"`, not available to a vehicle with a
    turning radius). With a budget of distance, or of time at a speed, the robot stops at the last pose that
    it allows, and the episode ends. With an end point, it stops at the last pose from which the budget
    suffices to reach this point, drives the shortest way there, and the episode ends there. The same rules
    hold in the world and in the simulations of every planner. Plans, beliefs and simulations need no true
    field; without one, the problem has no world to execute a path in, and no scores.

    Settings: `bojax.problems.settings.Monitoring`, `Diagonal`, `TwoPits` and `SpaceModelling`.
    """

    scores: ClassVar[Table] = FIELD_COLUMNS

    field: Field | None
    domain: Float[Array, "4"]
    walls: Boxes | None
    start: Float[Array, "3"] | None
    target_area: Float[Array, "4"] | None
    objective: FieldObjective
    kernel: Kernel
    mean: Mean
    noise_variance: Float[Array, ""]
    noise: Float[Array, ""]
    pose_noise: Float[Array, "2"] | None = eqx.field(default=None, kw_only=True)
    collision_reward: Float[Array, ""]
    exit_reward: Float[Array, ""]
    margin: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.zeros(()), kw_only=True)
    relearn_spread: Float[Array, ""]
    budget: Float[Array, ""] | None = eqx.field(default=None, kw_only=True)
    time_budget: Float[Array, ""] | None = eqx.field(default=None, kw_only=True)
    speed: Float[Array, ""] | None = eqx.field(default=None, kw_only=True)
    end: Float[Array, "2"] | None = eqx.field(default=None, kw_only=True)
    area: OutlinedArea | None = eqx.field(default=None, kw_only=True)
    ways: WaysToEnd | None = eqx.field(default=None, kw_only=True)
    region: Float[Array, "4"] | OutlinedArea | None = eqx.field(default=None, kw_only=True)
    vehicle: Vehicle = eqx.field(default_factory=Exact, kw_only=True)
    sensor: Sensor = eqx.field(default_factory=PointSensor, kw_only=True)
    max_steps: int = eqx.field(static=True)
    resolution: int = eqx.field(static=True)
    relearn_every: int = eqx.field(static=True)
    imagined: Literal["sample", "mean"] = eqx.field(static=True)
    after_collision: Literal["stop", "turn"] = eqx.field(static=True)
    weighting: Weighting = eqx.field(static=True)
    errors_by_step: bool = eqx.field(static=True, default=False, kw_only=True)

    def __post_init__(self):
        has_obstacles = self.walls is not None or self.area is not None
        if self.end is not None and has_obstacles and self.ways is None:
            self.ways = ways_around(self.end, self.domain, self.walls, self.area)

    @override
    def __check_init__(self):
        """Check that kernel, mean, sensor, field and vehicle fit together, or raise ValueError."""
        check_takes("kernel", self.kernel, 2, 2, self.domain.dtype, "the coordinates of the plane")
        check_takes("mean", self.mean, 1, 2, self.domain.dtype, "the coordinates of the plane")
        if self.field is not None:
            self.sensor.check(self.field, self.grid(), self.vehicle.flight_altitude)
        radius = self.vehicle.turning_radius
        if radius > 0.0 and self.after_collision == "turn":
            raise ValueError(
                f'after_collision: got "turn"; the vehicle cannot turn on the spot, its turning radius is '
                f'{radius:.2f} m: set "stop"'
            )
        if radius > 0.0 and self.end is not None:
            raise ValueError(
                "end: the vehicle cannot turn on the spot, and so not follow the shortest way there; allowed "
                "with a turning radius: null"
            )
        if self.region is not None and is_known((self.region, self.domain, self.walls, self.area)):
            grid = self.grid()
            if not jnp.any(self._is_in_region(grid) & self.arena.is_free(grid)):
                raise ValueError("region: no free point of the grid of the errors lies in it")
        if self.ways is not None:
            arena = self.arena
            starts = arena.grid(STARTS) if self.start is None else self.start[None, :2]
            is_free = arena.is_free(starts) | (len(starts) == 1)
            check_budget(self.ways, starts, is_free, self._budget, self.speed)

    def _is_in_region(self, points: Float[Array, "G 2"]) -> Bool[Array, "G"]:
        if isinstance(self.region, OutlinedArea):
            return self.region.is_inside(points)
        assert self.region is not None
        return is_inside(points, self.region)

    @override
    def check_motions(self, motions: Motions) -> None:
        super().check_motions(motions)
        self.check_paths(motions.length, motions.num_samples, "planner.motions.length")

    def check_paths(self, length: Float[Array, ""], num_samples: int, name: str) -> None:
        """Refuse paths of a length, the setting `name`, that have too few checks or miss the end."""
        if self.area is not None:
            check_sampling(self.area, float(length) / num_samples)
        if self.end is not None and (budget := self._budget) is not None:
            check_steps(float(budget), self.max_steps, float(length), name)

    @override
    def outline(self) -> Outline | None:
        """The outline of an area; without one, the settings have it."""
        if self.area is None:
            return None
        return self.arena.outline(self.start)

    @property
    def true_field(self) -> Field:
        """The field that the world has.

        Raises:
            ValueError: The world has no field.
        """
        if self.field is None:
            raise ValueError("field: got none; allowed, to execute a path or to score a belief: a true field")
        return self.field

    @property
    def measures_distance(self) -> bool:
        """Whether `steps.parquet` has the distance driven."""
        return self.errors_by_step or self._budget is not None

    @property
    def _budget(self) -> Float[Array, ""] | None:
        """The distance that may be driven, m."""
        budget = distance_of(self.budget, self.time_budget, self.speed)
        return None if budget is None else budget.astype(self.domain.dtype)

    @property
    @override
    def step_columns(self) -> Table:
        distance = (DISTANCE,) if self.measures_distance else ()
        return super().step_columns + distance + self._error_columns

    @property
    def _error_columns(self) -> Table:
        """Errors of the belief after every step."""
        if not self.errors_by_step:
            return ()
        return STEP_COLUMNS if self.region is None else STEP_COLUMNS + REGION_COLUMNS

    @override
    def row(self, world: FieldWorld) -> dict[str, Scalar]:
        return super().row(world) | ({} if world.distance is None else {"distance": world.distance})

    @override
    def belief_row(self, world: FieldWorld, belief: FieldBelief) -> dict[str, Scalar]:
        """The errors after the step, on the grid of the final scores."""
        if not self.errors_by_step:
            return {}
        scores = FieldProblem.score(self, world, belief)  # without those that a subclass adds
        return {column.name: scores[column.name] for column in self._error_columns}

    @property
    def arena(self) -> Arena:
        """The area that the robot moves in."""
        straight = None if self.end is None else WaysToEnd.straight(self.end)
        return Arena(
            domain=self.domain,
            margin=self.margin.astype(self.domain.dtype),
            walls=self.walls,
            target_area=self.target_area,
            collision_reward=self.collision_reward,
            exit_reward=self.exit_reward,
            after_collision=self.after_collision,
            ways=cast(straight if self.ways is None else self.ways, self.domain.dtype),
            area=cast(self.area, self.domain.dtype),
        )

    @override
    def reset(self, key: Key[Array, ""]) -> FieldWorld:
        pose = self.arena.random_pose(key) if self.start is None else self.start
        zero = jnp.zeros((), self.domain.dtype)
        distance = zero if self.measures_distance else None
        return FieldWorld(self.vehicle.reset(pose), jnp.zeros((), jnp.int32), zero, distance, self._budget)

    @override
    def prior(self, key: Key[Array, ""], world: FieldWorld, num_samples: int) -> FieldBelief:
        """The prior of the field and the known initial pose."""
        capacity = self.max_steps * num_samples
        return FieldBelief(
            pose=self.vehicle.estimate(world.vehicle),
            posterior=GaussianProcess.prior(self.kernel, self.noise_variance, capacity, 2, self.mean),
            step=jnp.zeros((), jnp.int32),
            counts=jnp.zeros((self.max_steps + 1,), jnp.int32),
            key=key,
            num_samples=num_samples,
            left=self._budget,
        )

    @override
    def execute(
        self, key: Key[Array, ""], world: FieldWorld, action: Path
    ) -> tuple[FieldWorld, Samples, PathEvents]:
        """Drive a path and take its samples."""
        arena = self.arena
        start = self.vehicle.estimate(world.vehicle)
        driven, left = arena.drive_within(start, action, world.left)
        # x and y are measured with the same deviation.
        noise = None if self.pose_noise is None else self.pose_noise[jnp.asarray([0, 0, 1])]
        tracked = self.vehicle.follow(
            jax.random.fold_in(key, 0), world.vehicle, driven.poses, arena.end(driven), noise
        )
        # Samples are values at the true poses, assigned to the estimated ones.
        field = self.true_field
        values = self.sensor(key, field, tracked.poses, tracked.sensor_poses, self.noise)
        slope = jnp.sqrt(jnp.sum(field.gradients(tracked.poses[:, :2]) ** 2, axis=-1))
        after = FieldWorld(
            vehicle=tracked.state,
            collisions=world.collisions + driven.collided.astype(jnp.int32),
            gradient=world.gradient + jnp.sum(jnp.where(driven.is_driven, slope, 0.0)),
            distance=None if world.distance is None else world.distance + driven.length_from(start),
            left=left,
        )
        terminated = jnp.zeros((), bool) if left is None else left <= 0.0
        has_goal = self.end is None or self.target_area is not None
        events = PathEvents(
            reward=arena.cost(driven),
            terminated=terminated,
            success=arena.reaches_target(driven) if has_goal else terminated,
            exited=driven.exited,
            driven=tracked.poses,
            is_driven=driven.is_driven,
            frames=tracked.frames,
            failed=tracked.failed,
        )
        pose = self.vehicle.estimate(tracked.state)
        return after, Samples(tracked.estimates[:, :2], values, driven.is_driven, pose, left), events

    @override
    def update(
        self, belief: FieldBelief, action: Path, observation: Samples, key: Key[Array, ""] | None = None
    ) -> FieldBelief:
        """The belief after the samples of a path, with updated hyper-parameters where they are due."""
        posterior = belief.posterior.extend(observation.points, observation.values, observation.is_taken)
        if self.relearn_every > 0:
            step = belief.step + 1
            is_due = step % self.relearn_every == 0
            key = jax.random.fold_in(belief.key, step)
            # Runs that start together stay at the same step, so that in most steps no lane is due.
            learned = jax.lax.cond(
                any_lane(is_due),
                lambda key, old: self._relearned(key, old),
                lambda key, old: old,
                key,
                posterior,
            )
            posterior = jax.tree.map(lambda new, old: jnp.where(is_due, new, old), learned, posterior)
        return belief.after(posterior, observation.pose, observation.left)

    @override
    def reward(
        self, objective: FieldObjective | None, belief: FieldBelief, action: Path, events: PathEvents
    ) -> Scalar:
        """Rewards of the samples taken, under the belief before the path, plus the cost of the path."""
        objective = self.objective if objective is None else objective
        points = events.driven[:, :2]
        if isinstance(objective, JointObjective):
            posterior = belief.posterior
            places = self._places(posterior) if objective.is_elsewhere else None
            return events.reward + jnp.sum(objective.of_samples(posterior, places, points, events.is_driven))
        mean, variance = belief.posterior.predict(points)
        gradient = belief.posterior.predict_gradient(points) if objective.needs_gradient else None
        rewards = objective(mean, variance, gradient)
        return events.reward + jnp.sum(jnp.where(events.is_driven, rewards, 0.0))

    @override
    def root(self, belief: FieldBelief, horizon: int) -> tuple[LookaheadRoot, FieldNode]:
        """The factored posterior, and the root node; for an objective elsewhere, with the places."""
        node = root_node(belief.pose, horizon, belief.num_samples, self.domain.dtype, belief.left)
        places = self._places(belief.posterior) if self.objective.is_elsewhere else None
        return LookaheadRoot.of(belief.posterior, places), node

    @override
    def with_objective(self, objective: FieldObjective | None) -> "FieldProblem":
        if objective is None:
            return self
        # No `replace`: the checks of the constructor read numbers, which a traced problem does not have.
        return eqx.tree_at(lambda problem: problem.objective, self, objective)

    def _places(self, posterior: GaussianProcess) -> Places:
        """Points of the domain without its walls, for `InformationObjective`."""
        points = self.arena.grid(PLACES)
        return Places.of(posterior, points, self.arena.is_free(points).astype(points.dtype))

    @override
    def simulate(
        self,
        key: Key[Array, ""],
        root: LookaheadRoot,
        node: FieldNode,
        paths: Float[Array, "H S 3"],
        objective: FieldObjective | None,
    ) -> Simulation:
        objective = self.objective if objective is None else objective
        return simulate_paths(key, root, node, paths, objective, self.arena, self.imagined)

    @override
    def pose(self, world: FieldWorld) -> Pose:
        return self.vehicle.pose(world.vehicle)

    @property
    @override
    def turning_radius(self) -> float:
        return self.vehicle.turning_radius

    @property
    @override
    def reach(self) -> float:
        return self.vehicle.reach

    def grid(self) -> Float[Array, "G 2"]:
        """Points of the grid on which the final belief is scored, in rows of equal y."""
        return self.arena.grid(self.resolution)

    @override
    def score(self, world: FieldWorld, belief: FieldBelief) -> dict[str, Scalar]:
        """The columns of `FIELD_COLUMNS`, and with a region those of `REGION_COLUMNS`."""
        grid, posterior = self.grid(), belief.posterior
        mean, variance = belief.predict_grid(grid, self.resolution)
        is_open = self.arena.is_free(grid)
        taken = jnp.maximum(posterior.count + posterior.num_ignored, 1).astype(mean.dtype)
        errors = field_errors(self.true_field, grid, mean, variance, is_open, self.weighting)
        if self.region is not None:
            counts = is_open & self._is_in_region(grid)
            within = field_errors(self.true_field, grid, mean, variance, counts, self.weighting)
            errors |= {f"{name}_region": within[name] for name in STEP_ERRORS}
        return errors | {
            "collisions": world.collisions,
            "sampled_gradient": world.gradient / taken,
            "ignored_samples": posterior.num_ignored,
        }

    @override
    def snapshot(self, world: FieldWorld, belief: FieldBelief) -> dict[str, dict[str, Array]]:
        """The field and the belief on the grid, the samples, and the belief after every step.

        `means` and `stds`, `[T + 1, R, R]` from the prior on, are on a grid of at most `FILM_RESOLUTION`
        points per side over the same domain, see `FieldBelief.history`.
        """
        x, y = self.arena.axes(self.resolution)
        grid = self.grid()
        mean, variance = belief.predict_grid(grid, self.resolution)
        posterior = belief.posterior
        samples = jnp.concatenate([posterior.x, posterior.y[:, None]], axis=-1)
        shape = (self.resolution, self.resolution)
        means, stds = belief.history(*self.arena.axes(min(self.resolution, FILM_RESOLUTION)))
        return {
            "belief": {
                "x": x,
                "y": y,
                "truth": self.true_field.values(grid).reshape(shape),
                "mean": mean.reshape(shape),
                "std": jnp.sqrt(variance).reshape(shape),
                "samples": jnp.where(posterior.is_held()[:, None], samples, jnp.nan),
                "means": means,
                "stds": stds,
            }
        }

    def _relearned(self, key: Key[Array, ""], posterior: GaussianProcess) -> GaussianProcess:
        """The posterior under the maximum a posteriori hyper-parameters.

        Each hyper-parameter has a log-normal prior about its setting: a few samples alone hardly constrain a
        lengthscale.
        """
        log_prior = log_normal_prior(self.kernel, self.noise_variance, self.relearn_spread)
        return relearn(posterior, key, log_prior=log_prior, num_starts=RELEARN_STARTS)[0]
