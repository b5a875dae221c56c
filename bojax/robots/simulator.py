"""Simulation of one robot by MuJoCo, with a small state between steps."""

import abc
import contextlib
import functools
import hashlib
import importlib.metadata
import itertools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bojax.numerics import disk_cache
from bojax.numerics.disk_cache import KERNELS
from bojax.numerics.lanes import batched_together
from bojax.numerics.pallas import builds_for_another_machine, kernels_run_here
from bojax.numerics.third_party import plain_jax, silenced, standard_jax
from bojax.robots.c_mujoco import CSteps
from bojax.robots.kernel import scalar_kernel
from bojax.robots.kernel.scalar_kernel import ScalarKernel
from bojax.robots.kernel.scalars import NotScalar
from bojax.robots.kernel.small_factors import small_factors
from bojax.robots.models import MjModel, RobotModel, mujoco, serialised
from bojax.robots.newton import Search, constrained, has_clipped_forces, search_at_ends, search_by_points
from bojax.text import one_line

with silenced():
    from mujoco import mjx

_INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}


class ConfiguredModel(NamedTuple):
    """A model and the settings that enter its compiled form: the key of all caches of this module."""

    model: RobotModel  # the robot and its world
    # Maximum number of iterations of the solver; None keeps the value of the model, here and below
    iterations: int | None = None
    ls_iterations: int | None = None  # maximum number of iterations of its line search
    integrator: str | None = None  # integration scheme


class RobotState(eqx.Module):
    """State between steps; MJX's own data are a hundred times as large."""

    qpos: Float[Array, "Q"]  # generalised positions in m and rad; quaternions have four components
    qvel: Float[Array, "V"]  # generalised velocities in m/s and rad/s
    qacc_warmstart: Float[Array, "V"]  # initial accelerations of the constraint solver, in m/s^2 and rad/s^2


class Physics(eqx.Module):
    """Settings of the simulation; None keeps the value of the model.

    Settings: `bojax.robots.settings.MJX`.
    """

    max_speed: Float[Array, ""]
    iterations: int | None = eqx.field(static=True)
    ls_iterations: int | None = eqx.field(static=True)
    integrator: Literal["euler", "rk4", "implicitfast"] | None = eqx.field(static=True)
    impl: Literal["auto", "jax", "pallas", "c"] = eqx.field(static=True)


class Simulator(eqx.Module):
    """A robot simulated by MuJoCo; its state has 32 bits whatever the precision of the surrounding program.

    The model is a constant of the compiled program; only the state is carried per lane. A lane that diverges
    does not affect the others.
    """

    physics: Physics  # settings of the simulation
    model: RobotModel = eqx.field(static=True)  # the robot and its world
    substeps: int = eqx.field(static=True)  # simulation steps per call of `advance`

    def __check_init__(self):
        """Compile the model.

        Raises:
            ValueError: MuJoCo or MJX refuse the model, it cannot be simulated by a kernel of Pallas, or the
                settings ask for one on a CPU, or for no steps.
        """
        if self.substeps < 1:
            raise ValueError(f"substeps: got {self.substeps}; allowed: >= 1")
        if self.impl == "pallas" and not (kernels_run_here() or builds_for_another_machine()):
            needed = "needs an NVIDIA GPU of compute capability 8.0 or more"
            raise ValueError(f'physics.impl: got "pallas", which {needed}; allowed here: "jax", "c"')
        # A kernel is made when a program is traced, which a saved program is not.
        if self.impl != "pallas" or not _can_be_a_kernel(self._configured, self.substeps):
            _ = self._advance

    @property
    def mujoco_model(self) -> MjModel:
        """The compiled model of C MuJoCo, with the same settings."""
        return _compiled(self._configured)

    @property
    def impl(self) -> Literal["jax", "pallas", "c"]:
        """The implementation of the steps.

        `auto` is `c` on a CPU, for models with contacts or closed loops; `jax` is as fast there without
        contacts, and less exact with loops. It is `pallas` on NVIDIA GPUs, for models that can be a kernel.
        Otherwise it is `jax`, or `c` for models that MJX refuses, with a note on standard error.
        """
        if self.physics.impl != "auto":
            return self.physics.impl
        model = self.mujoco_model
        if jax.default_backend() == "cpu" and (_has_contacts(model) or _has_loops(model)):
            return "c"
        if kernels_run_here() and _can_be_a_kernel(self._configured, self.substeps):
            return "pallas"
        return "jax" if _is_for_mjx(self._configured) else "c"

    @property
    def time_step(self) -> float:
        """Duration of a call of `advance`, in seconds."""
        return self.substeps * float(self.mujoco_model.opt.timestep)

    def state(self, qpos: Float[Array, "Q"], qvel: Float[Array, "V"]) -> RobotState:
        """A state with these positions and velocities.

        Raises:
            ValueError: The model has another number of positions or velocities.
        """
        self._check(qpos, "nq", "generalised positions (a free joint has 7, a ball joint 4)")
        self._check(qvel, "nv", "generalised velocities (a free joint has 6, a ball joint 3)")
        qpos, qvel = qpos.astype(jnp.float32), qvel.astype(jnp.float32)
        return RobotState(qpos, qvel, jnp.zeros_like(qvel))

    def advance(self, state: RobotState, control: Float[Array, "U"]) -> RobotState:
        """The state after `substeps` steps under constant controls, which MuJoCo clips to their ranges.

        Raises:
            ValueError: The model has another number of controls.
        """
        self._check(control, "nu", "controls")
        return self._advance(state, control)

    def sites(self, state: RobotState) -> Float[Array, "N 3"]:
        """Positions of the model's sites, in metres."""
        return _locating(self.model)(state)

    def has_diverged(self, state: RobotState) -> Bool[Array, ""]:
        """Whether the state has a non-finite value, or a velocity above `max_speed`."""
        numbers = jnp.concatenate([state.qpos, state.qvel, state.qacc_warmstart])
        fastest = jnp.max(jnp.abs(state.qvel)).astype(self.physics.max_speed.dtype)
        return ~jnp.all(jnp.isfinite(numbers)) | (fastest > self.physics.max_speed)

    def _check(self, given: Float[Array, "N"], size: str, what: str) -> None:
        needed = getattr(self.mujoco_model, size)
        shape = jnp.shape(given)
        if shape[-1:] != (needed,):
            raise ValueError(f"{what}: got the shape {shape}; the model needs ({needed},)")

    @property
    def _advance(self) -> Any:
        return _stepping(self._configured, self.impl, self.substeps)

    @property
    def _configured(self) -> ConfiguredModel:
        physics = self.physics
        return ConfiguredModel(self.model, physics.iterations, physics.ls_iterations, physics.integrator)


