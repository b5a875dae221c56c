"""An episode of a tabular learner as one kernel of an NVIDIA GPU.

As a program of XLA, a step is some 15 small kernels, each of which waits for the one before, beside those of
other programs. Here a lane is one program of a kernel, with the loop over the steps inside, which reads and
writes the table in the memory of the GPU. What a step computes is what learner, environment and phase compute
for XLA, taken apart into scalars, so that both ways find the same table up to rounding.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bojax.experiments.episode import EpisodeState, apply_transition
from bojax.learning.tabular import Tables, TabularLearner
from bojax.numerics.pallas import barrier, kernels_run_here, launch
from bojax.robots.kernel.scalars import NotScalar, ScalarProgram

MOST_SCALARS = 10_000
"""Maximum number of scalars of a step; that of a taxi has 900."""


def kernel_of(phase: Any, episode: EpisodeState) -> Callable[[Any, EpisodeState], EpisodeState] | None:
    """The function that runs an episode of a `Phase` as a kernel; None if that is not possible."""
    kind = type(phase.learner)
    is_tabular = issubclass(kind, TabularLearner) and vars(kind).get("reads_one_row", False)
    if not (kernels_run_here() and is_tabular and phase.action_repeat == 1):
        return None
    if any(getattr(kind, name) is not getattr(TabularLearner, name) for name in ("observe", "flush")):
        return None  # a step does `change` instead
    try:
        return _EpisodeKernel(phase, episode).run
    except NotScalar:
        return None


class _Elements:
    """The elements of a tree of arrays as scalars, in the order of its leaves."""

    def __init__(self, tree: Any):
        leaves, self._structure = jax.tree.flatten(tree)
        self._leaves = [jax.ShapeDtypeStruct(jnp.shape(x), x.dtype) for x in leaves]
        self._sizes = [math.prod(x.shape) for x in self._leaves]

    @property
    def example(self) -> Any:
        """The tree, with shapes and dtypes in place of arrays."""
        return jax.tree.unflatten(self._structure, self._leaves)

    @property
    def places(self) -> Any:
        """The tree, with the place of its first element in place of each array."""
        return jax.tree.unflatten(self._structure, np.cumsum([0, *self._sizes[:-1]]).tolist())

    @property
    def shapes(self) -> list[jax.ShapeDtypeStruct]:
        """Shapes of what a kernel reads and writes of it: Booleans as integers, and no empty arrays."""
        pairs = zip(self._sizes, self._leaves, strict=True)
        return [jax.ShapeDtypeStruct((size,), _stored(x.dtype)) for size, x in pairs if size]

    def flat(self, tree: Any) -> list[Array]:
        """The arrays of such a tree for a kernel."""
        return [x.reshape(-1).astype(_stored(x.dtype)) for x in jax.tree.leaves(tree) if x.size]

    def tree(self, arrays: Sequence[Array]) -> Any:
        """The tree of such arrays."""
        rest = iter(arrays)
        leaves = [
            (next(rest) if size else jnp.zeros(0)).reshape(of.shape).astype(of.dtype)
            for of, size in zip(self._leaves, self._sizes, strict=True)
        ]
        return jax.tree.unflatten(self._structure, leaves)

    def typed(self, elements: Sequence[Array]) -> list[Array]:
        """The elements with their own types."""
        dtypes = (x.dtype for x, size in zip(self._leaves, self._sizes, strict=True) for _ in range(size))
        return [x != 0 if dtype == jnp.bool_ else x for x, dtype in zip(elements, dtypes, strict=True)]


def _stored(dtype: Any) -> Any:
    return jnp.int32 if dtype == jnp.bool_ else dtype


def _read(refs: Sequence[Any]) -> list[Array]:
    """The elements of arrays, in a kernel."""
    return [ref[np.int32(i)] for ref in refs for i in range(ref.shape[0])]


class _EpisodeKernel:
    """The kernel for phases and episodes like these, whose numbers may be other ones.

    Raises:
        NotScalar: A step cannot be taken apart into scalars.
    """

    def __init__(self, phase: Any, episode: EpisodeState):
        self._learns, table = phase.learns, episode.learner.columns
        self._num_states, *shape = table.shape
        self._entries = [(np.int32(a), np.int32(c)) for a, c in np.ndindex(*shape)]
        self._given, self._own = _Elements(_given(phase)), _Elements(_own(episode))
        row, step = jax.ShapeDtypeStruct(shape, table.dtype), jax.ShapeDtypeStruct((), jnp.int32)
        rows = (row, row) if self._learns else (row,)
        examples = self._given.example, self._own.example, step, *rows
        self._program = ScalarProgram(
            functools.partial(_step, phase), *examples, most=MOST_SCALARS, keeps_nan=True
        )

    def run(self, phase: Any, episode: EpisodeState) -> EpisodeState:
        """Run an episode to its end."""
        given, own = self._given.flat(_given(phase)), self._own.flat(_own(episode))
        # The table and the rows of the steps, which the kernel changes if anything is learned.
        arrays = [episode.learner.columns, episode.rows] if self._learns else [episode.learner.columns]
        results = self._own.shapes
        if self._learns:
            results = results + [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays]
        first, first_result = len(given) + len(own), len(own)
        in_place = {first + i: first_result + i for i in range(len(arrays))} if self._learns else None

        def kernel(*refs: Any) -> None:
            inputs, outputs = refs[: first + len(arrays)], refs[first + len(arrays) :]
            values = self._given.typed(_read(inputs[: len(given)]))
            memory = outputs[first_result:] if self._learns else inputs[first:]
            last = self._steps(values, _read(inputs[len(given) : first]), *memory)
            for ref in outputs[:first_result]:
                for i in range(ref.shape[0]):
                    ref[np.int32(i)] = last.pop(0)

        found = launch(kernel, results, *given, *own, *arrays, name="tabular_episode", in_place=in_place)
        after = self._own.tree(found[:first_result])
        table, rows = found[first_result:] if self._learns else (arrays[0], episode.rows)
        return replace(after, learner=Tables(table), rows=rows)

    def _steps(self, given: list[Array], start: list[Array], table: Any, rows: Any = None) -> list[Array]:
        """The elements of the episode after all steps."""
        places = self._own.places

        def state_of(observation: Int[Array, ""]) -> Int[Array, ""]:
            return jnp.clip(observation, np.int32(0), np.int32(self._num_states - 1))

        def body(carry: Any) -> Any:
            step, elements = carry
            barrier()  # until the entry of the step before has been written
            state = state_of(elements[places.observation])
            known = [
                *given,
                *self._own.typed(elements),
                step,
                *(table[state, a, c] for a, c in self._entries),
            ]
            inputs = self._program.inputs
            values = dict(zip(inputs, known, strict=False))
            after_observation, action = self._program.evaluate(slice(0, 2), values)
            if self._learns:
                after = state_of(after_observation)
                next_row = [table[after, a, c] for a, c in self._entries]
                values |= dict(zip(inputs[len(known) :], next_row, strict=True))
            found = self._program.evaluate(slice(2, None), values)
            elements, learned = found[: len(elements)], found[len(elements) :]
            if self._learns:
                barrier()  # until all threads have read the entry
                size = table.shape[2]
                for c in range(size):
                    table[state, action, np.int32(c)] = learned[c]
                for r in range(rows.shape[1]):
                    rows[step, np.int32(r)] = learned[size + r]
            return step + np.int32(1), tuple(x.astype(_stored(x.dtype)) for x in elements)

        first = jnp.int32(0), tuple(start)
        return list(jax.lax.while_loop(lambda carry: carry[1][places.is_active] != 0, body, first)[1])


def _given(phase: Any) -> Any:
    """The arrays of a phase that a step reads."""
    parts = phase.env, phase.learner, phase.acting, phase.exploration
    return eqx.filter(parts, eqx.is_array), jax.random.key_data(phase.key)


def _own(episode: EpisodeState) -> EpisodeState:
    """The episode without its large arrays; a state may have Python's numbers, which become arrays."""
    rows = jnp.zeros((0, episode.rows.shape[-1]), episode.rows.dtype)
    return jax.tree.map(jnp.asarray, replace(episode, learner=None, rows=rows))


