"""Monitoring a field: learn it by driving trajectories on which samples are taken (Chapters 3 and 4.7.1)."""

from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar

from bojax.fields.base import Field
from bojax.models.evidence import log_normal_prior, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Kernel
from bojax.models.lookahead import LookaheadRoot, look_ahead
from bojax.models.means import Mean
from bojax.motions.base import Path, Pose, place
from bojax.numerics.angles import wrap_to_2pi
from bojax.numerics.lanes import any_lane
from bojax.problems.base import Events, Problem, Simulation
from bojax.problems.objectives import FieldObjective
from bojax.problems.sensors import PointSensor, Sensor
from bojax.problems.vehicles.base import Body, Exact, Vehicle
from bojax.problems.walls import Boxes, Drive, drive_until_blocked, is_free
from bojax.results.schema import Column, Table

START_TRIES = 256
"""Poses among which a random start is the first free one."""

FILM_RESOLUTION = 31
"""Most points a side of the maps that are kept of the belief after every step."""

RELEARN_STARTS = 2
"""Starts of learning hyper-parameters: those held, and one around them."""


class FieldWorld(eqx.Module):
    """The state of an episode.

    Attributes:
        body: The vehicle.
        collisions: Times that a wall stopped the robot.
        gradient: Sum over the samples taken of the norm of the true field's gradient.
    """

    body: Body
    collisions: Int[Array, ""]
    gradient: Float[Array, ""]


class Samples(eqx.Module):
    """What a robot learns from a path.

    Attributes:
        points: Where it took itself to be.
        values: What it saw.
        is_taken: Whether it came there.
        pose: Where it takes itself to be now.
    """

    points: Float[Array, "S 2"]
    values: Float[Array, "S"]
    is_taken: Bool[Array, "S"]
    pose: Pose


class FieldBelief(eqx.Module):
    """What the robot knows: its pose, and a Gaussian process over the field.

    Attributes:
        pose: Where the robot takes itself to be.
        posterior: The belief about the field.
        step: Paths driven.
        counts: Samples held at the start and after each path; 0 after those to come.
        key: What learning hyper-parameters draws its starts from.
        num_samples: Most samples of a path.
    """

    pose: Pose
    posterior: GaussianProcess
    step: Int[Array, ""]
    counts: Int[Array, "N"]
    key: Key[Array, ""]
    num_samples: int = eqx.field(static=True)


class FieldNode(eqx.Module):
    """A belief in the search tree: what was imagined since the root.

    Attributes:
        pose: The robot's pose.
        level: Actions since the root.
        samples: Samples by action; the last action's are never conditioned on. A row is x and y, what was
            seen there (the innovation of `look_ahead`), and 1 if the sample was taken, else 0: one array,
            since each is one more kernel of every iteration.
    """

    pose: Pose
    level: Int[Array, ""]
    samples: Float[Array, "*N B 4"]

    @property
    def points(self) -> Float[Array, "*N B 2"]:
        """Where the samples were taken."""
        return self.samples[..., :2]

    @property
    def innovations(self) -> Float[Array, "*N B"]:
        """What they said."""
        return self.samples[..., 2]

    @property
    def is_taken(self) -> Bool[Array, "*N B"]:
        """Whether there is such a sample."""
        return self.samples[..., 3] > 0.0


