"""What a learning run promises: episodes, tests, targets, stops, keys and what is reported of them."""

from functools import cache
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import bojax.config.catalog  # noqa: F401 (registers every kind)
from bojax.engine.build import build
from bojax.engine.groups import static_groups
from bojax.engine.learners import LEARNED, Learned, write_learners
from bojax.envs.base import Env, TimeStep
from bojax.envs.spaces import Box, Discrete
from bojax.envs.tabular import TabularEnv
from bojax.experiments.learning import LearningRun
from bojax.experiments.phases import PHASES
from bojax.experiments.settings import Learning
from bojax.experiments.value_maps import Visits
from bojax.learning.base import ExplorationState, Learner
from bojax.numerics.lanes import LANES
from bojax.results.schema import Column
from bojax.results.store import ResultsError
from bojax.results.tables import KEYS, count_nans, to_arrow
from tests.compiling import REPEATABLY
from tests.tiers import by_tier

CLIFF = {"kind": "cliff-walking", "max_steps": 60}
CHAIN = {"kind": "chain", "length": 4, "max_length": 6, "max_steps": 12}


def run_of(env=None, dtype="float64", **settings) -> LearningRun:
    """A run on cliff walking, or on an environment that is already built."""
    settings = {"learner": "exploration-values", "episodes": 6, "tests": 2} | settings
    given = env if isinstance(env, dict | str) else CLIFF
    run = build(Learning(env=given, dtype=dtype, **settings), dtype)
    return run if env is given or env is None else eqx.tree_at(lambda r: r.env, run, env)


_start = jax.jit(lambda run, keys: jax.vmap(run.init, axis_name=LANES)(keys), compiler_options=REPEATABLY)
_advance = jax.jit(
    lambda run, carry: jax.vmap(run.advance, axis_name=LANES)(carry), compiler_options=REPEATABLY
)
_summaries = jax.jit(lambda run, carry: jax.vmap(run.summary)(carry))


class History:
    """Everything that the advances of some lanes report."""

    def __init__(self, run: LearningRun, lanes=3, seed=0, more_advances=0):
        carry = _start(run, jax.random.split(jax.random.key(seed), lanes))
        self.run, self.carries, records = run, [carry], []
        for _ in range(run.max_advances + more_advances):
            carry, record = _advance(run, carry)
            self.carries.append(carry)
            records.append(record)
        self.active_steps = np.stack([np.asarray(r.active_steps) for r in records])
        self._tables = [jax.tree.map(np.asarray, r.tables) for r in records]

    @property
    def carry(self):
        return self.carries[-1]

    def rows(self, table="episodes", lane=0, phase=None) -> dict[str, np.ndarray]:
        """The valid rows of a lane, in order."""
        parts = []
        for advance in self._tables:
            columns = {name: values[lane] for name, values in advance[table].items()}
            keep = columns["valid"].astype(bool)
            if phase is not None:
                keep = keep & (columns["phase"] == PHASES.index(phase))
            parts.append({name: values[keep] for name, values in columns.items()})
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def summary(self, lane=0) -> dict:
        summaries = _summaries(self.run, self.carry)
        return {name: np.asarray(values)[lane].item() for name, values in summaries.items()}


@cache
def default_history() -> History:
    """Three lanes of the run that most tests look at."""
    return History(run_of())


@cache
def chain_history(learner: str, tests: int, tests_learn: str = "no") -> History:
    """Eight lanes on a chain, with a number of tests after every episode."""
    return History(run_of(env=CHAIN, learner=learner, tests=tests, tests_learn=tests_learn), lanes=8)


def lane_of(tree, lane):
    """One lane of a batched tree."""
    return jax.tree.map(lambda leaf: leaf[lane], tree)