def _phase_of(phase: Any, given: Any) -> Any:
    """The phase with these arrays."""
    arrays, words = given
    parts = phase.env, phase.learner, phase.acting, phase.exploration
    env, learner, acting, exploration = eqx.combine(arrays, eqx.filter(parts, eqx.is_array, inverse=True))
    key = jax.random.wrap_key_data(words)
    return replace(phase, env=env, learner=learner, acting=acting, exploration=exploration, key=key)


def _step(
    phase: Any,
    given: Any,
    own: EpisodeState,
    step: Int[Array, ""],
    row: Float[Array, "A C"],
    next_row: Float[Array, "A C"] | None = None,
) -> tuple[Any, ...]:
    """The next observation, the action within its bounds, and the episode after the step.

    The first two need no `next_row`. If anything is learned, the new entry of the table follows, and the row
    of the step.
    """
    phase = _phase_of(phase, given)
    to_act, to_move, to_learn = phase.keys_of_step(step)
    # An index that is out of range is clipped, so that a table of one row is that of any state.
    choice = phase.act(to_act, replace(own, learner=Tables(row[None])))
    env_state, time_step = phase.env.step(to_move, own.env, choice.action)
    after, counts = apply_transition(phase.env, own, env_state, time_step)
    # A learner of a user's may choose an action that there is not: it must not lead to another row's memory.
    action = jnp.clip(choice.action, 0, len(row) - 1)
    found = time_step.observation, action, after
    if next_row is None:
        return found
    transition, exploration, packed = phase.experience(own, choice, time_step, counts, after.total)
    change = phase.learner.change(to_learn, transition, exploration, row, next_row)
    is_state = (own.observation >= 0) & (own.observation < phase.env.observation_space.num)
    is_pair = is_state & (action == choice.action)
    return *found, row[action] + jnp.where(is_pair, change, 0.0), packed
