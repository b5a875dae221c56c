"""Functions of small arrays as one kernel on a GPU, with a warp for each lane."""

import math
from collections.abc import Callable
from typing import Any

import jax

from bojax.numerics.pallas import launch
from bojax.robots.kernel.scalars import ScalarProgram

MOST_SCALARS = 40_000
"""Maximum number of scalars of a kernel; Triton compiles the 11,000 of a hopper in 4 s."""


class ScalarKernel:
    """A function of trees of arrays for a single lane as a kernel of its scalars.

    A lane has a warp of its own, since Triton compiles scalars in seconds but vectors of 32 lanes in minutes.

    Raises:
        NotScalar: As for `ScalarProgram`.
    """

    def __init__(self, function: Callable[..., Any], *examples: Any, name: str):
        self._program, self._name = ScalarProgram(function, *examples, most=MOST_SCALARS, fuses=True), name
        self._examples, self._results = examples, jax.eval_shape(function, *examples)

    def __call__(self, *arguments: Any) -> Any:
        """The results of a single lane; `vmap` adds lanes."""
        expected, given = (
            [(x.shape, x.dtype) for x in jax.tree.leaves(t)] for t in (self._examples, arguments)
        )
        assert given == expected, "a kernel is a program for arrays of these shapes and dtypes"
        arrays = [array.reshape(-1) for array in jax.tree.leaves(arguments) if array.size]
        shapes, structure = jax.tree.flatten(self._results)

        # The program reads the numbers of its lane one by one, as scalars, and so it writes the results.
        def kernel(*refs: Any) -> None:
            given, found = refs[: len(arrays)], refs[len(arrays) :]
            values = self._program([ref[i] for ref in given for i in range(ref.shape[0])])
            for ref in found:
                for i in range(ref.shape[0]):
                    ref[i] = values.pop(0)

        flat = [jax.ShapeDtypeStruct((math.prod(x.shape),), x.dtype) for x in shapes]
        found = launch(kernel, flat, *arrays, name=self._name)
        return structure.unflatten([x.reshape(like.shape) for x, like in zip(found, shapes, strict=True)])
