"""A damaged Jaco arm that has to bring its finger tips to a point (thesis, Section 5.7.3)."""

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from bojax.envs.robots.base import RobotTask
from bojax.envs.spaces import Box
from bojax.robots.jaco import jaco_model
from bojax.robots.models import RobotModel, mujoco
from bojax.robots.simulator import Physics, RobotState

_NOISE = 0.1
_CANDIDATES = 8
_FASTEST = 5.0
_REACH = (-1.0, -1.0, -0.7), (1.0, 1.0, 1.3)


class JacoState(eqx.Module):
    """The arm and where it has to go.

    Attributes:
        robot: The arm.
        target: Where the finger tips are to be brought, in metres, from the foot of the arm.
    """

    robot: RobotState
    target: Float[Array, "3"]


class Jaco(RobotTask):
    """A Jaco of six joints of which some are immobilised; actions are the torques of the others.

    The goal is the middle of the finger tips within `goal_distance` of the target, at any speed; nothing is a
    failure. It begins at rest with the arm pointing straight up, every joint that moves turned by a uniform
    angle in [-0.1, 0.1] rad. A target is where the finger tips are with these joints anywhere within their
    limits (uniform), so that it can be reached; the first of eight such that is more than twice
    `goal_distance` away from where they are at rest, or the first of all if none is. Joints that bring the
    finger tips that far in less than half of their angles are refused: one target in 256 at most is nearer.

    The thesis says neither which two joints move nor how near is near, and that the arm is learned "solely
    from observing joint configuration" while targets are random. Joints 1 and 2 are the default because they
    sweep the most: 1259 cells of 10 cm; the next best pairs, 1 and 3 and 2 and 3, sweep 511 and 301. A target
    is drawn once for each run and not observed; with `targets` `"per-episode"`, at every reset, and is
    observed. With 40 ms an action a PD controller that knows the angles of the target gets within 0.1 m of
    99% of them in 50 steps, and uniformly random actions of 4% (of 22% and 1% with 20 ms).

    There is no classic reward of Gym; ours is minus the distance in metres, and ends at the goal.

    Attributes:
        goal_distance: Distance of finger tips and target that has to be undercut, in metres.
        physics: See `RobotTask`.
        joints: The joints that move, from 1 at the base to 6 at the hand.
        targets: How often there is a new target.
        substeps: See `RobotTask`; a step of the physics is 4 ms.
        max_steps: See `Env`.
        reward: See `ControlTask`.
        target: Target of all episodes, see `of_run`; None for a new target in each episode.
    """

    goal_distance: Float[Array, ""]
    physics: Physics
    joints: tuple[int, ...] = eqx.field(static=True)
    targets: Literal["per-run", "per-episode"] = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    reward: Literal["goal-only", "classic"] = eqx.field(static=True)
    target: Float[Array, "3"] | None = None

    def __check_init__(self):
        """Compare `goal_distance` with how far the joints bring the finger tips, at 1000 random angles.

        Raises:
            ValueError: Less than half of them are far enough, see the class.
        """
        if self.target is not None:  # nothing is drawn
            return
        model = self.simulator.mujoco_model
        low, high = np.asarray(self._limits, np.float64)
        angles = np.random.default_rng(0).uniform(low, high, (1000, model.nq))
        data, tips = mujoco.MjData(model), []
        for row in (model.qpos0, *angles):
            data.qpos = row
            mujoco.mj_kinematics(model, data)
            tips.append(data.site_xpos[0].copy())
        far = 2.0 * float(self.goal_distance)
        share = np.mean(np.linalg.norm(np.asarray(tips[1:]) - tips[0], axis=-1) > far)
        if share < 0.5:
            raise ValueError(
                f"joints, goal_distance: the joints {', '.join(map(str, self.joints))} bring the finger tips "
                f"farther than twice goal_distance, {far:g} m, in {share:.0%} of their angles, not in half: "
                f"other joints, or a smaller distance"
            )

    @property
    def model(self) -> RobotModel:
        """See `RobotTask`."""
        return jaco_model(self.joints)

    @property
    def observation_space(self) -> Box:
        """Cosines and sines of the joints, their velocities in rad/s, and the target where it is observed."""
        one = jnp.ones((2 * len(self.joints),), self.dtype)
        speed = jnp.full((len(self.joints),), _FASTEST, self.dtype)
        low, high = jnp.concatenate([-one, -speed]), jnp.concatenate([one, speed])
        if self.targets == "per-episode":
            least, most = jnp.asarray(_REACH, self.dtype)
            low, high = jnp.concatenate([low, least]), jnp.concatenate([high, most])
        return Box(low, high)

    def of_run(self, key: Key[Array, ""]) -> "Jaco":
        """See `Env`: with its target, where there is one for all episodes."""
        return dataclasses.replace(self, target=self.draw_target(key)) if self.targets == "per-run" else self

    def reset(self, key: Key[Array, ""]) -> JacoState:
        """See `Env`."""
        keys = jax.random.split(key)
        offsets = jax.random.uniform(keys[0], self._rest.shape, jnp.float32, -_NOISE, _NOISE)
        robot = self.simulator.state(self._rest + offsets, jnp.zeros_like(offsets))
        return JacoState(robot, self.draw_target(keys[1]) if self.target is None else self.target)

    def draw_target(self, key: Key[Array, ""]) -> Float[Array, "3"]:
        """A random target, see the class."""
        low, high = self._limits
        angles = jax.random.uniform(key, (_CANDIDATES, len(self.joints)), jnp.float32)
        angles = low[None] + angles * (high - low)[None]
        tips = jax.vmap(self.finger_tips)(jnp.concatenate([self._rest[None], angles]))
        away = tips[1:] - tips[:1]
        is_far = jnp.sqrt(jnp.sum(away * away, axis=1)).astype(self.dtype) > 2.0 * self.goal_distance
        return tips[1:][jnp.argmax(is_far)].astype(self.dtype)

    def finger_tips(self, angles: Float[Array, "J"]) -> Float[Array, "3"]:
        """The middle of the finger tips with the joints at these angles, in metres."""
        return self.simulator.sites(self.simulator.state(angles, jnp.zeros_like(angles)))[0]

    def observe(self, state: JacoState) -> Float[Array, "D"]:
        """See `observation_space`."""
        angles = state.robot.qpos
        parts = [jnp.cos(angles), jnp.sin(angles), state.robot.qvel]
        seen = jnp.concatenate(parts).astype(self.dtype)
        return jnp.concatenate([seen, state.target]) if self.targets == "per-episode" else seen

    def advance(self, key: Key[Array, ""], state: JacoState, action: Float[Array, "J"]) -> JacoState:
        """See `ControlTask`."""
        return JacoState(super().advance(key, state.robot, action), state.target)

    def has_diverged(self, state: JacoState) -> Bool[Array, ""]:
        """See `ControlTask`."""
        return super().has_diverged(state.robot)

    def frame(self, state: JacoState) -> Float[Array, "Q"]:
        """See `Env`: the angles, and where the model's target has to be drawn."""
        return jnp.concatenate([state.robot.qpos, state.target.astype(jnp.float32)])

    def is_goal(self, state: JacoState) -> Bool[Array, ""]:
        """See the class."""
        return self.distance(state) < self.goal_distance

    def distance(self, state: JacoState) -> Float[Array, ""]:
        """From the finger tips to the target, in metres."""
        gap = self.finger_tips(state.robot.qpos).astype(self.dtype) - state.target
        return jnp.sqrt(jnp.sum(gap * gap))

    def classic(
        self,
        state: JacoState,
        action: Float[Array, "J"],
        success: Bool[Array, ""],
        failure: Bool[Array, ""],
        after: JacoState,
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """See the class."""
        del state, action, failure
        return -self.distance(after), success

    @property
    def _rest(self) -> Float[Array, "J"]:
        return jnp.asarray(self.simulator.mujoco_model.qpos0, jnp.float32)

    @property
    def _limits(self) -> Float[Array, "2 J"]:
        """Least and largest angles; a full turn where there are none."""
        model = self.simulator.mujoco_model
        ends = [
            ends if is_limited else (-jnp.pi, jnp.pi)
            for ends, is_limited in zip(model.jnt_range.tolist(), model.jnt_limited.tolist(), strict=True)
        ]
        return jnp.asarray(ends, jnp.float32).T