class Corridor(TabularEnv):
    """Cells in a row, one action: forward. The last cell is the goal; one of them can be poisoned.

    Attributes:
        reward: Reward of a step.
        poisoned: Cell whose entering gives NaN; none where it is negative.
        cells: Number of cells; the goal is never reached within fewer steps.
    """

    reward: Float[Array, ""]
    poisoned: Float[Array, ""]
    cells: int = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    num_actions: ClassVar[int] = 1
    num_branches: ClassVar[int] = 1

    @property
    def observation_space(self):
        return Discrete(self.cells)

    def reset(self, key):
        return jnp.int32(0)

    def probabilities(self, state, action):
        return jnp.ones((1,), self.reward.dtype)

    def outcome(self, state, action, branch):
        after = state + 1
        is_goal = after == self.cells - 1
        is_poisoned = after.astype(self.poisoned.dtype) == self.poisoned
        reward = jnp.where(is_poisoned, jnp.nan, self.reward)
        return TimeStep(after, reward, is_goal, jnp.zeros((), bool), is_goal)


def corridor(cells=5, max_steps=10, reward=1.0, poisoned=-1.0):
    return Corridor(jnp.asarray(reward), jnp.asarray(poisoned), cells, max_steps)


class RandomPayment(Env):
    """One step, which pays what was drawn for the run.

    Attributes:
        drawn: What was drawn; None outside of a run.
    """

    drawn: Float[Array, ""] | None = None
    max_steps: int = eqx.field(static=True, default=1)

    @property
    def observation_space(self):
        return Discrete(2)

    @property
    def action_space(self):
        return Discrete(1)

    def of_run(self, key):
        return RandomPayment(jax.random.uniform(key))

    def reset(self, key):
        return self.drawn

    def observe(self, state):
        return jnp.int32(0)

    def step(self, key, state, action):
        true = jnp.ones((), bool)
        return state, TimeStep(jnp.int32(1), state, true, ~true, true)


# Episodes and steps.


def test_episodes_and_tests_share_what_is_drawn_for_their_run():
    history = History(run_of(RandomPayment()))
    paid = np.array([history.rows(lane=lane)["return"] for lane in range(3)])
    assert paid.shape == (3, 18) and np.all(paid == paid[:, :1])
    assert len(np.unique(paid)) == 3


def test_an_episode_row_says_what_its_steps_add_up_to():
    history = default_history()
    for lane in range(3):
        episodes, steps = history.rows(lane=lane, phase="train"), history.rows("steps", lane=lane)
        assert episodes["episode"].tolist() == [1, 2, 3, 4, 5, 6]
        for i, number in enumerate(episodes["episode"]):
            own = steps["episode"] == number
            assert np.sum(own) == episodes["length"][i]
            assert steps["step"][own].tolist() == list(range(1, episodes["length"][i] + 1))
            assert np.sum(steps["reward"][own]) == pytest.approx(episodes["return"][i])
            assert np.cumsum(steps["reward"][own]) == pytest.approx(steps["accumulated_reward"][own])
            assert steps["done"][own].tolist() == [False] * (np.sum(own) - 1) + [True]
        ends = episodes["terminated"].astype(int) + episodes["truncated"].astype(int)
        assert np.all(ends == 1)
        assert np.all(episodes["terminated"] == episodes["success"])
        assert np.all(episodes["length"][episodes["truncated"]] == 60)
        lengths = history.rows(lane=lane)["length"].reshape(6, 3)  # of an episode and its two tests
        assert history.active_steps[:, lane].tolist() == lengths.sum(axis=1).tolist()


def test_steps_say_where_they_were_taken_and_follow_each_other():
    steps = History(run_of(env=CLIFF | {"slip": 0.0})).rows("steps")
    first = steps["step"] == 1
    assert np.all(steps["observation_0"][first] == 36)
    moves = np.asarray([-12, 1, 12, -1])
    for i in np.flatnonzero(~steps["done"]):
        before, action = int(steps["observation_0"][i]), int(steps["action_0"][i])
        after = int(steps["observation_0"][i + 1])
        assert after in (36, before, before + moves[action])


