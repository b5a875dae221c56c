"""The episodes of a learning run (thesis, Algorithm 5): the parts of its advances."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Env, EnvState, Observation
from bojax.envs.spaces import Box
from bojax.experiments.base import Experiment, Records
from bojax.experiments.episode import EpisodeState
from bojax.experiments.phases import Phase
from bojax.experiments.step_rows import StepRows
from bojax.experiments.targets import TargetProgress
from bojax.experiments.value_maps import Maps, value_map
from bojax.learning.base import ExplorationState, Learner, LearnerState
from bojax.learning.schedules import Schedule

_OF_RUN = 2**32 - 1
"""Counter of the key of the properties that all episodes of a run share; episodes have smaller counters."""

_START = 2**32 - 2  # counter of the key of the initial state that all episodes of a run share


Starts: TypeAlias = Literal["per-episode", "per-run"]
"""Whether every episode draws its initial state, or all those of a run share one."""


class RunState(eqx.Module):
    """The state of a run."""

    key: Key[Array, ""]  # key of the run
    learner: LearnerState  # state of the learner
    episode: Int[Array, ""]  # number of training episodes so far
    steps: Int[Array, ""]  # number of training steps so far
    outside: Int[Array, ""]  # number of these steps to an observation outside the declared bounds
    is_done: Bool[Array, ""]  # whether the run has ended
    last_return: Float[Array, ""]  # return of the last training episode
    # Mean return that the learner expected of its actions in the last training episode; NaN once this was not
    # finite
    planned_return: Float[Array, ""]
    episodes_to_goal: Int[Array, ""]  # training episodes up to and including the first success; -1 before
    steps_to_goal: Int[Array, ""]  # training steps up to the first success; -1 before
    target: TargetProgress  # progress of the test episodes towards the target return
    maps: Maps | None  # Q and U over the observations after each of `map_episodes`; None if there are none
    counts: dict[str, Int[Array, ""]]  # `Env.counts` over all training episodes so far


def _episode_key(
    run: Key[Array, ""], episode: Int[Array, ""], counter: Int[Array, ""] | int
) -> Key[Array, ""]:
    return jax.random.fold_in(jax.random.fold_in(run, episode), counter)


def reset_key(
    run: Key[Array, ""], episode: Int[Array, ""], counter: Int[Array, ""] | int, shares_start: Bool[Array, ""]
) -> Key[Array, ""]:
    """Key of the initial state of an episode, numbered from 1, or with counter 2 n of its test n."""
    # Key data, because JAX's check of key reuse takes a choice between keys for a use of them.
    of_run = jax.random.key_data(jax.random.fold_in(run, _START))
    of_episode = jax.random.key_data(jax.random.fold_in(_episode_key(run, episode, counter), 0))
    return jax.random.wrap_key_data(jnp.where(shares_start, of_run, of_episode))


def env_of_run(env: Env, run: Key[Array, ""]) -> Env:
    """The environment with the properties that all episodes of a run share."""
    return env.of_run(jax.random.fold_in(run, _OF_RUN))


# Boolean arrays, unlike texts, can differ between the lanes of one program.


def shares_start(starts: Starts) -> Bool[Array, ""]:
    """Whether all episodes of a run have the same initial state."""
    return jnp.asarray(starts == "per-run")


def _exploring(tests_learn: Literal["no", "exploiting", "exploring"]) -> Bool[Array, ""] | None:
    """Whether a learner learns from exploration rewards in its tests; None if it does not learn there."""
    return None if tests_learn == "no" else jnp.asarray(tests_learn == "exploring")


class LearningEpisodes(Experiment):
    """The settings of a learning run, and its episodes, in compiled environments and in those on the host."""

    env: Env
    learner: Learner
    schedule: Schedule
    target_return: Float[Array, ""] | None
    saved: LearnerState
    episodes: int = eqx.field(static=True)
    action_repeat: int = eqx.field(static=True)
    starts: Bool[Array, ""] = eqx.field(converter=shares_start)
    stop: Literal["never", "first-success", "target"] = eqx.field(static=True)
    tests: int = eqx.field(static=True)
    tests_learn: Bool[Array, ""] | None = eqx.field(converter=_exploring)
    map_episodes: tuple[int, ...] = eqx.field(static=True)
    map_resolution: int = eqx.field(static=True)
    # Whether an advance is a single episode also where it could be several, see `one_by_one`
    is_one_by_one: bool = eqx.field(static=True, default=False)

    def training(self, carry: RunState) -> Phase:
        """The next training episode; a run that has ended does not learn."""
        exploration = self.schedule(carry.episode, carry.target.is_reached)
        exploration = ExplorationState(
            exploration.scale.astype(self._dtype), exploration.is_learning & ~carry.is_done
        )
        return self._phase(carry, 0, exploration, exploration, learns=True)

    def test(self, carry: RunState, number: Int[Array, ""]) -> Phase:
        """A test episode after the training episode; the first one has number 1."""
        exploration = self.training(carry).exploration
        if self.tests_learn is None:
            exploration = self.exploiting
        else:
            scale = jnp.where(self.tests_learn, exploration.scale, self.exploiting.scale)
            exploration = replace(exploration, scale=scale)
        return self._phase(carry, 2 * number, self.exploiting, exploration, learns=self.learns_in_tests)

    def reset(self, carry: RunState, phase: Phase) -> tuple[EnvState, Observation]:
        """Initial state and observation of an episode of a compiled environment."""
        env = env_of_run(self.env, carry.key)
        state = env.reset(phase.reset_key)
        return state, env.observe(state)

    def end_episode(self, carry: RunState, episode: EpisodeState) -> LearnerState:
        """The learner after the training episode."""
        return self.training(carry).end(self._key(carry, 1), episode)

    def end_test(self, carry: RunState, number: Int[Array, ""], episode: EpisodeState) -> LearnerState:
        """The learner after a test episode."""
        if not self.learns_in_tests:
            return episode.learner
        return self.test(carry, number).end(self._key(carry, 2 * number + 1), episode)

    def test_row(self, carry: RunState, number: Int[Array, ""], episode: EpisodeState) -> dict[str, Array]:
        """The row of a test episode in `episodes.parquet`."""
        return self.test(carry, number).row(episode, carry.episode + 1)

    def close(
        self, carry: RunState, episode: EpisodeState, learner: LearnerState, tests: Mapping[str, Array] | None
    ) -> tuple[RunState, Records]:
        """The run after a training episode and its tests, and the records of all of them.

        `learner` has been trained and tested. `tests` are the rows of the test episodes; None without tests.
        """
        # A finished run counts no episode: `active` masks its numbers, and its rows are not valid.
        active = ~carry.is_done
        number, steps = carry.episode + active.astype(jnp.int32), carry.steps + episode.length
        is_first = episode.success & (carry.episodes_to_goal < 0)
        episodes_to_goal = jnp.where(is_first, number, carry.episodes_to_goal)
        done = episode.failed | (number >= self.episodes)
        if self.stop == "first-success":
            done = done | (episodes_to_goal >= 0)

        rows = {name: value[None] for name, value in self.training(carry).row(episode, number).items()}
        target, num_steps = carry.target, episode.length
        if tests is not None:
            rows = {name: jnp.concatenate([rows[name], tests[name]]) for name in rows}
            num_steps = num_steps + jnp.sum(tests["length"], dtype=jnp.int32)
            if self.target_return is not None:
                target = target.after_tests(tests["return"], self.target_return, number, active)
        if self.stop == "target":
            done = done | target.is_reached
        rows["phase"] = (jnp.arange(1 + self.tests) > 0).astype(jnp.int32)
        rows["valid"] = jnp.broadcast_to(active, rows["phase"].shape)
        # A learner with non-finite weights still acts. Only the returns that it expects reveal them.
        _, expected = self._rows.unpack(episode.rows)
        is_step = jnp.arange(len(expected), dtype=jnp.int32) < episode.length
        mean = jnp.sum(jnp.where(is_step, expected, 0.0)) / jnp.maximum(episode.length, 1).astype(self._dtype)
        planned_return = jnp.where(jnp.isfinite(mean), mean, jnp.nan)
        maps = carry.maps
        if maps is not None:
            # The map is computed after every episode and kept at `map_episodes`: lanes may be in different
            # episodes.
            now = (number == jnp.asarray(self.map_episodes, jnp.int32)) & active
            unit = None
            if self._maps_a_plane:
                transitions, _ = self._rows.unpack(episode.rows)
                unit = self.env.observation_space.to_unit(transitions.observation)
            maps = maps.after(now, self._map(learner), unit, episode.length)
        after = replace(
            carry,
            learner=learner,
            episode=number,
            steps=steps,
            outside=carry.outside + episode.outside,
            is_done=carry.is_done | done,
            last_return=jnp.where(active, episode.total, carry.last_return),
            # NaN stays, so that the summary shows a learner that diverged at any time.
            planned_return=jnp.where(
                active & ~jnp.isnan(carry.planned_return), planned_return, carry.planned_return
            ),
            episodes_to_goal=episodes_to_goal,
            steps_to_goal=jnp.where(is_first, steps, carry.steps_to_goal),
            target=target,
            maps=maps,
            counts=self._counted(carry, episode),
        )
        tables = {
            "episodes": rows,
            "steps": self._rows.table(episode.rows, episode.length[None], number[None]),
        }
        return after, Records(tables=tables, active_steps=num_steps)

    def _counted(self, carry: RunState, episode: EpisodeState) -> dict[str, Int[Array, ""]]:
        if not carry.counts:  # nor has an environment on the host a state to read
            return carry.counts
        found = self.env.counts(episode.env)
        return {
            name: total + jnp.where(carry.is_done, 0, found[name]) for name, total in carry.counts.items()
        }

    @property
    def learns_in_tests(self) -> bool:
        """Whether tests change the learner."""
        return self.tests_learn is not None

    @property
    def exploiting(self) -> ExplorationState:
        """The exploration state that a learner acts with in a test."""
        return ExplorationState(jnp.zeros((), self._dtype), jnp.zeros((), bool))

    def _phase(
        self,
        carry: RunState,
        counter: Int[Array, ""] | int,
        acting: ExplorationState,
        exploration: ExplorationState,
        *,
        learns: bool,
    ) -> Phase:
        """The episode with this counter of `_key`."""
        start = reset_key(carry.key, carry.episode + 1, counter, self.starts)
        key = self._key(carry, counter)
        return Phase(
            self.env,
            self.learner,
            acting,
            exploration,
            key,
            start,
            learns=learns,
            action_repeat=self.action_repeat,
        )

    def _key(self, carry: RunState, counter: Int[Array, ""] | int) -> Key[Array, ""]:
        """Key of the next training episode (0) or of its end (1), of test n (2 n) or of its end (2 n + 1).

        No key depends on the number of tests, so that tests do not change the training.
        """
        # Counter 0 of the run is the learner's.
        return _episode_key(carry.key, carry.episode + 1, counter)

    def _map(self, learner: LearnerState) -> Float[Array, "2 *grid"]:
        env = self.env
        return value_map(self.learner, learner, env.observation_space, env.action_space, self.map_resolution)

    @property
    def _maps_a_plane(self) -> bool:
        """Whether there are maps over two observations; of more, a map is a slice that no run visits."""
        space = self.env.observation_space
        return bool(self.map_episodes) and isinstance(space, Box) and space.num_dims == 2

    @property
    def _rows(self) -> StepRows:
        return StepRows.of(self.env, self._dtype)

    @property
    def _dtype(self) -> jnp.dtype:
        return self.learner.exploration_weight.dtype
