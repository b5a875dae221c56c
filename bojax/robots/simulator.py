"""Simulation of one robot by MJX, with a small state between steps."""

import functools
import importlib.util
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bojax.config.extras import MissingExtra
from bojax.numerics.third_party import plain_jax, silenced, standard_jax
from bojax.robots.models import MjModel, RobotModel, mujoco
from bojax.text import one_line

try:
    with silenced():
        from mujoco import mjx
except ImportError as error:
    raise MissingExtra("mujoco-mjx", "robots") from error

_INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}


class RobotState(eqx.Module):
    """State between steps; MJX's own data are a hundred times as large.

    Attributes:
        qpos: Generalised positions in m and rad; quaternions have four components.
        qvel: Generalised velocities in m/s and rad/s.
        qacc_warmstart: Initial accelerations of the constraint solver, in m/s^2 and rad/s^2.
    """

    qpos: Float[Array, "Q"]
    qvel: Float[Array, "V"]
    qacc_warmstart: Float[Array, "V"]


class Physics(eqx.Module):
    """Settings of the simulation; None keeps the value of the model.

    Settings: `bojax.robots.settings.MJX`.
    """

    max_speed: Float[Array, ""]
    iterations: int | None = eqx.field(static=True)
    ls_iterations: int | None = eqx.field(static=True)
    integrator: Literal["euler", "rk4", "implicitfast"] | None = eqx.field(static=True)
    impl: Literal["jax", "warp"] = eqx.field(static=True)


class Simulator(eqx.Module):
    """A robot simulated by MJX, in 32 bits whatever the precision of the surrounding program.

    The model is a constant of the compiled program; only the state is carried per lane. A lane that diverges
    does not affect the others.

    Attributes:
        physics: Settings of the simulation.
        model: The robot and its world.
        substeps: Simulation steps per call of `advance`.
    """

    physics: Physics
    model: RobotModel = eqx.field(static=True)
    substeps: int = eqx.field(static=True)

    def __check_init__(self):
        """Compile the model.

        Raises:
            ValueError: MuJoCo or MJX refuse the model.
        """
        _ = self._compiled

    @property
    def mujoco_model(self) -> MjModel:
        """The compiled model of C MuJoCo, with the same settings."""
        return self._compiled[0]

    @property
    def time_step(self) -> float:
        """Duration of a call of `advance`, in seconds."""
        return self.substeps * float(self.mujoco_model.opt.timestep)

    def state(self, qpos: Float[Array, "Q"], qvel: Float[Array, "V"]) -> RobotState:
        """A state with these positions and velocities."""
        qpos, qvel = qpos.astype(jnp.float32), qvel.astype(jnp.float32)
        return RobotState(qpos, qvel, jnp.zeros_like(qvel))

    def advance(self, state: RobotState, control: Float[Array, "U"]) -> RobotState:
        """The state after `substeps` steps under constant controls, which MuJoCo clips to their ranges."""
        return self._advance(state, control)

    def sites(self, state: RobotState) -> Float[Array, "N 3"]:
        """Positions of the model's sites, in metres."""
        return self._sites(state)

    def has_diverged(self, state: RobotState) -> Bool[Array, ""]:
        """Whether the state has a non-finite value, or a velocity above `max_speed`."""
        numbers = jnp.concatenate([state.qpos, state.qvel, state.qacc_warmstart])
        fastest = jnp.max(jnp.abs(state.qvel)).astype(self.physics.max_speed.dtype)
        return ~jnp.all(jnp.isfinite(numbers)) | (fastest > self.physics.max_speed)

    @property
    def _advance(self) -> Any:
        return _stepping(*self._key, self.substeps)

    @property
    def _sites(self) -> Any:
        model, data = self._compiled[1:]

        @standard_jax
        def sites(state: RobotState) -> jax.Array:
            return mjx.kinematics(model, data.replace(qpos=state.qpos)).site_xpos

        return sites

    @property
    def _compiled(self) -> tuple[MjModel, Any, Any]:
        return _compiled(*self._key)

    @property
    def _key(self) -> tuple[RobotModel, int | None, int | None, str | None, str]:
        physics = self.physics
        return self.model, physics.iterations, physics.ls_iterations, physics.integrator, physics.impl