@pytest.mark.parametrize("block, max_steps", [pytest.param(1, 4, marks=pytest.mark.slow), (3, 4), (16, 1)])
def test_no_step_is_made_past_the_limit_whatever_the_block(block, max_steps):
    learner = {"kind": "epsilon-greedy", "block": block}
    history = History(
        run_of(corridor(cells=9, max_steps=max_steps), learner=learner, episodes=3, tests=0), lanes=2
    )
    assert history.rows(lane=1)["length"].tolist() == [max_steps] * 3
    assert len(history.rows("steps", lane=1)["step"]) == 3 * max_steps
    assert np.asarray(history.carry.learner.visits)[1].sum() == 3 * max_steps
    assert history.summary(1)["steps"] == 3 * max_steps
    assert history.rows()["truncated"].all() and not history.rows()["terminated"].any()
    assert history.summary()["success"] is False and history.summary()["episodes_to_goal"] == -1


def test_an_action_is_repeated_from_the_start_of_an_episode():
    env = {"kind": "point-maze", "layout": "open", "max_steps": 14}
    settings = {"learner": "random", "episodes": 2, "tests": 0, "env": env}
    once, repeated = (History(run_of(action_repeat=n, **settings), lanes=2) for n in (1, 4))
    for lane in range(2):
        steps, expected = repeated.rows("steps", lane), once.rows("steps", lane)
        number = np.asarray(steps["step"]) - 1
        for name in ("action_0", "action_1"):
            # The keys of steps do not depend on the repetition.
            first = np.arange(len(number)) - number % 4
            np.testing.assert_array_equal(steps[name], expected[name][first])
        assert len(number) == 28 and len(np.unique(steps["action_0"])) == 8


def test_an_end_within_the_limit_terminates_an_episode():
    env = corridor(cells=5, max_steps=4)
    rows = History(run_of(env, learner="epsilon-greedy", episodes=2, tests=0), lanes=1).rows()
    assert rows["terminated"].all() and not rows["truncated"].any()


def test_the_numbers_of_a_run_are_those_of_its_rows():
    history = History(run_of(env=CHAIN, learner="epsilon-greedy"), lanes=8)
    firsts = set()
    for lane in range(8):
        rows, summary = history.rows(lane=lane, phase="train"), history.summary(lane)
        assert summary["last_return"] == rows["return"][-1]
        planned = history.rows("steps", lane=lane)["planned_reward"][-rows["length"][-1] :]
        assert summary["planned_return"] == pytest.approx(planned.mean(), rel=1e-12)
        assert summary["episodes"] == 6 and summary["steps"] == rows["length"].sum()
        assert summary["success"] == rows["success"].any()
        if not summary["success"]:
            assert summary["episodes_to_goal"] == summary["steps_to_goal"] == -1
            continue
        first = int(np.argmax(rows["success"]))
        firsts.add(first)
        assert summary["episodes_to_goal"] == first + 1
        assert summary["steps_to_goal"] == rows["length"][: first + 1].sum()
    assert len(firsts) > 1


# Schedules.


@pytest.mark.parametrize(
    "schedule, expected",
    [
        ({"kind": "decay", "rate": 1.0}, [2, 1, 2 / 3, 0.5, 0.4, 1 / 3]),
        ({"kind": "budget", "episodes": 1, "resume_after": 2}, [2, 0, 0, 2, 2, 2]),
    ],
)
def test_kappa_is_reported_as_the_schedule_has_it(schedule, expected):
    learner = {"kind": "exploration-values", "kappa": 2.0}
    history = History(run_of(corridor(cells=2), schedule=schedule, learner=learner), lanes=1)
    assert history.rows(phase="train")["kappa"] == pytest.approx(expected)
    assert np.all(history.rows(phase="test")["kappa"] == 0.0)


