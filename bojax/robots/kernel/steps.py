"""Steps of MJX on a GPU as one kernel, with a thread for each robot."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bojax.numerics.pallas import imported, launch
from bojax.robots.kernel.scalars import NotScalar, ScalarProgram
from bojax.robots.models import MjModel

_MOST_SCALARS = 40_000
"""Maximum number of scalars of a kernel; the hopper has 11,000, which Triton compiles in 4 s."""


class KernelSteps:
    """Steps as one kernel for all lanes, in the arithmetic of `mjx.step`.

    In a program of XLA, a step of 256 hoppers by RK4 is 475 kernels of 1.6 us each on an H200. Here a call,
    with all of its substeps, is one kernel: steps are 5.5 times as fast with 256 lanes, and 3.1 times with
    2,048. A lane has a warp of its own, since Triton compiles scalars in seconds but vectors of 32 lanes in
    minutes.

    Args:
        model: The compiled model.
        steps: From positions, velocities, initial accelerations and controls of a lane to the first three
            after the steps.

    Raises:
        ValueError: The model is too large, or has parts that `ScalarProgram` does not know.
    """

    def __init__(self, model: MjModel, steps: Callable[..., Any]):
        self.model = model
        sizes = model.nq, model.nv, model.nv, model.nu
        state = (jax.ShapeDtypeStruct((size,), jnp.float32) for size in sizes)
        try:
            self._program = ScalarProgram(steps, *state, most=_MOST_SCALARS)
        except NotScalar as error:
            refused = f"a kernel cannot simulate the model ({error})"
            raise ValueError(f'physics.impl: got "pallas"; {refused}; use "jax"') from error

    def __call__(
        self,
        qpos: Float[Array, "L Q"],
        qvel: Float[Array, "L V"],
        qacc_warmstart: Float[Array, "L V"],
        control: Float[Array, "L U"],
    ) -> tuple[Float[Array, "L Q"], Float[Array, "L V"], Float[Array, "L V"]]:
        """The state of every lane after the steps, in the order of `RobotState`."""
        program = self._program
        pallas, _ = imported()

        # A program reads the numbers of its lane one by one, as scalars, and so it writes the results.
        def kernel(*refs: Any) -> None:
            lane = pallas.program_id(0)
            before, after = refs[:-3], refs[-3:]
            values = program([ref[lane, i] for ref in before for i in range(ref.shape[1])])
            for ref in after:
                for i in range(ref.shape[1]):
                    ref[lane, i] = values.pop(0)

        results = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in (qpos, qvel, qacc_warmstart)]
        given = [qpos, qvel, qacc_warmstart, *([control] if control.shape[1] else [])]
        qpos, qvel, qacc_warmstart = launch(kernel, results, *given, name="mjx_steps", grid=(len(qpos),))
        return qpos, qvel, qacc_warmstart
