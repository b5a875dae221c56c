"""Steps of C MuJoCo, on the CPU of the host, called from within JAX programs."""

import copy
import functools
import hashlib
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bojax.numerics import host_calls
from bojax.numerics.cores import usable_cores
from bojax.robots.models import MjModel, mujoco, serialised

_SPEC = sum(
    int(getattr(mujoco.mjtState, f"mjSTATE_{part}")) for part in ("QPOS", "QVEL", "WARMSTART", "CTRL")
)
"""The parts of MuJoCo's state that a step reads, which `mj_getState` stores in this order."""

_LANES_PER_THREAD = 8
"""Smallest number of lanes that a thread is worth: their steps take a tenth of a millisecond or more."""


class CSteps:
    """Steps in 64 bits, on all cores of the process.

    A lane depends on its own state and controls alone: its bits do not depend on the other lanes, nor on the
    number of cores. The state is NaN where MuJoCo warned, see `_advance_in_place`. Bodies do not fall asleep,
    since the state of a lane does not say which of them are asleep.
    """

    def __init__(self, model: MjModel, substeps: int):
        self.model, self.substeps = copy.copy(model), substeps
        # Otherwise a state that diverges becomes the initial one.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        self._unused = []
        # Programs that call the steps by the name of their content can be cached.
        digest = hashlib.sha256(serialised(self.model) + str(substeps).encode()).hexdigest()
        self._name = f"bojax_c_mujoco_{digest[:32]}"
        self._has_name = host_calls.register(self._name, self._advance)

    def __call__(
        self,
        qpos: Float[Array, "L Q"],
        qvel: Float[Array, "L V"],
        qacc_warmstart: Float[Array, "L V"],
        control: Float[Array, "L U"],
    ) -> tuple[Float[Array, "L Q"], Float[Array, "L V"], Float[Array, "L V"]]:
        """The state of every lane after the steps, in the order of `RobotState`; NaN where MuJoCo warned."""
        # Packed into one matrix: each array of a callback costs 25 us.
        before = jnp.concatenate([qpos, qvel, qacc_warmstart, control], axis=1)
        num_lanes, width = before.shape
        shape = jax.ShapeDtypeStruct((num_lanes, width - control.shape[1]), before.dtype)

        def by_callback(before):
            return jax.pure_callback(self._advance, shape, before)

        def by_name(before):
            return host_calls.call(self._name, before, shape.shape[1])

        if self._has_name:
            after = jax.lax.platform_dependent(before, cpu=by_name, default=by_callback)
        else:
            after = by_callback(before)
        num_qpos, num_qvel = qpos.shape[1], qvel.shape[1]
        qpos, qvel, qacc_warmstart = jnp.split(after, [num_qpos, num_qpos + num_qvel], axis=1)
        return qpos, qvel, qacc_warmstart

    def _advance(self, before: Float[Array | np.ndarray, "L QVVU"]) -> np.ndarray:
        """The steps, in NumPy."""
        # A copy, since the steps are made in place: rows of MuJoCo's state vector, in the order of `_SPEC`.
        states = np.array(before, np.float64)
        pool, num_threads = _threads()
        parts = np.array_split(states, max(1, min(num_threads, len(states) // _LANES_PER_THREAD)))
        if len(parts) == 1:
            self._advance_in_place(states)
        else:
            list(pool.map(self._advance_in_place, parts))
        return states[:, : self.model.nq + 2 * self.model.nv].astype(np.float32)

    def _advance_in_place(self, states: np.ndarray) -> None:
        """The steps of some lanes, one after the other.

        MuJoCo warns of contacts and constraints for which there was no room, of controls that are not
        finite, and of positions, velocities and accelerations that are not finite or huge. It only prints
        a warning, and writes it to a file, if the counter of its kind is 0.
        """
        try:
            data = self._unused.pop()
        except IndexError:  # all are in use by other threads
            data = mujoco.MjData(self.model)
        warnings = data.warning.number
        for state in states:
            warnings[:] = 1
            mujoco.mj_setState(self.model, data, state, _SPEC)
            mujoco.mj_step(self.model, data, self.substeps)
            mujoco.mj_getState(self.model, data, state, _SPEC)
            if warnings.max() > 1:
                state[:] = np.nan
        self._unused.append(data)


@functools.cache
def _threads() -> tuple[ThreadPoolExecutor, int]:
    """Threads for all cores that the process may use."""
    number = usable_cores()
    return ThreadPoolExecutor(number), number