def test_nothing_is_learned_while_the_schedule_says_so():
    schedule = {"kind": "budget", "episodes": 2, "resume_after": 3}
    history = History(run_of(corridor(), schedule=schedule), lanes=1)
    tables = [np.asarray(carry.learner.columns) for carry in history.carries]
    for before, after, learns in zip(tables[:-1], tables[1:], [1, 1, 0, 0, 0, 1], strict=True):
        assert np.array_equal(before, after) == (not learns)


# Tests and targets.


@pytest.mark.parametrize(
    "learner",
    by_tier(["exploration-values", "additive", "epsilon-greedy"], normal=["additive"]),
)
def test_tests_leave_the_learner_untouched(learner):
    without, history = chain_history(learner, 0), chain_history(learner, 3)
    for mine, theirs in zip(without.carries, history.carries, strict=True):
        assert np.array_equal(mine.learner.columns, theirs.learner.columns)
        assert np.array_equal(mine.learner.visits, theirs.learner.visits)
    for name, values in without.rows(phase="train", lane=1).items():
        assert np.array_equal(values, history.rows(phase="train", lane=1)[name])
    rows = history.rows(phase="test")
    assert rows["episode"].tolist() == np.repeat(np.arange(1, 7), 3).tolist()
    total = history.rows()["length"].sum()
    assert history.active_steps[:, 0].sum() == total


@pytest.mark.parametrize("starts", ["per-episode", "per-run"])
def test_episodes_of_a_run_share_their_start_where_they_are_to(starts):
    run = run_of("single-pendulum", learner="rff-q", starts=starts)

    @jax.jit
    @jax.vmap
    def first_states(key):
        early = run.init(key)
        late = eqx.tree_at(lambda carry: carry.episode, early, early.episode + 3)
        phases = [
            (early, run.training(early)),
            (late, run.training(late)),
            (late, run.test(late, jnp.int32(2))),
        ]
        return [run.reset(*each)[0] for each in phases]

    first, *later = np.asarray(first_states(jax.random.split(jax.random.key(0), 2)))
    assert not np.any(first[0] == first[1])
    for state in later:
        assert np.all((state == first) == (starts == "per-run"))


@pytest.mark.parametrize(
    "learner", by_tier(["exploration-values", "additive"], normal=["exploration-values"])
)
def test_tests_learn_where_they_may_and_explore_in_no_case(learner):
    run = run_of(
        env=CHAIN,
        learner=learner,
        tests=3,
        tests_learn="exploring",
        target_return=0.5,
        schedule="until-target",
    )
    history = History(run)
    visits = np.asarray(history.carry.learner.visits).sum((-2, -1))
    for lane in range(3):
        rows, reached = history.rows(lane=lane), history.summary(lane)["episodes_to_target"]
        learned = rows["episode"] <= reached if reached > 0 else np.full(len(rows["episode"]), True)
        assert visits[lane] == rows["length"][learned].sum()
        assert np.all(rows["kappa"][rows["phase"] == 1] == 0.0)


def test_tests_learn_with_the_exploration_rewards_of_training_only_where_they_are_to():
    """No reward of the chain is negative: without a bonus, the least Q cannot fall, as it does with one."""

    def values(*tests):
        """Q and visits after the first episode and its tests."""
        learner = chain_history("additive", *tests).carries[1].learner
        return np.asarray(learner.columns)[..., 0], np.asarray(learner.visits)

    before, visited = values(0)
    assert np.all(before.min((1, 2)) < 0.0)
    least = {}
    for tests_learn in ("exploiting", "exploring"):
        after, visited_after = values(3, tests_learn)
        assert np.all(visited_after.sum((1, 2)) > visited.sum((1, 2)))
        least[tests_learn] = after.min((1, 2))
    assert np.all(least["exploiting"] >= before.min((1, 2)))
    assert np.all(least["exploring"] < before.min((1, 2)))