@functools.cache
def _stepping(
    model: RobotModel,
    iterations: int | None,
    ls_iterations: int | None,
    integrator: str | None,
    impl: str,
    substeps: int,
) -> Any:
    """Several simulation steps under constant controls, traced once for all programs that call it."""
    compiled, put, data = _compiled(model, iterations, ls_iterations, integrator, impl)
    step = _runge_kutta_step if _has_one_stage_site(compiled, impl) else _step

    @standard_jax
    @jax.jit
    def advance(state: RobotState, control: jax.Array) -> RobotState:
        def small_step(_: Any, state: RobotState) -> RobotState:
            before = data.replace(
                qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.qacc_warmstart, ctrl=control
            )
            return step(put, before)

        # A single call site of `step`, whatever the number of substeps: each one takes long to compile.
        return jax.lax.fori_loop(0, substeps, small_step, state)

    return advance


@functools.cache
def _compiled(
    model: RobotModel, iterations: int | None, ls_iterations: int | None, integrator: str | None, impl: str
) -> tuple[MjModel, Any, Any]:
    """The model of C MuJoCo and of MJX, and MJX's data; created once, outside of any trace."""
    spec = model.spec()
    if iterations is not None:
        spec.option.iterations = iterations
    if ls_iterations is not None:
        spec.option.ls_iterations = ls_iterations
    if integrator is not None:
        spec.option.integrator = _INTEGRATORS[integrator]
    try:
        compiled = spec.compile()
    except ValueError as error:
        raise ValueError(f"MuJoCo refuses the model: {one_line(error)}") from error
    if unsupported := _unsupported(compiled):
        raise ValueError(f"MJX cannot simulate the model: {unsupported}")
    if impl == "warp" and importlib.util.find_spec("warp") is None:
        raise ValueError('impl: got "warp", which is not installed: pip install mujoco-mjx[warp]')
    try:
        with silenced(), plain_jax(), jax.ensure_compile_time_eval():
            put = mjx.put_model(compiled, impl=impl)
            return compiled, put, mjx.make_data(compiled, impl=impl)
    except (ValueError, NotImplementedError) as error:
        raise ValueError(f"MJX refuses the model: {one_line(error)}") from error


def _step(model: Any, before: Any) -> RobotState:
    after = mjx.step(model, before)
    return RobotState(after.qpos, after.qvel, after.qacc_warmstart)


def _has_one_stage_site(model: MjModel, impl: str) -> bool:
    """Whether `_runge_kutta_step` applies: RK4 of a model whose velocities are derivatives of positions."""
    simple = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    is_rk4 = model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4)
    return is_rk4 and impl == "jax" and bool(np.isin(model.jnt_type, simple).all())


_STAGES = np.asarray([[0.0, 1.0 / 6.0], [0.5, 1.0 / 3.0], [0.5, 1.0 / 3.0], [1.0, 1.0 / 6.0]], np.float32)
"""The Runge-Kutta method of fourth order: step and weight of every stage."""


def _runge_kutta_step(model: Any, before: Any) -> RobotState:
    """The step of `mjx.step` by RK4, with a single call site of the dynamics; MJX has one for each stage."""
    h = model.opt.timestep

    def stage(carry: Any, numbers: jax.Array) -> tuple[Any, None]:
        (velocity, acceleration), sums = carry
        size, weight = numbers
        now = before.replace(
            qpos=before.qpos + h * (size * velocity), qvel=before.qvel + size * acceleration * h
        )
        slopes = now.qvel, mjx.forward(model, now).qacc
        sums = tuple(total + weight * slope for total, slope in zip(sums, slopes, strict=True))
        return (slopes, sums), None

    zero = jnp.zeros_like(before.qvel)
    start = (zero, zero), (zero, zero)
    (_, acceleration), (velocity, change) = jax.lax.scan(stage, start, jnp.asarray(_STAGES))[0]
    return RobotState(before.qpos + h * velocity, before.qvel + h * change, acceleration)


def _unsupported(model: MjModel) -> str:
    """Features of a model that MJX would silently ignore, as text; empty if there are none."""
    found = {
        "plugins": model.nplugin > 0,
        "actuators with an activation of their own (filters, integrators, muscles)": model.na > 0,
        "delayed actuators": bool((model.actuator_delay > 0).any()),
        "noslip iterations": model.opt.noslip_iterations > 0,
    }
    return ", ".join(what for what, is_there in found.items() if is_there)
