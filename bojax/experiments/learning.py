"""A learning run (thesis, Algorithm 5): training episodes of a learner, each followed by test episodes."""

import contextlib
import copy
from collections.abc import Iterator, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Key, Scalar
from typing_extensions import override

from bojax.envs.check import check_env
from bojax.envs.spaces import Box
from bojax.experiments.back_to_back import episodes_in_advance, run_back_to_back
from bojax.experiments.base import Records
from bojax.experiments.learning_episodes import LearningEpisodes, RunState
from bojax.experiments.phases import PHASES, run_episode
from bojax.experiments.targets import TARGET_COLUMNS, TargetProgress
from bojax.experiments.value_maps import SCORE_COLUMNS, Maps
from bojax.learning.base import LearnerState
from bojax.learning.check import check_learner, check_schedule, check_spaces, check_weight
from bojax.learning.tabular import TabularLearner
from bojax.numerics.lanes import EPISODES
from bojax.results.schema import COMMON_COLUMNS, Column, Table, column_names


@contextlib.contextmanager
def _located(part: str) -> Iterator[None]:
    """Begin the message of a ValueError with the part that it is about."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{part}: {error}") from error


class LearningRun(LearningEpisodes):
    """Episodes of a learner in an environment.

    An advance is one training episode and the tests after it, or several episodes without tests.

    Settings: `bojax.experiments.settings.Learning`.
    """

    def __check_init__(self):
        """Check the environment, the learner in it, and the schedule, or raise ValueError."""
        with _located("learner"):
            check_weight(self.learner)
        with _located("env"):
            check_env(self.env, self._dtype)
        spaces = self.env.observation_space, self.env.action_space
        check_spaces(self.learner, *spaces)
        with _located("learner"):
            check_learner(self.learner, *spaces)
        names = [*COMMON_COLUMNS, *column_names(self.tables["runs"])]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"runs.parquet would have two columns {twice[0]}; allowed: names that differ")
        with _located("schedule"):
            check_schedule(self.schedule)

    def fitted(self) -> "LearningRun":
        """The run with values of the settings of the learner that are left to the environment."""
        learner = self.learner.fitted(self.env.observation_space, self.env.action_space)
        return eqx.tree_at(lambda run: run.learner, self, learner)

    def one_by_one(self) -> "LearningRun":
        """The same run, with an advance for each episode."""
        run = copy.copy(self)
        object.__setattr__(run, "is_one_by_one", True)  # a copy by way of `__init__` would be checked anew
        return run

    @property
    @override
    def tables(self) -> Mapping[str, Table]:
        return {
            "runs": _RUN_COLUMNS
            + self.env.count_columns
            + (TARGET_COLUMNS if self.target_return is not None else ())
            + (SCORE_COLUMNS if self._maps_a_plane else ())
            + self.learner.columns,
            "episodes": _EPISODE_COLUMNS,
            "steps": self._rows.columns,
        }

    @property
    @override
    def recorded_tables(self) -> frozenset[str]:
        # The steps of all runs would take gigabytes.
        return frozenset({"steps"})

    @property
    @override
    def is_hosted(self) -> bool:
        return self.env.is_hosted

    @property
    @override
    def lanes_on_cpu(self) -> int:
        return self.learner.lanes_on_cpu

    @property
    @override
    def lanes_on_gpu(self) -> int:
        return self.learner.lanes_on_gpu

    @property
    @override
    def narrowest(self) -> int | None:
        return None if self.stop == "never" else self.learner.narrowest

    @property
    @override
    def max_advances(self) -> int:
        return -(-self.episodes // self._episodes_in_advance)

    @property
    @override
    def steps_per_advance(self) -> int:
        return self._episodes_in_advance * self.env.max_steps

    @property
    def _episodes_in_advance(self) -> int:
        """Number of training episodes that an advance has at least, of a run that goes on.

        It is one if all lanes have to end their episodes together: for tests, maps and learning from whole
        episodes. An episode of a tabular learner is a kernel, in which no lane waits for others.
        """
        are_together = self.tests or self.map_episodes or self.is_hosted or self.learner.learns_from_episodes
        if are_together or isinstance(self.learner, TabularLearner) or self.is_one_by_one:
            return 1
        return min(episodes_in_advance(self.env.max_steps), self.episodes)

    @override
    def init(self, key: Key[Array, ""]) -> RunState:
        learner = self.saved
        if learner is None:
            episodes = self.episodes * (1 + self.tests * self.learns_in_tests)
            learner = self.new_learner(jax.random.fold_in(key, 0), episodes * self.env.max_steps)
        zero, never = jnp.zeros((), jnp.int32), jnp.full((), -1, jnp.int32)
        number = jnp.zeros((), self._dtype)
        maps = None
        if self.map_episodes:  # an empty array could not be spread over devices
            of_one = jax.eval_shape(self._map, learner)
            maps = Maps.none(len(self.map_episodes), of_one, are_scored=self._maps_a_plane)
        return RunState(
            key=key,
            learner=learner,
            episode=zero,
            steps=zero,
            outside=zero,
            is_done=jnp.zeros((), bool),
            last_return=number,
            planned_return=number,
            episodes_to_goal=never,
            steps_to_goal=never,
            target=TargetProgress(never, zero, number),
            maps=maps,
            counts={column.name: zero for column in self.env.count_columns},
        )

    @override
    def advance(self, carry: RunState) -> tuple[RunState, Records]:
        if self._episodes_in_advance > 1:
            return run_back_to_back(self, carry)
        # Lines 3-9 of Algorithm 5. A run that has ended begins an episode that is not active, which takes no
        # steps.
        training = self.training(carry)
        episode = training.begin(carry.learner, *self.reset(carry, training), ~carry.is_done)
        episode = run_episode(training, episode)
        # After the loop and not in a `cond` within it: a branch under `vmap` would refit in every step.
        learner = self.end_episode(carry, episode)
        tests = None
        if self.tests:

            def run_test(learner, number):
                test = self.test(carry, number)
                episode = test.begin(learner, *self.reset(carry, test), ~carry.is_done)
                episode = run_episode(test, episode)
                return self.end_test(carry, number, episode), self.test_row(carry, number, episode)

            # Tests that learn change the learner in turn. Others depend on nothing but the learner, and are
            # one batch, which shares it.
            numbers = jnp.arange(1, self.tests + 1)
            if self.learns_in_tests:
                learner, tests = jax.lax.scan(run_test, learner, numbers)
            else:
                tests = jax.vmap(lambda number: run_test(learner, number)[1], axis_name=EPISODES)(numbers)
        return self.close(carry, episode, learner, tests)

    @override
    def is_done(self, carry: RunState) -> Bool[Array, ""]:
        return carry.is_done

    @override
    def summary(self, carry: RunState) -> dict[str, Scalar]:
        summary = {
            "last_return": carry.last_return,
            "planned_return": carry.planned_return,
            "success": carry.episodes_to_goal >= 0,
            "episodes": carry.episode,
            "steps": carry.steps,
            "outside": carry.outside,
            "episodes_to_goal": carry.episodes_to_goal,
            "steps_to_goal": carry.steps_to_goal,
        }
        if self.target_return is not None:
            summary |= carry.target.summary()
        if carry.maps is not None:
            summary |= carry.maps.summary()
        return summary | carry.counts | self.learner.summary(carry.learner)

    @override
    def snapshot(self, carry: RunState) -> dict[str, dict[str, Array]]:
        """The maps of Q and U, and the bounds of the observations."""
        if carry.maps is None:
            return {}
        values = {"maps": carry.maps.values, "episodes": jnp.asarray(self.map_episodes, jnp.int32)}
        if isinstance(space := self.env.observation_space, Box):
            values |= {"low": space.low, "high": space.high}
        return {"values": values}

    @override
    def exported_state(self, carry: RunState) -> LearnerState:
        """The state of the learner, without its memory of transitions."""
        return self.learner.policy_state(carry.learner)

    def new_learner(self, key: Key[Array, ""], capacity: int) -> LearnerState:
        """A learner that has observed nothing; a saved one has the shapes of capacity 0."""
        return self.learner.init(key, self.env.observation_space, self.env.action_space, capacity)


_RUN_COLUMNS: Table = (
    Column("last_return", "float64", "", "sum of the rewards of the last training episode"),
    Column(
        "planned_return",
        "float64",
        "",
        "mean return Q that the learner expected of its actions in the last training episode; NaN once this "
        "was not finite",
    ),
    Column("success", "bool", "", "the goal was reached in a training episode"),
    Column("episodes", "int32", "", "training episodes"),
    Column("steps", "int32", "", "steps of all training episodes"),
    Column("outside", "int32", "", "training steps to an observation outside the declared bounds"),
    Column("episodes_to_goal", "int32", "", "training episodes up to the first success", nullable=True),
    Column("steps_to_goal", "int32", "", "training steps up to the first success", nullable=True),
)

_EPISODE_COLUMNS: Table = (
    Column("episode", "int32", "", "number of the training episode, from 1; of a test, the one before it"),
    Column("phase", "string", "", "training, or a test that exploits", words=PHASES),
    Column("return", "float64", "", "sum of the rewards"),
    Column("length", "int32", "", "steps"),
    Column("success", "bool", "", "the goal was reached"),
    Column("terminated", "bool", "", "the episode ended in a terminal state"),
    Column("truncated", "bool", "", "the episode was truncated"),
    Column("kappa", "float64", "", "weight of exploration: kappa, xi or epsilon"),
)