def test_a_target_is_reached_once_all_tests_of_a_round_exceed_it():
    run = run_of(
        env=CHAIN | {"length": 5},
        learner={"kind": "epsilon-greedy", "epsilon": 1.0, "discount": 0.9},
        episodes=12,
        tests=3,
        target_return=0.5,
        schedule="until-target",
    )
    history = History(run, lanes=8)
    assert any(history.summary(lane)["reached"] for lane in range(8))
    for lane in range(8):
        summary = history.summary(lane)
        returns = history.rows(phase="test", lane=lane)["return"].reshape(12, 3)
        reached = np.all(returns > 0.5, axis=1)
        assert summary["reached"] == reached.any()
        kappas = history.rows(phase="train", lane=lane)["kappa"]
        if not reached.any():
            assert summary["episodes_to_target"] == -1
            assert np.isnan(summary["return_after_target"])
            assert np.all(kappas > 0.0)
            continue
        first = int(np.argmax(reached))
        assert summary["episodes_to_target"] == first + 1
        assert np.all(kappas[: first + 1] > 0.0) and np.all(kappas[first + 1 :] == 0.0)
        after = returns[first + 1 :]
        assert summary["return_after_target"] == pytest.approx(after.mean(), nan_ok=not after.size)


def test_a_run_can_stop_at_its_target_which_a_return_equal_to_it_does_not_exceed():
    settings = {"learner": "epsilon-greedy", "episodes": 4, "tests": 2, "stop": "target"}
    for target, episodes in ((4.0, 4), (3.9, 1), (3.0, 1)):
        history = History(run_of(corridor(cells=5), target_return=target, **settings), lanes=2)
        summary = history.summary()
        assert (summary["reached"], summary["episodes"]) == (target < 4.0, episodes)
        assert history.rows()["episode"].tolist() == np.repeat(np.arange(episodes) + 1, 3).tolist()
        assert history.active_steps[:, 0].tolist() == [12] * episodes + [0] * (4 - episodes)


def test_a_run_can_stop_at_its_first_success():
    run = run_of(env=CHAIN, learner="epsilon-greedy", episodes=20, tests=0, stop="first-success")
    history = History(run, lanes=6)
    for lane in range(6):
        rows, summary = history.rows(lane=lane), history.summary(lane)
        assert rows["success"][:-1].sum() == 0 and rows["success"][-1]
        assert summary["episodes_to_goal"] == summary["episodes"] == len(rows["episode"])
    assert np.all(np.asarray(jax.vmap(run.is_done)(history.carry)))


def test_a_finished_run_changes_nothing_and_reports_nothing():
    history = History(run_of(), more_advances=2)
    for mine, theirs in zip(jax.tree.leaves(history.carries[6]), jax.tree.leaves(history.carry), strict=True):
        if not jnp.issubdtype(mine.dtype, jax.dtypes.prng_key):
            assert np.array_equal(mine, theirs)
    assert history.rows()["episode"].tolist() == np.repeat(np.arange(1, 7), 3).tolist()
    assert np.all(history.active_steps[6:] == 0)


# Lanes, keys and parameters.


@pytest.mark.parametrize("settings", [{}, {"env": CHAIN, "stop": "first-success", "episodes": 12}])
def test_a_lane_does_not_depend_on_the_others(settings):
    run = run_of(**settings)
    keys, others = (jax.random.split(jax.random.key(seed), 3) for seed in (5, 6))
    carry, same = _start(run, keys), _start(run, others.at[2].set(keys[1]))
    for _ in range(run.max_advances):
        (carry, records), (same, own) = _advance(run, carry), _advance(run, same)
        for mine, theirs in zip(jax.tree.leaves(own.tables), jax.tree.leaves(records.tables), strict=True):
            assert np.array_equal(np.asarray(mine)[2], np.asarray(theirs)[1], equal_nan=True)
    mine, theirs = np.asarray(same.learner.columns), np.asarray(carry.learner.columns)
    assert np.array_equal(mine[2], theirs[1])
    assert not np.array_equal(mine[0], theirs[0])