class Simulated(eqx.Module):
    """A part of an experiment that contains a simulated robot."""

    physics: eqx.AbstractVar[Physics]  # settings of the simulation

    @property
    @abc.abstractmethod
    def simulator(self) -> Simulator:
        """Simulator of the robot."""

    @property
    def resolved_settings(self) -> dict[str, str]:
        """The implementation of MJX that `physics.impl` stands for."""
        return {"physics.impl": self.simulator.impl}

    @property
    def model_files(self) -> dict[str, str]:
        """The model of a robot of one's own, as a hash, by the name of its file."""
        model = self.simulator.model
        if model.path is None:
            return {}
        content = serialised(model.spec().compile())  # anew: files that the model reads may have changed
        return {Path(model.path).name: hashlib.sha256(content).hexdigest()}

    @property
    def calls_process(self) -> bool:
        """Whether compiled programs call functions of this process."""
        return self.simulator.impl == "c"


@functools.cache
def _stepping(configured: ConfiguredModel, impl: Literal["jax", "pallas", "c"], substeps: int) -> Any:
    """Several simulation steps under constant controls, traced once for all programs that call it."""
    if impl == "jax":
        return _steps_of(configured, substeps, search_at_ends)
    if impl == "pallas":
        return standard_jax(_kernel_steps(configured, substeps))
    return _in_lanes(CSteps(_compiled(configured), substeps))


@functools.cache
def _is_for_mjx(configured: ConfiguredModel) -> bool:
    """Whether MJX can simulate the model; if not, standard error has the reason, once."""
    try:
        _in_mjx(configured)
    except ValueError as error:
        print(f"note: physics.impl: auto is c, since {error}", file=sys.stderr)
        return False
    return True


@functools.cache
def _can_be_a_kernel(configured: ConfiguredModel, substeps: int) -> bool:
    """Whether a kernel can simulate the model; if not, `_kernel_steps` has the reason.

    MJX has to be traced to find out, which takes seconds: the answer is kept on the disk.
    """
    parts = serialised(_compiled(configured)), substeps, scalar_kernel.MOST_SCALARS, _what_decides()
    name = hashlib.sha256(repr(parts).encode()).hexdigest()
    kept = disk_cache.read(name, KERNELS)
    if kept is None:
        try:
            _kernel_steps(configured, substeps)
            kept = b"yes"
        except ValueError:
            kept = b"no"
        disk_cache.write(name, kept, KERNELS)
    return kept == b"yes"


