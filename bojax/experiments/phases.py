"""The two phases of a learning run, training and test: what happens in an episode around its environment.

A phase is everything that Algorithm 5 does apart from stepping the environment. Two loops call its methods in
the same order: `run_episode`, for environments that are compiled with the learner, and
`bojax.engine.hosted.Hosted`, for environments that step on the host.

    begin
    while the episode is active:
        act
        (step the environment)
        apply
        flush, after every `learner.block` steps and at the end
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, UInt32

from bojax.envs.base import Env, EnvState, Observation, TimeStep
from bojax.experiments.episode import Choice, EpisodeState, apply_transition
from bojax.experiments.step_rows import StepRows
from bojax.experiments.tabular_kernel import kernel_of
from bojax.learning.base import Episode, ExplorationState, Learner, LearnerState, Transition
from bojax.numerics.lanes import any_lane, batched_together, write_row
from bojax.numerics.pallas import either

PHASES = ("train", "test")
"""Values of the column `phase`, which holds the index into this list until it is stored."""


class Phase(eqx.Module):
    """A training or test episode, around the steps of its environment."""

    env: Env  # environment
    learner: Learner
    acting: ExplorationState  # exploration state that the learner acts with
    exploration: ExplorationState  # exploration state that it learns with
    key: Key[Array, ""]  # key of the episode
    reset_key: Key[Array, ""]  # key of the initial state of the environment
    # Whether the learner learns, from every step and from the whole episode at its end
    learns: bool = eqx.field(static=True)
    # Number of steps for which every action is repeated
    action_repeat: int = eqx.field(static=True, default=1)

    @property
    def num_rows(self) -> int:
        """Number of steps that are kept, T: the time limit in whole blocks, or 0 if nothing is learned."""
        block = self.learner.block
        return -(-self.env.max_steps // block) * block if self.learns else 0

    @property
    def rows(self) -> StepRows:
        """The layout of the steps that are kept."""
        return StepRows.of(self.env, self.learner.exploration_weight.dtype)

    def step_keys(self, steps: Int[Array, "B"]) -> UInt32[Array, "B 3 W"]:
        """Data of the keys of some steps, see `keys_of_step`.

        The result is key data because JAX's check of key reuse mistakes a batched scan over keys for a reuse.
        """
        counters = (3 * steps[:, None] + jnp.arange(1, 4, dtype=jnp.int32)[None, :]).ravel()
        keys = jax.vmap(lambda counter: jax.random.fold_in(self.key, counter))(counters)
        return jax.random.key_data(keys.reshape(-1, 3))

    def keys_of_step(self, step: Int[Array, ""]) -> list[Key[Array, ""]]:
        """The keys of one step: to act, to step the environment, to learn."""
        return [jax.random.fold_in(self.key, 3 * step + k) for k in range(1, 4)]

    def begin(
        self, learner: LearnerState, env_state: EnvState, observation: Observation, is_active: Bool[Array, ""]
    ) -> EpisodeState:
        """A new episode from the initial state and observation of the environment."""
        false, zero = jnp.zeros((), bool), jnp.zeros((), jnp.int32)
        dtype = self.learner.exploration_weight.dtype
        total = jnp.zeros((), dtype)
        return EpisodeState(
            env=env_state,
            observation=observation,
            learner=learner,
            is_active=is_active,
            total=total,
            length=zero,
            terminated=false,
            truncated=false,
            success=false,
            failed=false,
            outside=zero,
            rows=jnp.zeros((self.num_rows, self.rows.width), dtype),
            repeated=None if self.action_repeat == 1 else Choice(self.env.action_space.example, total),
        )

    def act(self, key: Key[Array, ""], episode: EpisodeState) -> Choice:
        """The action that the learner takes, or the one that is being repeated."""
        choice = Choice(*self.learner.act(key, episode.learner, episode.observation, self.acting))
        if episode.repeated is None:
            return choice
        # The learner chooses in every step, and the choice is dropped where an action is repeated: the lanes
        # of a batch may be at different steps of their episodes.
        is_new = episode.length % self.action_repeat == 0
        return jax.tree.map(lambda new, old: jnp.where(is_new, new, old), choice, episode.repeated)

    def apply(
        self,
        key: Key[Array, ""],
        episode: EpisodeState,
        choice: Choice,
        env_state: EnvState,
        time_step: TimeStep,
        step_in_block: Int[Array, ""],
        place: Int[Array, ""],
    ) -> EpisodeState:
        """The episode after a step of the environment, from which the learner may learn.

        `env_state` is the state after the step, None if the environment steps on the host. `step_in_block` is
        the number of steps since the last `flush`, and `place` the index of the step in the rows.
        """
        after, counts = apply_transition(self.env, episode, env_state, time_step)
        if episode.repeated is not None:
            after = replace(after, repeated=choice)
        if not self.learns:
            return after
        transition, exploration, row = self.experience(episode, choice, time_step, counts, after.total)
        learner = self.learner.observe(key, episode.learner, transition, exploration, step_in_block)
        rows = write_row(episode.rows, place, row)
        return eqx.tree_at(lambda e: (e.learner, e.rows), after, (learner, rows))

    def experience(
        self,
        episode: EpisodeState,
        choice: Choice,
        time_step: TimeStep,
        counts: Bool[Array, ""],
        total: Float[Array, ""],
    ) -> tuple[Transition, ExplorationState, Float[Array, "R"]]:
        """What the learner learns from a step, if it counts, and the row of the step.

        `total` is the sum of the rewards, with that of the step.
        """
        transition = Transition(
            observation=episode.observation,
            action=choice.action,
            reward=time_step.reward,
            next_observation=time_step.observation,
            terminated=time_step.terminated,
        )
        # Non-finite values must not reach the learner: 0 times NaN is NaN.
        transition = jax.tree.map(lambda x: jnp.where(counts, x, jnp.zeros((), x.dtype)), transition)
        row = self.rows.pack(transition, choice.expected, total, self.env.frame(episode.env))
        return transition, self._exploration_if(counts), row

    def flush(self, episode: EpisodeState) -> EpisodeState:
        """The episode after a block of steps: a learner that learns applies its delayed updates."""
        if not self.learns:
            return episode
        return eqx.tree_at(lambda e: e.learner, episode, self.learner.flush(episode.learner))

    def end(self, key: Key[Array, ""], episode: EpisodeState) -> LearnerState:
        """The learner after a whole episode from which it learns."""
        transitions, _ = self.rows.unpack(episode.rows)
        exploration = self._exploration_if(episode.length > 0)
        return self.learner.end_episode(
            key, episode.learner, Episode(transitions, episode.length), exploration
        )

    def row(self, episode: EpisodeState, number: Int[Array, ""]) -> dict[str, Array]:
        """The row of the episode in `episodes.parquet`; `number` counts training episodes."""
        return {
            "episode": number,
            "return": episode.total,
            "length": episode.length,
            "success": episode.success,
            "terminated": episode.terminated,
            "truncated": episode.truncated,
            "kappa": self.acting.scale * self.learner.exploration_weight,
        }

    def _exploration_if(self, learns: Bool[Array, ""]) -> ExplorationState:
        return ExplorationState(self.exploration.scale, self.exploration.is_learning & learns)


def run_episode(phase: Phase, episode: EpisodeState) -> EpisodeState:
    """Run an episode of a compiled environment; on a GPU, one of a tabular learner is a kernel."""
    kernel = kernel_of(phase, episode)
    if kernel is None:
        return run_in_blocks(phase, episode)
    # Fields of an environment or a learner may be texts or functions, which a program does not take.
    arrays, rest = eqx.partition((phase, episode), eqx.is_array)
    by_kernel, in_blocks = (lambda x, run=run: run(*eqx.combine(x, rest)) for run in (kernel, run_in_blocks))
    return either(True, by_kernel, in_blocks, arrays)


def run_in_blocks(phase: Phase, episode: EpisodeState) -> EpisodeState:
    """Run an episode, a block of steps at a time, until no lane is active."""

    def go_on(loop):
        start, episode = loop
        return start + phase.learner.block, run_block(phase, episode, start, jnp.zeros((), jnp.int32))

    # The end is checked once a block, by a flag of all lanes: a check makes a GPU wait for the host, and a
    # flag of each lane would put a select of the whole state into every iteration. Steps after the end of a
    # lane do not count. The tests of a run share its learner, which is therefore left as it is.
    batched = batched_together(eqx.tree_at(lambda e: e.learner, episode, None))
    loop = jnp.zeros((), jnp.int32), eqx.combine(batched, episode)
    return jax.lax.while_loop(lambda loop: any_lane(loop[1].is_active), go_on, loop)[1]


def run_block(
    phase: Phase, episode: EpisodeState, start: Int[Array, ""], first: Int[Array, ""]
) -> EpisodeState:
    """Run a block of steps of an episode of a compiled environment.

    `start` is the number of steps before the block, and `first` the index of the first step of the episode in
    its rows.
    """
    block = jnp.arange(phase.learner.block, dtype=jnp.int32)

    def run_step(episode, inputs):
        key_data, step_in_block = inputs
        keys = jax.random.wrap_key_data(key_data)
        choice = phase.act(keys[0], episode)
        env_state, time_step = phase.env.step(keys[1], episode.env, choice.action)
        place = first + start + step_in_block
        return phase.apply(keys[2], episode, choice, env_state, time_step, step_in_block, place), None

    episode, _ = jax.lax.scan(run_step, episode, (phase.step_keys(start + block), block))
    return phase.flush(episode)