@pytest.mark.parametrize("dtype", by_tier(["float32", "float64"], normal=["float32"]))
def test_a_run_computes_in_its_precision(dtype):
    run = run_of(env=CHAIN, dtype=dtype, target_return=0.0)
    carry = _start(run, jax.random.split(jax.random.key(0), 1))
    after, records = _advance(run, carry)
    floats = {
        leaf.dtype for leaf in jax.tree.leaves((after, records)) if jnp.issubdtype(leaf.dtype, jnp.floating)
    }
    assert floats == {jnp.dtype(dtype)}
    same = jax.tree.map(lambda a, b: (a.shape, a.dtype) == (b.shape, b.dtype), carry, after)
    assert all(jax.tree.leaves(same))


# What goes wrong.


def test_a_number_that_is_none_ends_the_run_and_is_counted():
    run = run_of(corridor(cells=6, poisoned=3.0), learner="epsilon-greedy", episodes=4, tests=0)
    history = History(run, lanes=2)
    rows = history.rows()
    assert rows["episode"].tolist() == [1] and np.isnan(rows["return"][0])
    assert rows["length"].tolist() == [2]
    assert not (rows["success"][0] or rows["terminated"][0] or rows["truncated"][0])
    assert np.isnan(history.summary()["last_return"])
    assert bool(jax.vmap(run.is_done)(history.carry).all())
    assert np.all(np.isfinite(history.carry.learner.columns))
    assert np.asarray(history.carry.learner.visits)[0].sum() == 2
    assert len(history.rows("steps")["step"]) == 2


def test_weights_that_are_no_number_are_counted_in_runs_that_are_not_recorded():
    run, carry = default_history().run, default_history().carries[2]
    wrong = jnp.asarray([0.0, jnp.nan, jnp.inf])
    learner = eqx.tree_at(
        lambda tables: tables.columns, carry.learner, replace_fn=lambda x: x + wrong[:, None, None, None]
    )
    after, records = _advance(run, eqx.tree_at(lambda c: c.learner, carry, learner))
    runs = {name: np.asarray(values) for name, values in jax.vmap(run.summary)(after).items()}
    keys = {"point": np.zeros(3, np.int32), "run": np.arange(3, dtype=np.int32)}
    table = to_arrow((*KEYS, *run.tables["runs"]), {**keys, **runs})
    assert count_nans(table) == {(0, 1): 1, (0, 2): 1}
    # Its other numbers are as before, so that a study of divergence has its rows.
    assert np.all(np.isfinite(runs["last_return"])) and not np.any(after.is_done)
    assert np.all(np.isfinite(records.tables["episodes"]["return"]))
    # That it happened is not forgotten.
    healed, _ = _advance(run, eqx.tree_at(lambda c: c.learner, after, carry.learner))
    assert np.isnan(healed.planned_return).tolist() == [False, True, True]


# Maps, and what is saved.


def test_maps_are_those_of_their_episodes():
    history = History(run_of(env=CHAIN, map_episodes=(2, 5), tests=0), lanes=2)
    for lane in range(2):
        snapshot = history.run.snapshot(lane_of(history.carry, lane))["values"]
        assert snapshot["episodes"].tolist() == [2, 5]
        for maps, episode in zip(snapshot["maps"], (2, 5), strict=True):
            learned, middle = lane_of(history.carries[episode].learner, lane), 1
            assert np.array_equal(maps[0], learned.q[:, middle])
            assert np.array_equal(maps[1], learned.u[:, middle])
    maps = np.asarray(history.run.snapshot(lane_of(history.carries[3], 0))["values"]["maps"])
    assert np.all(np.isfinite(maps[0])) and np.all(np.isnan(maps[1]))


