"""A learning run: episodes of a learner in an environment, with test episodes in between."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar, UInt32

from bojax.envs.base import Action, Env, EnvState, Observation, TimeStep
from bojax.envs.spaces import Box
from bojax.experiments.base import Experiment, Records
from bojax.experiments.trial import StepRows, Trial, is_outside
from bojax.learning.base import Balance, Episode, Experience, Learner, LearnerState
from bojax.learning.schedules import Schedule
from bojax.numerics.checkpoint import restore
from bojax.numerics.lanes import any_lane
from bojax.results.schema import Column, Table

PHASES = ("train", "test")
"""What an episode is for; the column `phase` holds the place in this list until it is stored."""

_OF_RUN = 2**32 - 1
"""Counter of the key for what all episodes of a run share: beyond that of any episode."""


class Target(eqx.Module):
    """How the test episodes of a run stand to the return that they are to reach.

    Attributes:
        episodes: Training episodes after which all tests of a round exceeded it; -1 before.
        tests_after: Number of test episodes after that.
        return_after: Sum of their returns.
    """

    episodes: Int[Array, ""]
    tests_after: Int[Array, ""]
    return_after: Float[Array, ""]

    @property
    def is_reached(self) -> Bool[Array, ""]:
        """Whether they have."""
        return self.episodes >= 0

    def tested(
        self,
        returns: Float[Array, "N"],
        target: Float[Array, ""],
        episode: Int[Array, ""],
        counts: Bool[Array, ""],
    ) -> "Target":
        """After a round of tests, if it counts."""
        is_new = counts & ~self.is_reached & jnp.all(returns > target)
        is_after = counts & self.is_reached
        return Target(
            episodes=jnp.where(is_new, episode, self.episodes),
            tests_after=self.tests_after + jnp.where(is_after, len(returns), 0),
            return_after=self.return_after + jnp.where(is_after, jnp.sum(returns), 0.0),
        )


class Run(eqx.Module):
    """The state of a run.

    Attributes:
        key: Key of everything that the run draws.
        learner: What has been learned.
        episode: Training episodes done.
        steps: Training steps made.
        outside: Of these, the ones that led to an observation outside the declared bounds.
        is_done: The run is over.
        last_return: Return of the last training episode.
        episodes_to_goal: Training episodes up to the first with success, that one included; -1 before.
        steps_to_goal: Training steps up to that success; -1 before.
        target: How the test episodes stand to their target.
        maps: Q and U over the observations, after each of `map_episodes`; NaN before, None where none are
            asked for.
    """

    key: Key[Array, ""]
    learner: LearnerState
    episode: Int[Array, ""]
    steps: Int[Array, ""]
    outside: Int[Array, ""]
    is_done: Bool[Array, ""]
    last_return: Float[Array, ""]
    episodes_to_goal: Int[Array, ""]
    steps_to_goal: Int[Array, ""]
    target: Target
    maps: Float[Array, "K 2 *grid"] | None


class LearningRun(Experiment):
    """Episodes of a learner in an environment (Algorithm 5); an advance is one of them, with its tests.

    Attributes:
        env: The environment.
        learner: Who learns.
        schedule: How exploration changes from episode to episode.
        target_return: Return that every test episode of a round has to exceed; None for no target.
        episodes: Training episodes.
        stop: When a run may end early: at its first success, or once the target is reached.
        tests: Test episodes after each training episode: exploitation alone, without learning.
        map_episodes: Training episodes after which Q and U are kept over the first two observations.
        map_resolution: Cells of such a map along a dimension.
        saved: Folder of a saved learner to begin with.
    """

    env: Env
    learner: Learner
    schedule: Schedule
    target_return: Float[Array, ""] | None
    episodes: int = eqx.field(static=True)
    stop: Literal["never", "first-success", "target"] = eqx.field(static=True)
    tests: int = eqx.field(static=True)
    map_episodes: tuple[int, ...] = eqx.field(static=True)
    map_resolution: int = eqx.field(static=True)
    saved: str | None = eqx.field(static=True)
    learned: LearnerState = eqx.field(init=False)

    def __post_init__(self):
        """Read the saved learner.

        Raises:
            ResultsError: It cannot be read, or is of another structure.
        """
        self.learned = None
        if self.saved is not None:
            structure = jax.eval_shape(self._fresh, jax.random.key(0))
            advice = "a saved learner keeps its kind, its features and the spaces of its environment"
            self.learned = restore(Path(self.saved), structure, advice)

    @property
    def tables(self) -> Mapping[str, Table]:
        """See `Experiment`."""
        return {
            "runs": _RUN_COLUMNS + (_TARGET_COLUMNS if self.target_return is not None else ()),
            "episodes": _EPISODE_COLUMNS,
            "steps": self._rows.columns,
        }

    @property
    def recorded_tables(self) -> frozenset[str]:
        """See `Experiment`: all steps of all runs would be gigabytes."""
        return frozenset({"steps"})

    @property
    def is_hosted(self) -> bool:
        """See `Experiment`."""
        return self.env.is_hosted

    @property
    def lanes_on_cpu(self) -> int:
        """See `Experiment`."""
        return self.learner.lanes_on_cpu

    @property
    def max_advances(self) -> int:
        """See `Experiment`."""
        return self.episodes

    def init(self, key: Key[Array, ""]) -> Run:
        """See `Experiment`."""
        learner = self._fresh(jax.random.fold_in(key, 0)) if self.learned is None else self.learned
        zero, never = jnp.zeros((), jnp.int32), jnp.full((), -1, jnp.int32)
        number = jnp.zeros((), self._dtype)
        maps = None
        if self.map_episodes:  # else an array without a number, which cannot be spread over devices
            grid = jax.eval_shape(self._map, learner).shape
            maps = jnp.full((len(self.map_episodes), *grid), jnp.nan, self._dtype)
        return Run(
            key=key,
            learner=learner,
            episode=zero,
            steps=zero,
            outside=zero,
            is_done=jnp.zeros((), bool),
            last_return=number,
            episodes_to_goal=never,
            steps_to_goal=never,
            target=Target(never, zero, number),
            maps=maps,
        )

    def advance(self, carry: Run) -> tuple[Run, Records]:
        """See `Experiment`."""
        balance = self.balance(carry)

        def step(keys, trial, number, slot):
            chosen = self.learner.act(keys[0], trial.learner, trial.observation, balance)
            led_to = self.env.step(keys[1], trial.env, chosen[0])
            return self.go_on(keys[2], trial, balance, chosen, led_to, number, slot)

        trial = self.begin(carry, *self._reset(carry, 0))
        trial = self._until_over(carry, 0, trial, step, self.consolidate)
        learner = self.end_episode(carry, trial, balance)
        tests = None
        if self.tests:
            numbers = jnp.arange(1, self.tests + 1)
            _, tests = jax.lax.scan(lambda _, n: (None, self._test(carry, learner, n)), None, numbers)
        return self.close(carry, trial, learner, tests)

    def is_done(self, carry: Run) -> Bool[Array, ""]:
        """See `Experiment`."""
        return carry.is_done

    def summary(self, carry: Run) -> dict[str, Scalar]:
        """See `Experiment`."""
        summary = {
            "return": carry.last_return,
            "success": carry.episodes_to_goal >= 0,
            "episodes": carry.episode,
            "steps": carry.steps,
            "outside": carry.outside,
            "episodes_to_goal": carry.episodes_to_goal,
            "steps_to_goal": carry.steps_to_goal,
        }
        if self.target_return is not None:
            target = carry.target
            summary["reached"] = target.is_reached
            summary["episodes_to_target"] = target.episodes
            summary["return_after_target"] = target.return_after / target.tests_after.astype(self._dtype)
        return summary

    def snapshot(self, carry: Run) -> dict[str, dict[str, Array]]:
        """The maps of Q and U, where some are asked for, and the bounds of the observations they are over."""
        if carry.maps is None:
            return {}
        values = {"maps": carry.maps, "episodes": jnp.asarray(self.map_episodes, jnp.int32)}
        if isinstance(space := self.env.observation_space, Box):
            values |= {"low": space.low, "high": space.high}
        return {"values": values}

    def keepsake(self, carry: Run) -> LearnerState:
        """See `Experiment`: what has been learned, without the memory of how."""
        return self.learner.without_memory(carry.learner)

    # The pieces of an advance, for whoever steps an environment by other means.

    def balance(self, carry: Run) -> Balance:
        """The balance of the next training episode; a finished run learns nothing more."""
        balance = self.schedule(carry.episode, carry.target.is_reached)
        return Balance(balance.exploration.astype(self._dtype), balance.is_learning & ~carry.is_done)

    def begin(self, carry: Run, env: EnvState, observation: Observation, *, is_test: bool = False) -> Trial:
        """A new episode of the run, from a state of the environment and what is seen of it."""
        length = -(-self.env.max_steps // self.learner.block) * self.learner.block
        false = jnp.zeros((), bool)
        return Trial(
            env=env,
            observation=observation,
            learner=carry.learner,
            is_active=~carry.is_done,
            total=jnp.zeros((), self._dtype),
            length=jnp.zeros((), jnp.int32),
            terminated=false,
            truncated=false,
            success=false,
            failed=false,
            outside=jnp.zeros((), jnp.int32),
            steps=jnp.zeros((0 if is_test else length, self._rows.width), self._dtype),
        )

    def keys(
        self, carry: Run, start: Int[Array, ""], number: Int[Array, ""] | int = 0
    ) -> UInt32[Array, "B 3 W"]:
        """Data of the keys of a block of steps: to act, to step the environment, to learn.

        As data, since JAX's check of key reuse takes a batched scan over keys for a reuse. `number` is 0
        for the training episode, 1 for the first test after it, and so on.
        """
        counters = 3 * start + jnp.arange(1, 3 * self.learner.block + 1, dtype=jnp.int32)
        key = self._key(carry, number)
        keys = jax.vmap(lambda counter: jax.random.fold_in(key, counter))(counters)
        return jax.random.key_data(keys.reshape(-1, 3))

    def reset_key(self, carry: Run, number: Int[Array, ""] | int) -> Key[Array, ""]:
        """Key of the state from which an episode starts."""
        return jax.random.fold_in(self._key(carry, number), 0)

    def take(self, trial: Trial, transition: TimeStep, env: EnvState) -> tuple[Trial, Bool[Array, ""]]:
        """What a transition means for an episode, and whether it counts and is a number."""
        numbers = jnp.append(jnp.ravel(transition.observation).astype(self._dtype), transition.reward)
        is_sound = jnp.all(jnp.isfinite(numbers))
        counts = trial.is_active & is_sound
        fails = trial.is_active & ~is_sound
        length = trial.length + counts.astype(jnp.int32)
        terminated = counts & transition.terminated
        truncated = counts & ~transition.terminated & (transition.truncated | (length >= self.env.max_steps))
        keep = lambda after, before: jax.tree.map(  # noqa: E731
            lambda a, b: a if a is b else jnp.where(counts, a, b), after, before
        )
        after = Trial(
            env=keep(env, trial.env),
            observation=keep(transition.observation, trial.observation),
            learner=trial.learner,
            is_active=counts & ~terminated & ~truncated,
            total=trial.total + jnp.where(counts, transition.reward, jnp.where(fails, jnp.nan, 0.0)),
            length=length,
            terminated=trial.terminated | terminated,
            truncated=trial.truncated | truncated,
            success=trial.success | (counts & transition.success),
            failed=trial.failed | fails,
            outside=trial.outside
            + (counts & is_outside(self.env.observation_space, transition.observation)).astype(jnp.int32),
            steps=trial.steps,
        )
        return after, counts

    def go_on(
        self,
        key: Key[Array, ""],
        trial: Trial,
        balance: Balance,
        chosen: tuple[Action, Float[Array, ""]],
        led_to: tuple[EnvState, TimeStep],
        step: Int[Array, ""],
        slot: Int[Array, ""],
    ) -> Trial:
        """A step of a training episode, once it is known what the action led to: keep it, learn from it."""
        (action, expected), (env, transition) = chosen, led_to
        experience = Experience(
            trial.observation, action, transition.reward, transition.observation, transition.terminated
        )
        frame = self.env.frame(trial.env)
        trial, counts = self.take(trial, transition, env)
        # What is no number teaches nothing, and leaves no trace.
        experience = jax.tree.map(lambda x: jnp.where(counts, x, jnp.zeros((), x.dtype)), experience)
        taught = Balance(balance.exploration, balance.is_learning & counts)
        learner = self.learner.observe(key, trial.learner, experience, taught, slot)
        row = self._rows.pack(experience, expected, frame)
        steps = jax.lax.dynamic_update_index_in_dim(trial.steps, row, step, 0)
        return eqx.tree_at(lambda t: (t.learner, t.steps), trial, (learner, steps))

    def consolidate(self, trial: Trial) -> Trial:
        """After every block of steps."""
        return eqx.tree_at(lambda t: t.learner, trial, self.learner.consolidate(trial.learner))

    def end_episode(self, carry: Run, trial: Trial, balance: Balance) -> LearnerState:
        """What the learner makes of a whole training episode."""
        key = self._key(carry, self.tests + 1)  # after those of the tests
        balance = Balance(balance.exploration, balance.is_learning & (trial.length > 0))
        episode = Episode(self._rows.unpack(trial.steps)[0], trial.length)
        return self.learner.end_episode(key, trial.learner, episode, balance)

    def close(
        self, carry: Run, trial: Trial, learner: LearnerState, tests: Mapping[str, Array] | None
    ) -> tuple[Run, Records]:
        """The run after an episode, and what is reported of it."""
        active = ~carry.is_done
        episode, steps = carry.episode + active.astype(jnp.int32), carry.steps + trial.length
        is_first = trial.success & (carry.episodes_to_goal < 0)
        episodes_to_goal = jnp.where(is_first, episode, carry.episodes_to_goal)
        done = trial.failed | (episode >= self.episodes)
        if self.stop == "first-success":
            done = done | (episodes_to_goal >= 0)

        rows = self._row(trial, episode, self.balance(carry))
        rows = {name: value[None] for name, value in rows.items()}
        target, num_steps = carry.target, trial.length
        if tests is not None:
            rows = {name: jnp.concatenate([rows[name], tests[name]]) for name in rows}
            num_steps = num_steps + jnp.sum(tests["length"], dtype=jnp.int32)
            if self.target_return is not None:
                target = target.tested(tests["return"], self.target_return, episode, active)
        if self.stop == "target":
            done = done | target.is_reached
        rows["phase"] = (jnp.arange(1 + self.tests) > 0).astype(jnp.int32)
        rows["valid"] = jnp.broadcast_to(active, rows["phase"].shape)
        maps = carry.maps
        if maps is not None:
            now = (episode == jnp.asarray(self.map_episodes, jnp.int32)) & active
            now = now.reshape(-1, *[1] * (maps.ndim - 1))
            maps = jnp.where(now, self._map(learner)[None], maps)
        after = Run(
            key=carry.key,
            learner=learner,
            episode=episode,
            steps=steps,
            outside=carry.outside + trial.outside,
            is_done=carry.is_done | done,
            last_return=jnp.where(active, trial.total, carry.last_return),
            episodes_to_goal=episodes_to_goal,
            steps_to_goal=jnp.where(is_first, steps, carry.steps_to_goal),
            target=target,
            maps=maps,
        )
        tables = {"episodes": rows, "steps": self._rows.table(trial.steps, trial.length, episode)}
        return after, Records(tables=tables, active_steps=num_steps)

    def _fresh(self, key: Key[Array, ""]) -> LearnerState:
        capacity = 0 if self.saved else self.episodes * self.env.max_steps
        return self.learner.init(key, self.env.observation_space, self.env.action_space, capacity)

    def test_row(self, carry: Run, trial: Trial) -> dict[str, Array]:
        """What is reported of a test episode."""
        return self._row(trial, carry.episode + 1, self.exploiting)

    def _test(self, carry: Run, learner: LearnerState, number: Int[Array, ""]) -> dict[str, Array]:
        def step(keys, trial, *_):
            action, _ = self.learner.act(keys[0], learner, trial.observation, self.exploiting)
            env, transition = self.env.step(keys[1], trial.env, action)
            return self.take(trial, transition, env)[0]

        trial = self.begin(carry, *self._reset(carry, number), is_test=True)
        return self.test_row(carry, self._until_over(carry, number, trial, step, lambda trial: trial))

    def _until_over(
        self,
        carry: Run,
        number: Int[Array, ""] | int,
        trial: Trial,
        step: Callable[..., Trial],
        after_block: Callable[[Trial], Trial],
    ) -> Trial:
        """Steps, `block` at a time, until no lane is in its episode any more.

        Args:
            carry: The run.
            number: Which of its present episodes, see `keys`.
            trial: The episode at its beginning.
            step: A step of it, from its keys, the episode, and its number in the episode and in the block.
            after_block: What follows a block.
        """
        slots = jnp.arange(self.learner.block, dtype=jnp.int32)

        def block(loop):
            start, trial = loop

            def one(trial, at):
                return step(jax.random.wrap_key_data(at[0]), trial, start + at[1], at[1]), None

            trial, _ = jax.lax.scan(one, trial, (self.keys(carry, start, number), slots))
            return start + self.learner.block, after_block(trial)

        start = jnp.zeros((), jnp.int32), trial
        return jax.lax.while_loop(lambda loop: any_lane(loop[1].is_active), block, start)[1]

    def _reset(self, carry: Run, number: Int[Array, ""] | int) -> tuple[EnvState, Observation]:
        env = self.env.of_run(jax.random.fold_in(carry.key, _OF_RUN))
        state = env.reset(self.reset_key(carry, number))
        return state, env.observe(state)

    def _row(self, trial: Trial, episode: Int[Array, ""], balance: Balance) -> dict[str, Array]:
        return {
            "episode": episode,
            "return": trial.total,
            "length": trial.length,
            "success": trial.success,
            "terminated": trial.terminated,
            "truncated": trial.truncated,
            "kappa": balance.exploration * self.learner.exploration_weight,
        }

    def _map(self, learner: LearnerState) -> Float[Array, "2 *grid"]:
        """Q and U at the middle action: of every state, or over the first two observations."""
        space, actions = self.env.observation_space, self.env.action_space
        if isinstance(actions, Box):
            action = 0.5 * (actions.low + actions.high)
        else:
            action = jnp.asarray(actions.num // 2, jnp.int32)
        if not isinstance(space, Box):
            states = jnp.arange(space.num, dtype=jnp.int32)
            values = jax.vmap(lambda s: self.learner.values(learner, s, action))(states)
            return jnp.stack(values)
        axis = (jnp.arange(self.map_resolution, dtype=self._dtype) + 0.5) / self.map_resolution
        first, second = jnp.meshgrid(axis, axis, indexing="ij")
        unit = jnp.full((self.map_resolution, self.map_resolution, space.num_dims), 0.5, self._dtype)
        unit = unit.at[..., 0].set(first)
        unit = unit.at[..., 1].set(second) if space.num_dims > 1 else unit
        observations = space.from_unit(unit)
        of_row = jax.vmap(lambda o: self.learner.values(learner, o, action))
        return jnp.stack(jax.lax.map(of_row, observations))

    def _key(self, carry: Run, number: Int[Array, ""] | int) -> Key[Array, ""]:
        """Key of an episode: of training, or of a test after it. Counter 0 of the run made the learner."""
        key = jax.random.fold_in(carry.key, carry.episode + 1)
        return jax.random.fold_in(key, number)

    @property
    def _rows(self) -> StepRows:
        return StepRows(self.env.observation_space, self.env.action_space, self._frame_size, self._dtype)

    @property
    def _frame_size(self) -> int:
        if self.env.is_hosted:
            return 0
        frame = jax.eval_shape(lambda key: self.env.frame(self.env.reset(key)), jax.random.key(0))
        return 0 if frame is None else frame.size

    @property
    def exploiting(self) -> Balance:
        """The balance of a test."""
        return Balance(jnp.zeros((), self._dtype), jnp.zeros((), bool))

    @property
    def _dtype(self) -> jnp.dtype:
        return self.learner.exploration_weight.dtype


_RUN_COLUMNS: Table = (
    Column("return", "float64", "", "sum of the rewards of the last training episode"),
    Column("success", "bool", "", "the goal was reached in a training episode"),
    Column("episodes", "int32", "", "training episodes"),
    Column("steps", "int32", "", "steps of all training episodes"),
    Column("outside", "int32", "", "training steps to an observation outside the declared bounds"),
    Column("episodes_to_goal", "int32", "", "training episodes up to the first success", nullable=True),
    Column("steps_to_goal", "int32", "", "training steps up to the first success", nullable=True),
)

_TARGET_COLUMNS: Table = (
    Column("reached", "bool", "", "all test episodes after some training episode exceeded the target"),
    Column("episodes_to_target", "int32", "", "training episodes up to that", nullable=True),
    Column("return_after_target", "float64", "", "mean return of the test episodes after it", nullable=True),
)

_EPISODE_COLUMNS: Table = (
    Column("episode", "int32", "", "number of the training episode, from 1; of a test, the one before it"),
    Column("phase", "string", "", "training, or a test that exploits and learns nothing", words=PHASES),
    Column("return", "float64", "", "sum of the rewards"),
    Column("length", "int32", "", "steps"),
    Column("success", "bool", "", "the goal was reached"),
    Column("terminated", "bool", "", "it ended in an absorbing state"),
    Column("truncated", "bool", "", "it was cut off"),
    Column("kappa", "float64", "", "weight of exploration: kappa, xi or epsilon"),
)
