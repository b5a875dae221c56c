"""Steps of MuJoCo Warp, the implementation of MJX for NVIDIA GPUs, as a call within JAX programs.

`mjx.step` with `impl="warp"` passes all of MJX's data through XLA in every step. Here they stay with Warp: a
call reads the state and the controls of all lanes, and writes the state after several steps.
"""

import functools
import importlib
import threading
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from bojax.config.extras import MissingExtra
from bojax.numerics.third_party import silenced
from bojax.robots.lane_steps import LaneSteps
from bojax.robots.models import MjModel, mujoco
from bojax.text import one_line

_PLANE, _HFIELD, _SPHERE, _CAPSULE, _ELLIPSOID, _BOX, _SDF = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("PLANE", "HFIELD", "SPHERE", "CAPSULE", "ELLIPSOID", "BOX", "SDF")
)
_BUILDING = threading.Lock()

_LOST = "NEFC", "NJMAX_NNZ", "BROADPHASE", "NARROWPHASE", "CCD", "HFIELD"
"""Flags of MuJoCo Warp for contacts or constraints that it has left out because a buffer is full."""


@functools.cache
def load() -> tuple[Any, Any]:
    """Warp, and the version of MuJoCo Warp that comes with MJX.

    Raises:
        MissingExtra: Warp is not installed.
    """
    try:
        with silenced():
            warp = importlib.import_module("warp")
            warp.config.log_level = warp.LOG_WARNING
            return warp, importlib.import_module("mujoco.mjx.third_party.mujoco_warp")
    except ImportError as error:
        raise MissingExtra("warp-lang", "robots-cuda") from error


class WarpSteps(LaneSteps):
    """Steps as a custom call of the compiled program; positions are NaN if any constraint was left out.

    The buffers of MuJoCo Warp hold all contacts and constraints that the model can have at once in every
    lane. They are allocated once for each device and number of lanes. All calls share them, one after the
    other. On a GPU a step is a CUDA graph.

    Attributes:
        num_pairs: Pairs of geoms in a lane that may collide.
        num_contacts: Largest number of contacts in a lane.
        num_rows: Largest number of constraint rows in a lane.
    """

    def __init__(self, model: MjModel, substeps: int):
        """Check that MuJoCo Warp supports the model.

        Raises:
            MissingExtra: Warp is not installed.
            ValueError: MuJoCo Warp does not support the model.
        """
        self._wp, self._mjw = load()
        if model.nflex:
            raise ValueError("MuJoCo Warp refuses the model: flexible bodies are not supported")
        try:
            with silenced(), self._wp.ScopedDevice("cpu"):
                pairs = self._mjw.put_model(model)
        except (ValueError, NotImplementedError) as error:
            raise ValueError(f"MuJoCo Warp refuses the model: {one_line(error)}") from error
        self.model, self.substeps = model, substeps
        geoms = np.asarray(pairs.nxn_geom_pair_filtered.numpy()).reshape(-1, 2)
        numbers = np.asarray(pairs.nxn_pairid_filtered.numpy()).reshape(-1, 2)[:, 0]
        contacts = [_max_contacts(*model.geom_type[pair]) for pair in geoms]
        self.num_pairs, self.num_contacts = len(geoms), sum(contacts)
        self.num_rows = _other_rows(model) + sum(
            number * _rows_per_contact(model, pair, pair_number)
            for number, pair, pair_number in zip(contacts, geoms, numbers, strict=True)
        )
        self._buffers: dict[tuple[str, int], _Buffers] = {}
        self._call = self._as_jax_call()

    @override
    def __call__(
        self,
        qpos: Float[Array, "L Q"],
        qvel: Float[Array, "L V"],
        qacc_warmstart: Float[Array, "L V"],
        control: Float[Array, "L U"],
    ) -> tuple[Float[Array, "L Q"], Float[Array, "L V"], Float[Array, "L V"]]:
        lost = sum(int(self._mjw.OverflowType[flag]) for flag in _LOST)
        qpos, qvel, qacc_warmstart, overflow = self._call(
            qpos, qvel, qacc_warmstart, control, output_dims={"overflow": (qpos.shape[0],)}
        )
        is_lost = (overflow & jnp.int32(lost)) != 0
        return jnp.where(is_lost[:, None], jnp.nan, qpos), qvel, qacc_warmstart

    def _as_jax_call(self) -> Any:
        wp = self._wp

        def steps(qpos, qvel, qacc_warmstart, control, overflow):
            with _BUILDING:
                key = qpos.device.alias, qpos.shape[0]
                buffers = self._buffers.get(key)
                if buffers is None:
                    buffers = self._buffers[key] = _Buffers(self, qpos.device, qpos.shape[0])
                buffers.advance(self.substeps, qpos, qvel, qacc_warmstart, control, overflow)

        matrix = wp.array2d(dtype=float)
        steps.__annotations__ = {
            "qpos": matrix,
            "qvel": matrix,
            "qacc_warmstart": matrix,
            "control": matrix,
            "overflow": wp.array(dtype=int),
        }
        return wp.jax_callable(
            steps,
            num_outputs=4,
            in_out_argnames=["qpos", "qvel", "qacc_warmstart"],
            graph_mode=wp.JaxCallableGraphMode.NONE,  # the graph of `_Buffers` has no addresses of XLA
            module_preload_mode=wp.JaxModulePreloadMode.NONE,  # this module has no kernels
        )