class Plane(Learner):
    """Q and U of a place are its coordinates; the state is the sum of what it draws after episodes."""

    block: int = eqx.field(static=True, default=1)

    @property
    def exploration_weight(self):
        return jnp.asarray(1.0)

    def init(self, key, observation_space, action_space, capacity):
        return jnp.zeros(())

    def act(self, key, state, observation, exploration: ExplorationState):
        return jnp.zeros(1), jnp.zeros(())

    def observe(self, key, state, transition, exploration, step_in_block):
        return state

    def end_episode(self, key, state, episode, exploration):
        return state + jnp.where(exploration.is_learning, jax.random.uniform(key), 0.0)

    def values(self, state, observation, action):
        return observation[0], observation[1] + action[0]


class Strip(Corridor):
    """The same corridor along the first of two observations."""

    @property
    def observation_space(self):
        return Box(jnp.asarray([0.0, -1.0]), jnp.asarray([4.0, 3.0]))

    @property
    def action_space(self):
        return Box(jnp.asarray([-1.0]), jnp.asarray([3.0]))

    def observe(self, state):
        return jnp.stack([state, jnp.zeros_like(state)]).astype(float)

    def step(self, key, state, action):
        transition = self.outcome(state, jnp.int32(0), jnp.int32(0))
        return state + 1, eqx.tree_at(lambda t: t.observation, transition, self.observe(state + 1))


def on_strip(run):
    strip = Strip(jnp.asarray(1.0), jnp.asarray(-1.0), 5, 10)
    return eqx.tree_at(lambda r: (r.env, r.learner), run, (strip, Plane()))


def test_the_number_of_tests_does_not_change_what_learning_draws():
    runs = [on_strip(run_of(episodes=3, tests=number)) for number in (0, 2)]
    alone, tested = (np.asarray(History(run).carry.learner) for run in runs)
    np.testing.assert_array_equal(alone, tested)
    assert len(set(alone.tolist())) == 3


def test_maps_of_a_plane_are_scored_where_the_run_was_and_where_it_was_not():
    run = run_of(episodes=3, tests=0, map_episodes=(1, 3), map_resolution=4)
    scores = {"unseen_u", "start_u_change", "high_u_change", "u_leads"}
    assert not scores & {column.name for column in run.tables["runs"]}  # its observation is one number
    run = on_strip(run)
    assert scores <= {column.name for column in run.tables["runs"]}
    carry = _start(run, jax.random.split(jax.random.key(0), 1))
    assert np.all(np.isnan(carry.maps.scores))
    carry, _ = _advance(run, carry)
    # Over the first two dimensions, with the action in the middle of its range.
    q, u = np.asarray(carry.maps.values[0, 0])
    assert np.array_equal(q, np.tile([[0.5], [1.5], [2.5], [3.5]], (1, 4)))
    assert np.array_equal(u, np.tile([-0.5, 0.5, 1.5, 2.5], (4, 1)) + 1.0)
    seen = np.zeros((4, 4), bool)
    seen[np.minimum(np.arange(carry.steps[0]), 3), 1] = True  # the second observation is always 0
    assert 1 < seen.sum()
    np.testing.assert_array_equal(carry.maps.visits.seen[0], seen)
    np.testing.assert_array_equal(np.argwhere(carry.maps.visits.starts[0]), [[0, 1]])
    # U is 0.5, 1.5, 2.5 and 3.5 in the four rows of cells: two of them are high. It rises to the last one.
    np.testing.assert_allclose(
        carry.maps.scores[0, 0], [u[~seen].mean() - u[0, 1], u[0, 1], 0.5, 1.0], rtol=1e-6
    )
    assert np.all(np.isnan(carry.maps.scores[0, 1]))


def climb(u: np.ndarray, cell: tuple[int, int]) -> tuple[int, int]:
    """The cell in which a climb ends that always goes to the highest neighbour."""
    while True:
        i, j = cell
        around = [(k, m) for k in range(i - 1, i + 2) for m in range(j - 1, j + 2)]
        best = max(
            (each for each in around if min(each) >= 0 and max(each) < len(u)), key=lambda each: u[each]
        )
        if u[best] == u[cell]:
            return cell
        cell = best