class FieldMonitoring(Problem):
    """Learn a field from noisy samples taken along trajectories.

    A path pays what its samples are worth under the belief before it, summed (3.2, 4.11), plus what
    collisions and leaving the domain cost. Walls, border and pose are known to the planner, the field is
    not. Walls and border end the robot's path at the last pose of it that can be reached; samples past it
    are neither taken nor paid. Then the robot stands still (`after_collision: "stop"`) or turns round on the
    spot (`"turn"`, which a vehicle with a turning radius cannot): the same in the world and in a planner's
    simulations, for every planner.

    Attributes:
        field: The field.
        domain: The border, `[x_min, y_min, x_max, y_max]` in metres.
        walls: Walls.
        start: Pose at the start; if there is none, it is random, uniform over the free space.
        target_area: The area that has to be reached for success, `[x_min, y_min, x_max, y_max]` in metres.
        objective: What a sample is worth, for the task.
        kernel: Prior covariance of the field.
        mean: Prior mean of the field.
        noise_variance: Variance of the observation noise that the belief assumes.
        noise: Standard deviation of the observation noise.
        pose_noise: Standard deviations of a reading of the robot's pose, in m and rad; None for exact ones.
        collision_reward: Paid when a wall stops the robot.
        exit_reward: Paid when the border stops it.
        relearn_spread: Standard deviation of the logarithm of each hyper-parameter around its setting.
        vehicle: Who follows the paths; planners take it that they are followed exactly.
        sensor: How the field is measured.
        max_steps: Actions an episode.
        resolution: Points a side of the grid on which the final belief is scored.
        relearn_every: Steps after which the belief learns its hyper-parameters anew; 0 for never.
        imagined: Simulated observations are drawn from the belief (`"sample"`), or its `"mean"`.
        after_collision: What a robot does that was stopped.
        weighting: Weights of `wrmse`, see `weights`.
    """

    scores: ClassVar[Table] = (
        Column("rmse", "float64", "", "root mean square error of the final belief"),
        Column("wrmse", "float64", "", "the same, weighted towards what matters"),
        Column("mnll", "float64", "", "mean negative log likelihood of the field under the final belief"),
        Column("collisions", "int32", "", "times that a wall stopped the robot"),
        Column("sampled_gradient", "float64", "1/m", "mean norm of the field's gradient at the samples"),
    )

    field: Field
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
    relearn_spread: Float[Array, ""]
    vehicle: Vehicle = eqx.field(default_factory=Exact, kw_only=True)
    sensor: Sensor = eqx.field(default_factory=PointSensor, kw_only=True)
    max_steps: int = eqx.field(static=True)
    resolution: int = eqx.field(static=True)
    relearn_every: int = eqx.field(static=True)
    imagined: Literal["sample", "mean"] = eqx.field(static=True)
    after_collision: Literal["stop", "turn"] = eqx.field(static=True)
    weighting: Literal["gradient", "gradient-norm", "value"] = eqx.field(static=True)

    def __check_init__(self):
        """See `Sensor.check`: what it cannot measure is told before anything runs.

        Raises:
            ValueError: The sensor refuses the field, or the vehicle cannot turn on the spot and is told to.
        """
        self.sensor.check(self.field, self.grid(), self.vehicle.flight_altitude)
        radius = self.vehicle.turning_radius
        if radius > 0.0 and self.after_collision == "turn":
            raise ValueError(
                f'after_collision: got "turn"; the vehicle cannot turn on the spot, its turning radius is '
                f'{radius:.2f} m: set "stop"'
            )

    def reset(self, key: Key[Array, ""]) -> FieldWorld:
        """See `Problem`."""
        pose = self._random_start(key) if self.start is None else self.start
        zero = jnp.zeros((), self.domain.dtype)
        return FieldWorld(self.vehicle.place(pose), jnp.zeros((), jnp.int32), zero)

    def prior(self, key: Key[Array, ""], world: FieldWorld, num_samples: int) -> FieldBelief:
        """The prior of the field, and the pose, which is known at the start."""
        capacity = self.max_steps * num_samples
        return FieldBelief(
            pose=self.vehicle.estimate(world.body),
            posterior=GaussianProcess.prior(self.kernel, self.noise_variance, capacity, 2, self.mean),
            step=jnp.zeros((), jnp.int32),
            counts=jnp.zeros((self.max_steps + 1,), jnp.int32),
            key=key,
            num_samples=num_samples,
        )

    def execute(
        self, key: Key[Array, ""], world: FieldWorld, path: Path
    ) -> tuple[FieldWorld, Samples, Events]:
        """Drive a path and take the samples."""
        driven = self._drive(self.vehicle.estimate(world.body), path)
        noise = None if self.pose_noise is None else self.pose_noise[jnp.asarray([0, 0, 1])]
        ride = self.vehicle.follow(
            jax.random.fold_in(key, 0), world.body, driven.poses, self._end(driven), noise
        )
        values = self.sensor(key, self.field, ride.poses, ride.mounts, self.noise)
        slope = jnp.sqrt(jnp.sum(self.field.gradients(ride.poses[:, :2]) ** 2, axis=-1))
        after = FieldWorld(
            body=ride.body,
            collisions=world.collisions + driven.collided.astype(jnp.int32),
            gradient=world.gradient + jnp.sum(jnp.where(driven.is_driven, slope, 0.0)),
        )
        events = Events(
            reward=self._cost(driven),
            terminated=jnp.zeros((), bool),
            success=self._is_reached(driven),
            exited=driven.exited,
            driven=ride.poses,
            is_driven=driven.is_driven,
            frames=ride.frames,
            failed=ride.failed,
        )
        pose = self.vehicle.estimate(ride.body)
        return after, Samples(ride.estimates[:, :2], values, driven.is_driven, pose), events

    def update(self, belief: FieldBelief, path: Path, observation: Samples) -> FieldBelief:
        """The belief after the samples of a path, with new hyper-parameters where they are due."""
        del path
        posterior = belief.posterior.extend(observation.points, observation.values, observation.is_taken)
        step = belief.step + 1
        if self.relearn_every > 0:
            is_due = step % self.relearn_every == 0
            key = jax.random.fold_in(belief.key, step)
            # In a batch the lanes are at the same step: the branch is not taken where none is due.
            learned = jax.lax.cond(
                any_lane(is_due),
                lambda key, old: self._relearned(key, old),
                lambda key, old: old,
                key,
                posterior,
            )
            posterior = jax.tree.map(lambda new, old: jnp.where(is_due, new, old), learned, posterior)
        return FieldBelief(
            pose=observation.pose,
            posterior=posterior,
            step=step,
            counts=belief.counts.at[step].set(posterior.count, mode="drop"),
            key=belief.key,
            num_samples=belief.num_samples,
        )

    def _relearned(self, key: Key[Array, ""], posterior: GaussianProcess) -> GaussianProcess:
        """The posterior with the hyper-parameters of greatest posterior density.

        Each has a log-normal prior around its setting: a few samples alone say little about a lengthscale.
        """
        log_prior = log_normal_prior(self.kernel, self.noise_variance, self.relearn_spread)
        return relearn(posterior, key, log_prior=log_prior, num_starts=RELEARN_STARTS)[0]

    def reward(
        self, objective: FieldObjective | None, belief: FieldBelief, path: Path, events: Events
    ) -> Scalar:
        """What the samples taken are worth under the belief before the path, plus what the path cost."""
        del path
        objective = self.objective if objective is None else objective
        points = events.driven[:, :2]
        mean, variance = belief.posterior.predict(points)
        gradient = belief.posterior.predict_gradient(points) if objective.needs_gradient else None
        worth = objective(mean, variance, gradient)
        return events.reward + jnp.sum(jnp.where(events.is_driven, worth, 0.0))

    def root(self, belief: FieldBelief, horizon: int) -> tuple[LookaheadRoot, FieldNode]:
        """See `Problem`: the factored posterior, and a node with room for all samples but the last path's."""
        samples = jnp.zeros(((horizon - 1) * belief.num_samples, 4), self.domain.dtype)
        node = FieldNode(belief.pose, jnp.zeros((), jnp.int32), samples)
        return LookaheadRoot.of(belief.posterior), node

    def simulate(
        self,
        key: Key[Array, ""],
        root: LookaheadRoot,
        node: FieldNode,
        paths: Float[Array, "H S 3"],
        objective: FieldObjective | None,
    ) -> Simulation:
        """Drive the paths one after the other, and imagine what the samples say.

        All samples since the root, those on the way to the node first, are one look ahead: nothing is
        refitted. What lies past the horizon is dropped.
        """
        objective = self.objective if objective is None else objective
        num_paths, size = paths.shape[:2]
        room = node.samples.shape[0]
        horizon = room // size + 1
        pose, drives = node.pose, []
        for path in paths:
            drives.append(self._drive(pose, path))
            pose = self._end(drives[-1])
        innovations = jnp.zeros((num_paths, size), paths.dtype)
        if self.imagined == "sample":
            innovations = jax.random.normal(key, (num_paths * size,), paths.dtype).reshape(num_paths, size)
        new = [
            jnp.column_stack([drive.poses[:, :2], seen, drive.is_driven.astype(seen.dtype)])
            for drive, seen in zip(drives, innovations, strict=True)
        ]
        # By the node's level: the samples on the way to it, then the new ones, cut at the horizon.
        nothing = [jnp.zeros((size, 4), paths.dtype)] * horizon
        by_level = [
            jnp.concatenate([node.samples[: level * size], *new, *nothing])[: horizon * size]
            for level in range(horizon)
        ]
        all_samples = FieldNode(pose, node.level, _choose(node.level, by_level))
        is_taken = all_samples.is_taken
        ahead = look_ahead(
            root, all_samples.points, is_taken, all_samples.innovations, horizon, objective.needs_gradient
        )
        worth = jnp.where(is_taken, objective(ahead.mean, ahead.variance, ahead.gradient), 0.0)
        by_stage = jnp.pad(jnp.sum(worth.reshape(horizon, size), axis=-1), (0, num_paths))
        paid = _choose(node.level, [by_stage[level : level + num_paths] for level in range(horizon)])
        rewards = paid + jnp.stack([self._cost(drive) for drive in drives])

        # The child remembers the way to the node and the first path.
        stage = jnp.arange(room, dtype=jnp.int32) // size
        samples = jnp.where((stage <= node.level)[:, None], all_samples.samples[:room], 0.0)
        child = FieldNode(self._end(drives[0]), node.level + 1, samples)
        return Simulation(child, rewards, jnp.zeros((num_paths,), bool))

    def pose(self, world: FieldWorld) -> Pose:
        """See `Problem`."""
        return self.vehicle.pose(world.body)

    @property
    def lanes_on_cpu(self) -> int:
        """See `Problem`: factors of a couple of hundred samples fill the cache (8 to 16 lanes are best)."""
        return 16

    @property
    def turning_radius(self) -> float:
        """See `Problem`."""
        return self.vehicle.turning_radius

    @property
    def reach(self) -> float:
        """See `Problem`."""
        return self.vehicle.reach

    def score(self, world: FieldWorld, belief: FieldBelief) -> dict[str, Scalar]:
        """Errors of the final belief on a grid over the domain; cells in a wall do not count."""
        grid = self.grid()
        truth = self.field.values(grid)
        mean, variance = self._predict(belief, grid)
        is_open = is_free(grid, self.domain, self.walls).astype(truth.dtype)
        number = jnp.sum(is_open)
        squared = is_open * (mean - truth) ** 2
        variance = jnp.maximum(variance, jnp.finfo(variance.dtype).eps)
        nll = 0.5 * jnp.log(2.0 * jnp.pi * variance) + (mean - truth) ** 2 / (2.0 * variance)
        taken = jnp.maximum(belief.posterior.count, 1).astype(truth.dtype)
        return {
            "rmse": jnp.sqrt(jnp.sum(squared) / number),
            "wrmse": jnp.sqrt(jnp.sum(squared * self.weights(grid)) / number),
            "mnll": jnp.sum(is_open * nll) / number,
            "collisions": world.collisions,
            "sampled_gradient": world.gradient / taken,
        }

    def weights(self, points: Float[Array, "N 2"]) -> Float[Array, "N"]:
        """Weights of `wrmse`, between 0 and sqrt(2), from the true field at the points of a grid.

        - `"gradient"`: as (3.7) prints it, the norm of the gradient's components, each scaled to [0, 1] by
          its smallest and largest value over the grid, signs included; a flat area weighs about 0.7;
        - `"gradient-norm"`: the norm of the gradient, scaled to [0, 1];
        - `"value"`: the value, scaled to [0, 1] (Section 4.7.1: errors in high-valued locations).
        """
        if self.weighting == "value":
            return _unit(self.field.values(points))
        gradients = self.field.gradients(points)
        if self.weighting == "gradient-norm":
            return _unit(jnp.sqrt(jnp.sum(gradients**2, axis=-1)))
        return jnp.sqrt(jnp.sum(jax.vmap(_unit, 1, 1)(gradients) ** 2, axis=-1))

    def grid(self) -> Float[Array, "G 2"]:
        """Points of a regular grid over the domain, by rows of equal y."""
        x, y = self._axes(self.resolution)
        return jnp.stack([g.ravel() for g in jnp.meshgrid(x, y)], axis=-1)

    def snapshot(self, world: FieldWorld, belief: FieldBelief) -> dict[str, dict[str, Array]]:
        """The field and the belief on the grid, the samples, and the belief after every step.

        `means` and `stds`, `[T + 1, R, R]` from the prior on, are on a grid of at most `FILM_RESOLUTION`
        points a side over the same domain, in 32 bits, NaN for steps that were not made. They are what the
        samples of the first steps say under the hyper-parameters of the end.
        """
        del world
        x, y = self._axes(self.resolution)
        grid = self.grid()
        mean, variance = self._predict(belief, grid)
        posterior = belief.posterior
        samples = jnp.concatenate([posterior.x, posterior.y[:, None]], axis=-1)
        shape = (self.resolution, self.resolution)
        means, stds = self._history(belief)
        return {
            "belief": {
                "x": x,
                "y": y,
                "truth": self.field.values(grid).reshape(shape),
                "mean": mean.reshape(shape),
                "std": jnp.sqrt(variance).reshape(shape),
                "samples": jnp.where(posterior.is_held()[:, None], samples, jnp.nan),
                "means": means,
                "stds": stds,
            }
        }

    def _axes(self, resolution: int) -> tuple[Float[Array, "R"], Float[Array, "R"]]:
        low_x, low_y, high_x, high_y = self.domain
        return jnp.linspace(low_x, high_x, resolution), jnp.linspace(low_y, high_y, resolution)

    def _history(self, belief: FieldBelief) -> tuple[Float[Array, "N R R"], Float[Array, "N R R"]]:
        """Means and standard deviations after every step; a row of the grid at a time, as `_predict`."""
        x, y = self._axes(min(self.resolution, FILM_RESOLUTION))
        is_made = jnp.arange(self.max_steps + 1, dtype=belief.step.dtype) <= belief.step

        def row(y: Scalar) -> tuple[Float[Array, "N R"], Float[Array, "N R"]]:
            points = jnp.stack([x, jnp.full_like(x, y)], axis=-1)
            mean, variance = belief.posterior.predict_first(points, belief.counts)
            kept = (jnp.where(is_made[:, None], part, jnp.nan) for part in (mean, jnp.sqrt(variance)))
            mean, std = (part.astype(jnp.float32) for part in kept)
            return mean, std

        means, stds = jax.lax.map(row, y)
        return jnp.swapaxes(means, 0, 1), jnp.swapaxes(stds, 0, 1)

    def _predict(
        self, belief: FieldBelief, grid: Float[Array, "G 2"]
    ) -> tuple[Float[Array, "G"], Float[Array, "G"]]:
        """Posterior moments, a row of the grid at a time: all at once would take N G numbers a run."""
        rows = grid.reshape(self.resolution, self.resolution, 2)
        mean, variance = jax.lax.map(belief.posterior.predict, rows)
        return mean.ravel(), variance.ravel()

    def _random_start(self, key: Key[Array, ""]) -> Pose:
        low_x, low_y, high_x, high_y = self.domain
        low, high = (
            jnp.stack([low_x, low_y, jnp.zeros_like(low_x)]),
            jnp.stack([high_x, high_y, 2.0 * jnp.pi]),
        )
        poses = jax.random.uniform(key, (START_TRIES, 3), low.dtype, low, high)
        return poses[jnp.argmax(is_free(poses[:, :2], self.domain, self.walls))]

    def _drive(self, pose: Pose, path: Path) -> Drive:
        return drive_until_blocked(pose, place(path, pose), self.domain, self.walls)

    def _end(self, driven: Drive) -> Pose:
        end = driven.poses[-1]
        is_turned = (driven.collided | driven.exited) & (self.after_collision == "turn")
        heading = end[2] + jnp.where(is_turned, jnp.pi, 0.0)
        return end.at[2].set(wrap_to_2pi(heading))

    def _cost(self, driven: Drive) -> Scalar:
        return jnp.where(driven.collided, self.collision_reward, 0.0) + jnp.where(
            driven.exited, self.exit_reward, 0.0
        )

    def _is_reached(self, driven: Drive) -> Bool[Array, ""]:
        if self.target_area is None:
            return jnp.zeros((), bool)
        points, low, high = driven.poses[:, :2], self.target_area[None, :2], self.target_area[None, 2:]
        is_there = jnp.all((points >= low) & (points <= high), axis=-1)
        return jnp.any(is_there & driven.is_driven)


def _choose(level: Int[Array, ""], options: list[Array]) -> Array:
    """`options[level]`; the last one past the end: elementwise arithmetic where an index costs a gather."""
    chosen = options[-1]
    for index in range(len(options) - 2, -1, -1):
        chosen = jnp.where(level == index, options[index], chosen)
    return chosen


def _unit(values: Float[Array, "N"]) -> Float[Array, "N"]:
    """Values scaled to [0, 1]; ones where they are all equal."""
    low, high = jnp.min(values), jnp.max(values)
    is_flat = high == low
    return jnp.where(is_flat, 1.0, (values - low) / jnp.where(is_flat, 1.0, high - low))
