"""Reaching a point with a damaged Jaco arm (thesis, Section 5.7.3)."""

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key
from typing_extensions import override

from bojax.envs.control import ControlStep
from bojax.envs.robots.base import RobotTask
from bojax.envs.spaces import Box
from bojax.robots.models import RobotModel, jaco_model, mujoco
from bojax.robots.simulator import Physics, RobotState

_NOISE = 0.1
_CANDIDATES = 8
_FASTEST = 5.0
_REACH = (-1.0, -1.0, -0.7), (1.0, 1.0, 1.3)


class JacoState(eqx.Module):
    """State of the arm and position of the target."""

    robot: RobotState  # state of the arm
    target: Float[Array, "3"]  # target position of the fingertips relative to the base of the arm, in metres


class Jaco(RobotTask):
    """A Jaco arm with six joints, some of them immobilised; actions are the torques of the others.

    The goal is a distance between the mean fingertip position and the target below `goal_distance`, at any
    speed. There is no failure. An episode starts at rest in the upright configuration, with every movable
    joint rotated by a uniform angle in [-0.1, 0.1] rad. A target is the fingertip position for uniform joint
    angles within their limits, so that it can be reached. It is the first of eight such positions that is
    farther than twice `goal_distance` from the upright fingertip position, or the first one if none is.
    Joints that move the fingertips this far in less than half of their configurations are refused, so that at
    most one target in 256 is nearer.

    The thesis specifies neither which two joints move nor the distance of the goal, and states that the arm
    learns "solely from observing joint configuration" although targets are random. Joints 1 and 2 are the
    default because they sweep the largest volume: 1259 cells of 10 cm, against 511 and 301 for the next
    pairs, 1 and 3, and 2 and 3. By default a target is drawn once per run and not observed; with `targets`
    `"per-episode"` it is drawn at every reset and observed. With actions of 40 ms, a PD controller that knows
    the joint angles of the target comes within 0.1 m of 99% of the targets in 50 steps, and uniformly random
    actions of 4%; with actions of 20 ms, of 22% and 1%.

    Gym has no such environment; the classic reward is minus the distance in metres, and the goal terminates
    the episode.

    Settings: `bojax.envs.robots.settings.Jaco`.
    """

    goal_distance: Float[Array, ""]
    physics: Physics
    joints: tuple[int, ...] = eqx.field(static=True)
    targets: Literal["per-run", "per-episode"] = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    # Target of all episodes, see `of_run`; None for a new target in each episode
    target: Float[Array, "3"] | None = None

    @override
    def __check_init__(self):
        """Compare `goal_distance` with the reach of the joints in 1000 random configurations.

        Raises:
            ValueError: Less than half of the configurations are far enough, see the class.
        """
        if self.target is not None:  # no target is drawn
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
                f"joints, goal_distance: joints {', '.join(map(str, self.joints))} move the fingertips "
                f"farther than twice goal_distance, {far:g} m, in {share:.0%} of their configurations, less "
                f"than half; set other joints or a smaller goal_distance"
            )

    @property
    @override
    def model(self) -> RobotModel:
        return jaco_model(self.joints)

    @property
    @override
    def observation_space(self) -> Box:
        """Cosines and sines of the joint angles, joint velocities in rad/s, and the target if observed."""
        one = jnp.ones((2 * len(self.joints),), self.dtype)
        speed = jnp.full((len(self.joints),), _FASTEST, self.dtype)
        low, high = jnp.concatenate([-one, -speed]), jnp.concatenate([one, speed])
        if self.targets == "per-episode":
            least, most = jnp.asarray(_REACH, self.dtype)
            low, high = jnp.concatenate([low, least]), jnp.concatenate([high, most])
        return Box(low, high)

    @override
    def of_run(self, key: Key[Array, ""]) -> "Jaco":
        """The environment with the target of the run, if targets are drawn per run."""
        if self.targets == "per-episode" or self.target is not None:
            return self
        return dataclasses.replace(self, target=self.draw_target(key))

    @override
    def reset(self, key: Key[Array, ""]) -> JacoState:
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
        """Mean fingertip position for joint angles, in metres."""
        return self.simulator.sites(self.simulator.state(angles, jnp.zeros_like(angles)))[0]

    @override
    def observe(self, state: JacoState) -> Float[Array, "D"]:
        angles = state.robot.qpos
        parts = [jnp.cos(angles), jnp.sin(angles), state.robot.qvel]
        seen = jnp.concatenate(parts).astype(self.dtype)
        return jnp.concatenate([seen, state.target]) if self.targets == "per-episode" else seen

    @override
    def robot(self, state: JacoState) -> RobotState:
        return state.robot

    @override
    def moved(self, state: JacoState, robot: RobotState) -> JacoState:
        return JacoState(robot, state.target)

    @property
    @override
    def frame_size(self) -> int:
        return self.simulator.mujoco_model.nq + 3

    @override
    def mocap_positions(self, state: JacoState) -> Float[Array, "3"]:
        # Animations draw the target at the position of the mocap body.
        return state.target

    @override
    def is_goal(self, state: JacoState) -> Bool[Array, ""]:
        return self.distance(state) < self.goal_distance

    def distance(self, state: JacoState) -> Float[Array, ""]:
        """Distance between fingertips and target, in metres."""
        gap = self.finger_tips(state.robot.qpos).astype(self.dtype) - state.target
        return jnp.sqrt(jnp.sum(gap * gap))

    @override
    def classic(self, step: ControlStep) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        return -self.distance(step.after), step.success

    @property
    def _rest(self) -> Float[Array, "J"]:
        return jnp.asarray(self.simulator.mujoco_model.qpos0, jnp.float32)

    @property
    def _limits(self) -> Float[Array, "2 J"]:
        """Lower and upper joint limits; a full turn for joints without limits."""
        model = self.simulator.mujoco_model
        ends = [
            ends if is_limited else (-jnp.pi, jnp.pi)
            for ends, is_limited in zip(model.jnt_range.tolist(), model.jnt_limited.tolist(), strict=True)
        ]
        return jnp.asarray(ends, jnp.float32).T