def test_the_gradient_of_a_map_leads_to_new_cells_if_its_high_peaks_are_unvisited():
    rng = np.random.default_rng(0)
    x = np.arange(12)
    low, high = (top - np.add.outer((x - i) ** 2, (x - j) ** 2) for top, i, j in ((-30.0, 2, 3), (0.0, 9, 8)))
    two_hills = np.maximum(low, high)
    shares = []
    for u in (two_hills, *rng.normal(size=(3, 12, 12))):
        for seen in (rng.uniform(size=u.shape) < 0.9, np.ones_like(u, bool), u < u.max()):
            is_new = (u > 0.5 * (u.min() + u.max())) & ~seen
            expected = np.mean([is_new[climb(u, tuple(cell))] for cell in np.argwhere(seen)])
            found = Visits(jnp.asarray(seen), jnp.asarray(seen)).scores(jnp.asarray(u))[3]
            np.testing.assert_allclose(found, expected, rtol=1e-6)
            shares.append(expected)
    assert shares[1::3] == [0.0] * 4  # nowhere to go once every cell is known
    assert 0.0 < shares[2] < 1.0  # the highest peak is new, but some cells lie at the foot of the other hill
    two_hills[3, 4] = np.nan  # a model that has diverged leads nowhere
    assert np.isnan(Visits(jnp.asarray(seen), jnp.asarray(seen)).scores(jnp.asarray(two_hills))[3])


# Saved learners.

EVALUATED = {"env": CHAIN, "schedule": "exploit", "tests": 0, "learner": "exploration-values"}


def learned(seed: int):
    """What a run on the chain has learned."""
    history = History(run_of(env=CHAIN), lanes=1, seed=seed)
    return lane_of(history.carry.learner, 0)


class Twice(Learner):
    """A learner with a column that every `runs.parquet` has."""

    weight: Float[Array, ""]
    name: str = eqx.field(static=True)
    block: int = eqx.field(static=True, default=1)

    @property
    def exploration_weight(self):
        return self.weight

    @property
    def columns(self):
        return (Column(self.name, "float64"),)

    def summary(self, state):
        return {self.name: state}

    def init(self, key, observation_space, action_space, capacity):
        return self.weight

    def act(self, key, state, observation, exploration):
        return jnp.zeros((), jnp.int32), state

    def values(self, state, observation, action):
        return state, state


@pytest.mark.parametrize("name", ["seed", "steps"])
def test_a_learner_does_not_name_a_column_of_all_runs(name):
    run = eqx.tree_at(lambda run: run.learner, run_of(), Twice(jnp.zeros(()), name))
    with pytest.raises(ValueError, match=f"^runs.parquet would have two columns {name}; allowed: names that"):
        run.__check_init__()


def saved(folder, *states) -> str:
    """The folder of the learners of some runs."""
    content = Learned()
    for run, state in enumerate(states):
        content.add(0, run, state)
    write_learners(folder, content.stacked()["0"])
    return str(folder / LEARNED)


def test_saved_learners_enter_as_arrays_and_share_a_program(tmp_path):
    states = [learned(seed) for seed in (1, 2)]
    assert not np.array_equal(states[0].columns, states[1].columns)
    folder = saved(tmp_path, *states)
    runs = [run_of(**EVALUATED, saved=folder, saved_run=number) for number in range(2)]
    for run, state in zip(runs, states, strict=True):
        begun = lane_of(_start(run, jax.random.split(jax.random.key(0), 1)), 0)
        np.testing.assert_array_equal(begun.learner.columns, state.columns)
    (group,) = static_groups(runs)
    assert group.points == (0, 1)


def test_a_saved_learner_of_other_spaces_is_refused_in_one_line(tmp_path):
    folder = saved(tmp_path, learned(1))
    with pytest.raises(ResultsError, match="same kind of learner, features and spaces") as error:
        run_of(**EVALUATED | {"env": CHAIN | {"max_length": 7}}, saved=folder)
    assert "\n" not in str(error.value) and error.value.exit_code == 2
