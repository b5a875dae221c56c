"""Training episodes of a lane, each of which begins as soon as the last one has ended.

The lanes of a batch make their steps together. If they also began their episodes together, all would wait for
the longest episode: of 200 hoppers, some stand for 500 steps while most fall after 50. Only a learner that
learns from whole episodes needs that, since its refits are expensive and all lanes have theirs at once.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Key, UInt32

from bojax.experiments.base import Records
from bojax.experiments.episode import EpisodeState, where
from bojax.experiments.learning_episodes import LearningEpisodes, RunState
from bojax.experiments.phases import Phase, run_block
from bojax.learning.base import ExplorationState, LearnerState
from bojax.numerics.lanes import any_lane, batched_together

MOST_STEPS = 2048
"""Largest number of steps of a lane in an advance, unless a single episode may have more."""

MOST_EPISODES = 64
"""Largest number of episodes of a lane in an advance."""


def episodes_in_advance(max_steps: int) -> int:
    """Number of episodes that an advance has at least, of a run that goes on."""
    return max(1, min(MOST_STEPS // max_steps, MOST_EPISODES))


class _Lane(eqx.Module):
    """What a lane carries from one block of steps to the next."""

    run: RunState  # the run after the episodes that have ended, without its key and its learner
    episode: EpisodeState  # the current episode, `_alone`
    # What the current episode has of its phase
    acting: ExplorationState
    exploration: ExplorationState
    key: UInt32[Array, "W"]  # as data: JAX's check of key reuse takes a choice between keys for a use of them
    waits: Bool[Array, ""]  # whether the first episode has not begun yet
    is_open: Bool[Array, ""]  # whether the current episode has begun, and has not been counted yet
    step: Int[Array, ""]  # its number of steps, in whole blocks
    first: Int[Array, ""]  # its place in the rows: the number of steps of the episodes before
    count: Int[Array, ""]  # number of episodes that have ended
    table: dict[str, Array]  # their rows in `episodes.parquet`

    @property
    def has_ended(self) -> Bool[Array, ""]:
        """Whether the current episode has ended, and has not been counted yet."""
        return self.is_open & ~self.episode.is_active

    def run_with(self, key: Key[Array, ""]) -> RunState:
        """The run with its key, which no lane changes."""
        return eqx.tree_at(lambda run: run.key, self.run, key, is_leaf=lambda leaf: leaf is None)

    def phase(self, run: LearningEpisodes, key: Key[Array, ""]) -> Phase:
        """The phase of the current episode of a run with a key."""
        training, own = run.training(self.run_with(key)), jax.random.wrap_key_data(self.key)
        return replace(training, acting=self.acting, exploration=self.exploration, key=own)


def run_back_to_back(run: LearningEpisodes, carry: RunState) -> tuple[RunState, Records]:
    """Advance a run by training episodes, as long as `MOST_STEPS` leaves room for another one."""
    block = run.learner.block
    room = run.env.max_steps * episodes_in_advance(run.env.max_steps)
    # A block of steps more than there is room for, where lanes write that are not active any more.
    rows = jnp.zeros((room + block, run.training(carry).rows.width), carry.last_return.dtype)

    def go_on(carried: tuple[_Lane, LearnerState, Array]) -> tuple[_Lane, LearnerState, Array]:
        lane, learner, rows = carried
        episode = replace(lane.episode, learner=learner, rows=rows)
        # Without transitions: a learner that needs them does not come here.
        ended = run.end_episode(lane.run_with(carry.key), replace(episode, rows=rows[:0]))
        learner = where(lane.has_ended, ended, learner)
        # Few blocks end an episode, and to begin another one takes a GPU as many kernels as some steps.
        begins = any_lane(lane.waits | lane.has_ended)
        lane = jax.lax.cond(
            begins, lambda lane: _turn(run, carry.key, lane, rows, room), lambda lane: lane, lane
        )
        episode = replace(lane.episode, learner=learner, rows=rows)
        episode = run_block(lane.phase(run, carry.key), episode, lane.step, lane.first)
        step = jnp.where(episode.is_active, lane.step + block, 0)
        return replace(lane, episode=_alone(episode), step=step), episode.learner, episode.rows

    # What all lanes share of the learner stays shared.
    start = batched_together(_first(run, carry, room)), carry.learner, batched_together(rows)
    lane, learner, rows = jax.lax.while_loop(lambda c: any_lane(c[0].waits | c[0].is_open), go_on, start)
    lengths = jnp.where(lane.table["valid"], lane.table["length"], 0)
    steps = run.training(carry).rows.table(rows[:room], lengths, lane.table["episode"])
    records = Records({"episodes": lane.table, "steps": steps}, jnp.sum(lengths, dtype=jnp.int32))
    return replace(lane.run_with(carry.key), learner=learner), records


def _first(run: LearningEpisodes, carry: RunState, room: int) -> _Lane:
    """A lane before its first episode, in which nothing has a value yet."""

    def begin() -> tuple[EpisodeState, dict[str, Array]]:
        phase = run.training(carry)
        episode = phase.begin(carry.learner, *run.reset(carry, phase), ~carry.is_done)
        return _alone(episode), run.close(carry, episode, carry.learner, None)[1].tables["episodes"]

    episode, row = jax.eval_shape(begin)
    num_rows = min(run.episodes, MOST_EPISODES, room)
    phase, zero = run.training(carry), jnp.zeros((), jnp.int32)
    return _Lane(
        run=_without_key(replace(carry, learner=None)),
        episode=jax.tree.map(_zeros, episode),
        acting=phase.acting,
        exploration=phase.exploration,
        key=jax.random.key_data(phase.key),
        waits=jnp.ones((), bool),
        is_open=jnp.zeros((), bool),
        step=zero,
        first=zero,
        count=zero,
        table={name: jnp.zeros((num_rows,), column.dtype) for name, column in row.items()},
    )


def _turn(run: LearningEpisodes, key: Key[Array, ""], lane: _Lane, rows: Array, room: int) -> _Lane:
    """Count the episode where it has ended, and begin the next one if there is room for it."""
    episode, longest, ends = lane.episode, run.env.max_steps, lane.has_ended
    own = jax.lax.dynamic_slice_in_dim(rows, lane.first, longest)
    before = lane.run_with(key)
    closed, records = run.close(before, replace(episode, rows=own), None, None)
    row = {name: column[0] for name, column in records.tables["episodes"].items()}
    # A choice in every row: one kernel, where to write a single row would be one of each column.
    is_place = ends & (jnp.arange(len(lane.table["valid"]), dtype=jnp.int32) == lane.count)
    table = {name: jnp.where(is_place, row[name], column) for name, column in lane.table.items()}
    after = where(ends, closed, before)
    count = lane.count + ends.astype(jnp.int32)
    first = lane.first + jnp.where(ends, episode.length, 0)
    has_room = (first + longest <= room) & (count < len(table["valid"]))
    begins = (lane.waits | ends) & ~after.is_done & has_room
    phase = run.training(after)
    new = _alone(phase.begin(None, *run.reset(after, phase), begins))
    acting, exploration = where(begins, (phase.acting, phase.exploration), (lane.acting, lane.exploration))
    return _Lane(
        run=_without_key(after),
        # Also the first one of a run that has ended, so that no step is computed of zeros.
        episode=where(lane.waits | begins, new, episode),
        acting=acting,
        exploration=exploration,
        key=jnp.where(begins, jax.random.key_data(phase.key), lane.key),
        waits=jnp.zeros_like(lane.waits),
        is_open=jnp.where(ends, begins, lane.is_open | begins),
        step=lane.step,
        first=first,
        count=count,
        table=table,
    )


def _without_key(run: RunState) -> RunState:
    return eqx.tree_at(lambda run: run.key, run, None)


def _zeros(like: jax.ShapeDtypeStruct) -> ArrayLike:
    """Anything of a shape and a dtype, which is set before it is read; a number where JAX has a number."""
    if jnp.issubdtype(like.dtype, jax.dtypes.prng_key):
        return jnp.empty_like(like)
    return np.zeros((), like.dtype).item() if like.weak_type and not like.shape else jnp.zeros_like(like)


def _alone(episode: EpisodeState) -> EpisodeState:
    """An episode without the learner and the rows, which are never chosen between two as a whole."""
    return replace(episode, learner=None, rows=episode.rows[:0])