@functools.cache
def _what_decides() -> list[object]:
    """The code that decides whether a model can be a kernel, besides the model."""
    sources = sorted(Path(__file__).parent.rglob("*.py"))
    versions = (importlib.metadata.version(name) for name in ("jax", "mujoco", "mujoco-mjx"))
    return [*versions, *(path.read_bytes() for path in sources)]


@functools.cache
def _kernel_steps(configured: ConfiguredModel, substeps: int) -> ScalarKernel:
    """The steps of MJX as a kernel, from the state and the controls of a lane to the state after the steps.

    In a program of XLA, a step of 256 hoppers by RK4 is 475 kernels of 1.6 us each on an H200. Here all
    substeps are one kernel: they are 5.5 times as fast with 256 lanes, and 3.1 times with 2,048.

    Raises:
        ValueError: The model is too large, or has parts that `ScalarProgram` does not know.
    """
    model = _compiled(configured)
    qpos, qvel, control = (jax.ShapeDtypeStruct((n,), jnp.float32) for n in (model.nq, model.nv, model.nu))
    state = jax.eval_shape(RobotState, qpos, qvel, qvel)
    advance = _steps_of(configured, substeps, search_by_points)
    try:
        return ScalarKernel(advance, state, control, name="mjx_steps")
    except NotScalar as error:
        refused = f"a kernel cannot simulate the model ({error})"
        raise ValueError(f'physics.impl: got "pallas"; {refused}; use "jax"') from error


def _steps_of(configured: ConfiguredModel, substeps: int, search: Search) -> Any:
    """The steps of MJX for a lane."""
    put, data = _in_mjx(configured)
    step = _step_of(_compiled(configured), search)
    # A kernel takes the functions of the library apart itself.
    factors = small_factors if search is search_at_ends else contextlib.nullcontext

    @standard_jax
    @jax.jit
    def advance(state: RobotState, control: jax.Array) -> RobotState:
        def small_step(_: Any, state: RobotState) -> RobotState:
            before = data.replace(
                qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.qacc_warmstart, ctrl=control
            )
            with factors():
                return step(put, before)

        # A single call site of `step`, whatever the number of substeps: each one takes long to compile.
        return jax.lax.fori_loop(0, substeps, small_step, batched_together(state))

    return advance


@functools.cache
def _locating(model: RobotModel) -> Any:
    """Positions of the sites, traced once for all programs that call it."""
    put, data = _put(_skeleton(model))

    @standard_jax
    @jax.jit
    def sites(state: RobotState) -> jax.Array:
        return mjx.kinematics(put, data.replace(qpos=state.qpos)).site_xpos

    return sites


