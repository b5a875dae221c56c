"""What every part must do: batch over its hyper-parameters, give finite numbers, and compile once."""

from collections.abc import Callable, Collection
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params
from jax.interpreters.partial_eval import dce_jaxpr

from bojax.config.catalog import kinds
from bojax.numerics.lanes import LANES as AXIS
from tests.parts import first_kinds

LANES = 3


def each_kind(role: str, *, traced: Collection[str] = ()) -> pytest.MarkDecorator:
    """Parametrise a test by the kinds of a role, and by how to check them.

    The normal tier runs one kind of each class and traces the others; the slow tier runs these as well.

    Args:
        role: The role.
        traced: Kinds that the normal tier only traces, since other tests run them.
    """
    cases, run = [], set(first_kinds(role)) - set(traced)
    for kind in kinds(role):
        if kind not in run:
            cases.append(pytest.param(kind, check_traced, id=f"{kind}-traced"))
        marks = () if kind in run else pytest.mark.slow
        cases.append(pytest.param(kind, check, id=kind, marks=marks))
    return pytest.mark.parametrize(("kind", "check"), cases)


def hyperparameters(part: Any) -> list[jax.Array]:
    """The numbers of a part that a sweep can set."""
    return [leaf for leaf in jax.tree.leaves(part) if eqx.is_inexact_array(leaf)]


def batch(part: Any, factors: tuple[float, ...]) -> Any:
    """The part once for each lane, its hyper-parameters times the factor of the lane."""

    def spread(leaf):
        if eqx.is_inexact_array(leaf):
            return jnp.asarray(np.multiply.outer(factors, np.asarray(leaf)), leaf.dtype)
        return jnp.stack([leaf] * len(factors)) if eqx.is_array(leaf) else leaf

    return jax.tree.map(spread, part)


def of_one(run: Callable[[Any, jax.Array, Any], Any]) -> Callable[[Any, jax.Array, Any], Any]:
    """A function of a part, a key and inputs, in lanes; all lanes share the inputs."""
    return eqx.filter_vmap(run, in_axes=(eqx.if_array(0), 0, None))


def of_experiment(where: Callable[[Any], Any], end: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Lanes of an experiment, the inputs, with the part in its place: what `end` says after two advances."""

    def run(parts, keys, experiment):
        def in_lanes(function, argument):
            def one(part, argument):
                return function(eqx.tree_at(where, experiment, part), argument)

            return eqx.filter_vmap(one, in_axes=(eqx.if_array(0), 0), axis_name=AXIS)(parts, argument)

        def advance(carry, _):
            carry, records = in_lanes(lambda experiment, carry: experiment.advance(carry), carry)
            return carry, records.tables

        carry = in_lanes(lambda experiment, key: experiment.init(key), keys)
        carry, tables = jax.lax.scan(advance, carry, length=2)
        return in_lanes(end, carry), jax.tree.map(lambda column: column.swapaxes(0, 1), tables)

    return run


def check(part: Any, run: Callable[[Any, jax.Array, Any], Any], inputs: Any = None) -> None:
    """Run lanes of a part twice, with other keys and hyper-parameters the second time.

    The results are finite, the lanes differ if the part has hyper-parameters, and the second call compiles
    nothing.

    Args:
        part: The module.
        run: From modules, keys and the inputs to arrays; see `of_one`.
        inputs: Arguments that all lanes share.
    """
    for result in _twice(part, run, inputs):
        numbers = [np.asarray(leaf, float) for leaf in jax.tree.leaves(result)]
        assert all(np.isfinite(leaf).all() for leaf in numbers)
        if hyperparameters(part):
            assert any(
                not np.array_equal(leaf[0], leaf[lane]) for leaf in numbers for lane in range(1, LANES)
            )


def check_traced(part: Any, run: Callable[[Any, jax.Array, Any], Any], inputs: Any = None) -> None:
    """Trace what `check` runs.

    There is a result for every lane, in the precision of the part; it depends on hyper-parameters if the part
    has some; every product is at full precision on a GPU; and the second call traces nothing.
    """
    for closed, shapes, _ in _twice(part, run, inputs, eqx.filter_make_jaxpr):
        results = jax.tree.leaves(shapes)
        assert results and all(leaf.shape[:1] == (LANES,) for leaf in results)
        numbers = {leaf.dtype for leaf in results if jnp.issubdtype(leaf.dtype, jnp.inexact)}
        assert numbers <= {leaf.dtype for leaf in hyperparameters((part, inputs))}
        assert not rounded_products(closed.jaxpr)
        _, is_used = dce_jaxpr(closed.jaxpr, [True] * len(results))
        if hyperparameters(part):
            arrays = filter(eqx.is_array, jax.tree.leaves(part))  # the first arguments
            assert any(
                used and eqx.is_inexact_array(leaf) for leaf, used in zip(arrays, is_used, strict=False)
            )


def rounded_products(jaxpr: Any) -> list[Any]:
    """The products of a program that a GPU rounds to TF32 if they are of 32-bit numbers."""
    found = []
    for eqn in jaxpr.eqns:
        is_product = eqn.primitive.name == "dot_general" and eqn.params["precision"] is None
        if is_product and jnp.issubdtype(eqn.outvars[0].aval.dtype, jnp.inexact):
            found.append(eqn)
        for inner in jaxprs_in_params(eqn.params):
            found += rounded_products(inner)
    return found


def _twice(part: Any, run: Callable, inputs: Any, transform: Callable = lambda lanes: lanes) -> list[Any]:
    """The results of a compiled function of lanes, possibly transformed; it must have been traced once."""
    traces = []

    @eqx.filter_jit
    def lanes(parts, keys, inputs):
        traces.append(parts)
        return run(parts, keys, inputs)

    results = []
    with jax.debug_key_reuse(False):  # the check takes any scan over a batch of keys for a reuse
        for seed, factors in enumerate([(1.0, 0.9, 0.8), (0.95, 0.85, 0.75)]):
            keys = jax.random.split(jax.random.key(seed), LANES)
            results.append(transform(lanes)(batch(part, factors), keys, inputs))
    assert len(traces) == 1
    return results