class _Buffers:
    """Model and data of MuJoCo Warp on a device for a number of lanes, and the CUDA graph of a step."""

    def __init__(self, steps: WarpSteps, device: Any, lanes: int):
        self._wp, self._mjw = wp, mjw = load()
        with wp.ScopedDevice(device):
            self._model = mjw.put_model(steps.model)
            # Silently: the flags include that the solver has used all of its iterations.
            self._model.opt.warn_overflow = 0
            self._data = mjw.make_data(
                steps.model,
                nworld=lanes,
                naconmax=lanes * steps.num_contacts,
                naccdmax=lanes * steps.num_pairs,
                # Without any row, MuJoCo Warp 3.17.0 integrates the velocity of a free body wrongly.
                njmax=max(1, steps.num_rows),
            )
            self._graph = None
            mjw.step(self._model, self._data)  # builds and loads the kernels
            if device.is_cuda:
                with wp.ScopedCapture() as capture:
                    mjw.step(self._model, self._data)
                self._graph = capture.graph
            wp.synchronize_device(device)

    def advance(
        self, substeps: int, qpos: Any, qvel: Any, qacc_warmstart: Any, control: Any, overflow: Any
    ) -> None:
        """Replace the state in the arrays by the state after a number of steps, on Warp's current stream."""
        wp, data = self._wp, self._data
        pairs = ((data.qpos, qpos), (data.qvel, qvel), (data.qacc_warmstart, qacc_warmstart))
        for own, given in (*pairs, (data.ctrl, control)):
            wp.copy(own, given)
        data.overflow.zero_()
        for _ in range(substeps):
            if self._graph is None:
                self._mjw.step(self._model, data)
            else:
                wp.capture_launch(self._graph, stream=wp.get_stream(qpos.device))
        for own, given in (*pairs, (data.overflow, overflow)):
            wp.copy(given, own)


def _max_contacts(first: int, second: int) -> int:
    """Largest number of contacts between geoms of two types, see `collision_primitive.py` of MuJoCo Warp."""
    types = {int(first), int(second)}
    if types & {_HFIELD, _SDF}:
        return mujoco.mjMAXCONPAIR
    if _SPHERE in types or types == {_PLANE, _ELLIPSOID}:
        return 1
    if _CAPSULE in types and types <= {_PLANE, _CAPSULE, _BOX}:
        return 2
    return 8 if types <= {_PLANE, _BOX} else 4


def _rows_per_contact(model: MjModel, pair: np.ndarray, number: int) -> int:
    """Constraint rows of a contact; `number` is the index of an explicit pair, or negative."""
    condim = int(model.pair_dim[number] if number >= 0 else model.geom_condim[pair].max())
    is_elliptic = model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    return condim if is_elliptic or condim == 1 else 2 * (condim - 1)


def _other_rows(model: MjModel) -> int:
    """Largest number of constraint rows of equalities, friction losses and limits."""
    equalities = {int(mujoco.mjtEq.mjEQ_CONNECT): 3, int(mujoco.mjtEq.mjEQ_WELD): 6}
    return sum(equalities.get(int(kind), 1) for kind in model.eq_type) + sum(
        int(np.count_nonzero(flags))
        for flags in (
            model.dof_frictionloss > 0,
            model.tendon_frictionloss > 0,
            model.jnt_limited,
            model.tendon_limited,
        )
    )