def _in_lanes(steps: Callable[..., tuple[jax.Array, ...]]) -> Any:
    """Steps of C MuJoCo for a single robot; under any number of `vmap`s, all lanes are one call of `steps`.

    Its arguments are positions, velocities, initial accelerations and controls, with an axis of lanes; its
    results are the first three after the steps.
    """

    @jax.custom_batching.custom_vmap
    def advance_lanes(state: RobotState, control: jax.Array) -> RobotState:
        return RobotState(*steps(state.qpos, state.qvel, state.qacc_warmstart, control))

    @advance_lanes.def_vmap
    def advance_more_lanes(
        size: int, is_batched: Any, state: RobotState, control: jax.Array
    ) -> tuple[RobotState, RobotState]:
        # Called for each further `vmap`: its axis is merged into the axis of lanes, and split off afterwards.
        def flat(x: jax.Array, has_axis: bool) -> jax.Array:
            x = x if has_axis else jnp.broadcast_to(x, (size, *x.shape))
            return x.reshape(x.shape[0] * x.shape[1], *x.shape[2:])

        # Traced when `vmap` transforms the caller, outside of the settings of its own trace.
        after = standard_jax(advance_lanes)(*jax.tree.map(flat, (state, control), tuple(is_batched)))
        after = jax.tree.map(lambda x: x.reshape(size, x.shape[0] // size, *x.shape[1:]), after)
        return after, jax.tree.map(lambda _: True, after)

    @standard_jax
    def advance(state: RobotState, control: jax.Array) -> RobotState:
        one_lane = jax.tree.map(lambda x: x[None], (state, control))
        return jax.tree.map(lambda x: x[0], advance_lanes(*one_lane))

    return advance


def _has_contacts(model: MjModel) -> bool:
    """Whether any two geoms of a model may collide."""
    types, affinities = model.geom_contype, model.geom_conaffinity
    may_touch = (types[:, None] & affinities) | (affinities[:, None] & types)
    return model.npair > 0 or bool(np.triu(may_touch, 1).any())


def _has_loops(model: MjModel) -> bool:
    """Whether constraints `connect` or `weld` join bodies of a model.

    MJX leaves out the term of their reference acceleration that grows with the squared velocity.
    """
    joins = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
    return bool(np.isin(model.eq_type, [int(each) for each in joins]).any())


@functools.cache
def _compiled(configured: ConfiguredModel) -> MjModel:
    """The model of C MuJoCo, whose state has nothing but what `RobotState` has."""
    spec = configured.model.spec()
    if configured.iterations is not None:
        spec.option.iterations = configured.iterations
    if configured.ls_iterations is not None:
        spec.option.ls_iterations = configured.ls_iterations
    if configured.integrator is not None:
        spec.option.integrator = _INTEGRATORS[configured.integrator]
    try:
        compiled = spec.compile()
    except ValueError as error:
        path = configured.model.path
        named = "the model" if path is None else f"the model {Path(path).name}"
        raise ValueError(f"MuJoCo refuses {named}: {one_line(error)}") from error
    if compiled.nv == 0:
        raise ValueError("the model has no joints")
    if unknown := _fields_with_nan(compiled):
        raise ValueError(f"the model has NaN: {unknown}")
    if further := _further_state(compiled):
        raise ValueError(f"the state of the model has more than positions and velocities: {further}")
    return compiled


def _skeleton(model: RobotModel) -> MjModel:
    """The bodies, joints and sites of a model, without anything else that MJX may refuse."""
    spec = model.spec()
    # Keyframes and tuples come first: they refer to actuators and sensors.
    lists = "keys", "tuples", "sensors", "actuators", "equalities", "tendons", "pairs", "flexes"
    for part in itertools.chain.from_iterable([*getattr(spec, name)] for name in lists):
        spec.delete(part)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    spec.option = mujoco.MjSpec().option
    return spec.compile()


@functools.cache
def _in_mjx(configured: ConfiguredModel) -> tuple[Any, Any]:
    """The model and the data of MJX in JAX; created once, outside of any trace."""
    compiled = _compiled(configured)
    if ignored := _ignored(compiled):
        raise ValueError(f"MJX cannot simulate the model: {ignored}")
    return _put(compiled)


def _put(compiled: MjModel) -> tuple[Any, Any]:
    """A model and its data in MJX."""
    try:
        with silenced(), plain_jax(), jax.ensure_compile_time_eval():
            return mjx.put_model(compiled, impl="jax"), mjx.make_data(compiled, impl="jax")
    except (ValueError, NotImplementedError) as error:
        raise ValueError(f"MJX refuses the model: {one_line(error)}") from error


def _step_of(compiled: MjModel, search: Search) -> Callable[[Any, Any], RobotState]:
    """The step of a model, as `mjx.step` computes it, with one of the line searches of `newton`."""
    forward = functools.partial(_forward, search) if has_clipped_forces(compiled) else mjx.forward
    integrator = int(compiled.opt.integrator)
    if integrator == int(mujoco.mjtIntegrator.mjINT_RK4):
        # The velocities of these joints are the derivatives of their positions.
        simple = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
        is_simple = bool(np.isin(compiled.jnt_type, simple).all())
        return functools.partial(_runge_kutta_step, forward) if is_simple else _step(mjx.step)
    is_euler = integrator == int(mujoco.mjtIntegrator.mjINT_EULER)
    integrate = mjx.euler if is_euler else mjx.implicit
    return _step(lambda model, data: integrate(model, forward(model, data)))


def _step(step: Callable[[Any, Any], Any]) -> Callable[[Any, Any], RobotState]:
    """A step of MJX, which returns a small state."""

    def small(model: Any, before: Any) -> RobotState:
        after = step(model, before)
        return RobotState(after.qpos, after.qvel, after.qacc_warmstart)

    return small


def _forward(search: Search, model: Any, data: Any) -> Any:
    """`mjx.forward` without sensors, and with constraint forces by `constrained`."""
    for part in (mjx.fwd_position, mjx.fwd_velocity, mjx.fwd_actuation, mjx.fwd_acceleration):
        data = part(model, data)
    return constrained(model, data, mjx.full_m(model, data), search)


_STAGES = np.asarray([[0.0, 1.0 / 6.0], [0.5, 1.0 / 3.0], [0.5, 1.0 / 3.0], [1.0, 1.0 / 6.0]], np.float32)
"""The Runge-Kutta method of fourth order: step and weight of every stage."""


def _runge_kutta_step(forward: Callable[[Any, Any], Any], model: Any, before: Any) -> RobotState:
    """The step of `mjx.step` by RK4, with a single call site of the dynamics; MJX has one for each stage."""
    h = model.opt.timestep

    # Each stage starts at `before` and needs the slopes of the previous stage alone, here (velocity,
    # acceleration); `sums` are the weighted slopes. The first stage has a step of 0, so that its slopes, 0
    # at the start, do not matter.
    def stage(carry: Any, numbers: jax.Array) -> tuple[Any, None]:
        (velocity, acceleration), sums = carry
        size, weight = numbers
        now = before.replace(
            qpos=before.qpos + h * (size * velocity), qvel=before.qvel + size * acceleration * h
        )
        slopes = now.qvel, forward(model, now).qacc
        sums = tuple(total + weight * slope for total, slope in zip(sums, slopes, strict=True))
        return (slopes, sums), None

    # The zeros are batched with the state from the start: otherwise `vmap` finds only after batching a stage
    # that they become so, and batches the stage again.
    zero = jnp.zeros_like(before.qvel)
    start, _ = batched_together((((zero, zero), (zero, zero)), before.qvel))
    # The warm start of the next step is the acceleration of the last stage.
    (_, acceleration), (velocity, change) = jax.lax.scan(stage, start, jnp.asarray(_STAGES))[0]
    return RobotState(before.qpos + h * velocity, before.qvel + h * change, acceleration)


def _fields_with_nan(model: MjModel) -> str:
    """Fields of a model that hold a NaN, separated by commas; "" if none. MuJoCo only warns of them."""
    parts = ("", model), ("opt.", model.opt)
    fields = ((prefix + name, getattr(part, name)) for prefix, part in parts for name in dir(part))
    numbers = ((name, x) for name, x in fields if isinstance(x, float | np.ndarray))
    return ", ".join(name for name, x in numbers if np.asarray(x).dtype.kind == "f" and np.isnan(x).any())


def _further_state(model: MjModel) -> str:
    """Features whose state between steps `RobotState` does not have, separated by commas; "" if none."""
    found = {
        "plugins with a state": model.npluginstate > 0,
        "actuators with an activation of their own (filters, integrators, muscles)": model.na > 0,
        "delayed actuators": bool((model.actuator_delay > 0).any()),
        "bodies that are asleep at the start": _may_sleep(model)
        and bool((model.tree_sleep_policy == mujoco.mjtSleepPolicy.mjSLEEP_INIT).any()),
    }
    return ", ".join(what for what, is_there in found.items() if is_there)


def _ignored(model: MjModel) -> str:
    """Features of a model that MJX ignores silently, separated by commas; "" if none."""
    option = model.opt
    switched_off = mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER
    polynomials = (
        model.jnt_stiffnesspoly,
        model.dof_dampingpoly,
        model.tendon_stiffnesspoly,
        model.tendon_dampingpoly,
    )
    of_actuators = model.actuator_damping, model.actuator_dampingpoly, model.actuator_armature
    found = {
        "plugins": model.nplugin > 0,
        "noslip iterations": option.noslip_iterations > 0,
        "sleeping bodies": _may_sleep(model),
        "the integrator discrete": option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE,
        # MJX then leaves out all passive forces.
        "springs or dampers that are switched off by a flag": bool(option.disableflags & switched_off)
        and _has_passive_forces(model),
        "springs or dampers that are not linear": any(x.any() for x in polynomials),
        "damping or armature of actuators": any(x.any() for x in of_actuators),
        "groups of actuators that are switched off": _has_disabled_actuators(model),
        "ellipsoids in a fluid": bool(model.geom_fluid[:, 0].any())
        and bool(option.density > 0 or option.viscosity > 0),
        "adhesion of geoms": bool(model.geom_adhesion.any() or model.pair_adhesion.any()),
        "surfaces that move": bool(model.geom_surfacevel.any()),
    }
    return ", ".join(what for what, is_there in found.items() if is_there)


def _has_passive_forces(model: MjModel) -> bool:
    of_joints = model.jnt_stiffness, model.dof_damping
    of_tendons = model.tendon_stiffness, model.tendon_damping
    is_in_fluid = model.opt.density > 0 or model.opt.viscosity > 0
    return bool(is_in_fluid) or any(x.any() for x in (*of_joints, *of_tendons, model.body_gravcomp))


def _has_disabled_actuators(model: MjModel) -> bool:
    disabled = int(model.opt.disableactuator)
    return any(0 <= group < 31 and disabled >> group & 1 for group in model.actuator_group.tolist())


def _may_sleep(model: MjModel) -> bool:
    return bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP)
