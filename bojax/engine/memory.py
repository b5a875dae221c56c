"""The memory that an experiment asks for, found by tracing one run: no array is allocated."""

import math
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr

from bojax.config.component import Component
from bojax.config.errors import ConfigError, shown
from bojax.config.limits import budget, counts_of, memory
from bojax.experiments.base import Experiment
from bojax.numerics.construct import Locate
from bojax.numerics.lanes import LANES
from bojax.text import one_line

ORDINARY = 100
"""Memory is checked only if integers exceed their defaults by factors whose product is larger than this.

With its defaults, the arrays of an experiment are far smaller than the memory. Tracing takes up to a second,
and a sweep whose programs are saved would trace nothing else.
"""


def check_memory(experiment: Experiment, config: Component, locate: Locate) -> None:
    """Refuse an experiment if one array of one run is larger than half the memory.

    Raises:
        ConfigError: An array is too large. The message names the setting that is farthest above its default.
    """
    factors = {path: (value / default, value) for path, value, default in counts_of(config)}
    if math.prod(max(factor, 1.0) for factor, _ in factors.values()) <= ORDINARY:
        return
    path = max(factors, key=lambda path: factors[path][0])
    got = f"{locate(path)}: got {shown(factors[path][1])}"
    try:
        largest = largest_array(experiment)
    except (MemoryError, OverflowError) as error:
        raise ConfigError(f"{got}, which is too large ({one_line(error)})") from error
    if largest > budget():
        raise ConfigError(
            f"{got}; an array of one run would take about {memory(largest)} of memory; allowed: at most "
            f"{memory(budget())}"
        )


def largest_array(experiment: Experiment) -> int:
    """Size of the largest array of one run, in bytes."""
    carry = jax.eval_shape(experiment.init, jax.random.key(0))
    functions = [experiment.advance, experiment.summary, experiment.snapshot]
    if experiment.is_hosted:  # its steps cannot be traced
        functions = functions[1:]
    arrays = [leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(carry)]
    arrays += [_largest(jax.make_jaxpr(each, axis_env=[(LANES, 1)])(carry)) for each in functions]
    return max(arrays, default=0)


def _largest(program: ClosedJaxpr | Jaxpr) -> int:
    """Size of the largest result of an operation, including the operations of loops and branches."""
    sizes = [0, *(getattr(constant, "nbytes", 0) for constant in getattr(program, "consts", ()))]
    program = getattr(program, "jaxpr", program)
    for operation in program.eqns:
        for result in operation.outvars:
            shape, dtype = getattr(result.aval, "shape", ()), getattr(result.aval, "dtype", None)
            sizes.append(math.prod(shape) * getattr(dtype, "itemsize", 1))
        inner = jax.tree.leaves(list(operation.params.values()), is_leaf=_is_program)
        sizes += [_largest(each) for each in inner if _is_program(each)]
    return max(sizes)


def _is_program(value: Any) -> bool:
    return isinstance(value, ClosedJaxpr | Jaxpr)
