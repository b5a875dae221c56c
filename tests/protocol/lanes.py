"""What every part must do: batch over its hyper-parameters, give finite numbers, and compile once."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

LANES = 3


def hyperparameters(part: Any) -> list[jax.Array]:
    """The numbers of a part that a sweep can set."""
    return [leaf for leaf in jax.tree.leaves(part) if eqx.is_inexact_array(leaf)]


def batch(part: Any, factors: tuple[float, ...]) -> Any:
    """The part once for each lane, its hyper-parameters times the factor of the lane."""

    def spread(leaf):
        if not eqx.is_array(leaf):
            return leaf
        scales = factors if eqx.is_inexact_array(leaf) else (1,) * len(factors)
        return jnp.stack([leaf * jnp.asarray(s, leaf.dtype) if s != 1 else leaf for s in scales])

    return jax.tree.map(spread, part)


def check(part: Any, run: Callable[[Any, jax.Array, Any], Any], *, inputs: Any = None) -> None:
    """Run lanes of a part twice, with other keys and hyper-parameters the second time.

    The results are finite, the lanes differ if the part has hyper-parameters, and the second call compiles
    nothing.

    Args:
        part: The module.
        run: From the module, a key and the inputs to arrays; one lane.
        inputs: Arguments that all lanes share.
    """
    traces = []

    @eqx.filter_jit
    def lanes(parts, keys, inputs):
        traces.append(parts)
        return eqx.filter_vmap(run, in_axes=(eqx.if_array(0), 0, None))(parts, keys, inputs)

    results = []
    with jax.debug_key_reuse(False):  # the check takes any scan over a batch of keys for a reuse
        for seed, factors in enumerate([(1.0, 0.9, 0.8), (0.95, 0.85, 0.75)]):
            keys = jax.random.split(jax.random.key(seed), LANES)
            results.append(lanes(batch(part, factors), keys, inputs))
    assert len(traces) == 1
    numbers = [[np.asarray(leaf, float) for leaf in jax.tree.leaves(result)] for result in results]
    assert all(np.isfinite(leaf).all() for result in numbers for leaf in result)
    if hyperparameters(part):
        for result in numbers:
            assert any(not np.array_equal(leaf[0], leaf[lane]) for leaf in result for lane in range(1, LANES))


def advance_twice(experiment: Any, key: jax.Array) -> tuple[Any, Any]:
    """The carry of an experiment after two advances, and their tables."""

    def advance(carry, _):
        carry, records = experiment.advance(carry)
        return carry, records.tables

    return jax.lax.scan(advance, experiment.init(key), length=2)
