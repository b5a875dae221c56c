"""A planning episode: what it records, when it ends, and that planners meet the same world."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.experiments.planning import PlanningEpisode, PlanningState
from bojax.motions.base import DiscreteMotions, tightest_radius
from bojax.planning.base import PathPlanner, Plan
from bojax.planning.myopic import MyopicPlanner
from bojax.planning.random import RandomPlanner
from bojax.problems.vehicles.base import Exact
from bojax.results.schema import Column, column_names
from tests.motions.families import cubic, kernel, splines
from tests.planning.samples import FIELD, f64, monitoring, parking
from tests.problems.goal_disc import GoalDisc, goal_disc
from tests.refusals import assert_refused
from tests.tiers import by_tier

NUM_LANES = 64


class Wide(Exact):
    """A vehicle that cannot turn sharply, or drive far."""

    radius: float = eqx.field(static=True)
    farthest: float = eqx.field(static=True)

    @property
    def turning_radius(self) -> float:
        return self.radius

    @property
    def reach(self) -> float:
        return self.farthest


class Stored(DiscreteMotions):
    """Paths as they were measured."""

    length: jax.Array
    poses: jax.Array
    num_samples: int = eqx.field(static=True)

    @property
    def num_actions(self) -> int:
        return self.poses.shape[0]

    def paths(self):
        return self.poses


class Straight(PathPlanner):
    """Always straight on, whatever the belief."""

    motions: eqx.Module

    def plan(self, key, problem, belief) -> Plan:
        del key, problem, belief
        zero = jnp.zeros((), self.motions.length.dtype)
        return Plan(self.motions.paths()[0], reward=zero, value=zero, visits=jnp.ones((), jnp.int32))


class Measuring(Straight):
    """Measures where it believes to be."""

    @property
    def run_columns(self):
        return (Column("believed_x", "float64", "m", "where the robot is"),)

    def plan(self, key, problem, belief) -> Plan:
        return dataclasses.replace(super().plan(key, problem, belief), measured={"believed_x": belief[0]})


EXPERIMENTS = {
    "parking": PlanningEpisode(parking(), RandomPlanner(kernel())),
    "parking-on": PlanningEpisode(parking(exit_terminates=False), RandomPlanner(splines(5))),
    "disc": PlanningEpisode(goal_disc(), RandomPlanner(cubic())),
    "disc-straight": PlanningEpisode(goal_disc(), Straight(splines(5))),
    "disc-measured": PlanningEpisode(goal_disc(), Measuring(splines(5))),
    "field": PlanningEpisode(monitoring("gradient"), RandomPlanner(cubic())),
    "field-myopic": PlanningEpisode(monitoring(start=(0.6, 0.6, 0.0)), MyopicPlanner(splines(5))),
}
NORMAL = EXPERIMENTS.keys() - {"field"}  # the other field has all that it has

each_experiment = pytest.mark.parametrize("name", by_tier(EXPERIMENTS, normal=NORMAL))


def lanes_of(seed: int = 0):
    return jax.random.split(jax.random.key(seed), NUM_LANES)


@jax.jit
def start(experiment: PlanningEpisode, keys) -> PlanningState:
    return jax.vmap(experiment.init)(keys)


@jax.jit
def advance(experiment: PlanningEpisode, carries: PlanningState):
    return jax.vmap(experiment.advance)(carries)


@jax.jit
def summary_of(experiment: PlanningEpisode, carries: PlanningState):
    return jax.vmap(experiment.summary)(carries)


@jax.jit
def snapshot_of(experiment: PlanningEpisode, carries: PlanningState):
    return jax.vmap(experiment.snapshot)(carries)


def play(experiment: PlanningEpisode, keys):
    """All carries of a batch of episodes, and all rows: `[lane, step]` for each column."""
    carries, rows, active = [start(experiment, keys)], [], []
    for _ in range(experiment.max_advances + 1):  # once more than any lane needs
        carry, records = advance(experiment, carries[-1])
        carries.append(carry)
        rows.append(records.tables["steps"])
        active.append(records.active_steps)
    table = {name: np.concatenate([row[name] for row in rows], axis=1) for name in rows[0]}
    return carries, table, np.stack(active, axis=1)


@functools.cache
def played(name: str):
    return play(EXPERIMENTS[name], lanes_of())


def carries_of(name: str) -> PlanningState:
    """The last carries of an experiment."""
    return played(name)[0][-1]


def plain(tree):
    """A tree of NumPy arrays, keys as their data."""
    is_key = lambda leaf: jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)  # noqa: E731
    return jax.tree.map(lambda leaf: np.asarray(jax.random.key_data(leaf) if is_key(leaf) else leaf), tree)


def noises(carries) -> np.ndarray:
    """What the readings added to the poses, `[step, lane, axis]`."""
    return np.stack([np.asarray(carry.belief - carry.world) for carry in carries])


@each_experiment
def test_rows_are_valid_until_the_episode_is_done_and_not_after(name):
    _, table, active = played(name)
    valid, done = table["valid"], table["done"]
    assert np.all(valid[:, 0])
    np.testing.assert_array_equal(valid[:, 1:], valid[:, :-1] & ~done[:, :-1])
    np.testing.assert_array_equal(np.sum(valid & done, axis=1), 1)
    np.testing.assert_array_equal(active, valid)


@each_experiment
def test_rewards_add_up_to_the_return(name):
    carries, table, _ = played(name)
    summary = summary_of(EXPERIMENTS[name], carries[-1])
    steps = table["valid"].sum(axis=1)
    total = np.cumsum(np.where(table["valid"], table["reward"], 0.0), axis=1)
    np.testing.assert_allclose(
        table["accumulated_reward"][table["valid"]], total[table["valid"]], rtol=1e-13, atol=1e-12
    )
    last = table["accumulated_reward"][np.arange(NUM_LANES), steps - 1]
    np.testing.assert_array_equal(summary["return"], last)
    np.testing.assert_array_equal(summary["steps"], steps)
    counted = np.where(table["valid"], table["step"], 0)
    expected = np.arange(1, table["step"].shape[1] + 1)
    np.testing.assert_array_equal(counted, np.where(table["valid"], expected[None], 0))


def test_what_a_planner_measures_is_a_mean_over_the_steps_of_a_run():
    experiment = EXPERIMENTS["disc-measured"]
    carries, table, _ = played("disc-measured")
    summary = summary_of(experiment, carries[-1])
    valid = table["valid"]
    assert 1 < valid.sum(axis=1).max() < valid.shape[1]
    believed = np.stack([np.asarray(carry.belief)[:, 0] for carry in carries[:-1]], axis=1)
    expected = np.sum(np.where(valid, believed, 0.0), axis=1) / valid.sum(axis=1)
    np.testing.assert_allclose(summary["believed_x"], expected, atol=1e-12)
    assert [column.name for column in experiment.tables["runs"]][-1] == "believed_x"
    assert "believed_x" not in summary_of(EXPERIMENTS["disc-straight"], carries_of("disc-straight"))


def test_success_and_exits_are_those_of_the_steps():
    for name, succeeded, left in [("parking", 1000.0, -1000.0), ("parking-on", 1000.0, -1000.0)]:
        carries, table, _ = played(name)
        summary = summary_of(EXPERIMENTS[name], carries[-1])
        rewards = np.where(table["valid"], table["reward"], 0.0)
        np.testing.assert_array_equal(summary["success"], np.any(rewards == succeeded, axis=1))
        np.testing.assert_array_equal(summary["exits"], np.sum(rewards == left, axis=1))
        assert np.sum(summary["exits"]) > 0
    assert np.any(summary["exits"] > 1)  # where leaving does not end the episode


def test_an_episode_ends_with_its_task_or_after_its_last_step():
    carries, table, _ = played("disc-straight")
    success, steps = np.asarray(carries[-1].record.success), np.asarray(carries[-1].step)
    # From two metres away and heading for the centre: in the disc of 0.3 m with the second path.
    np.testing.assert_array_equal(steps, 2)
    assert np.all(success)
    carries, _, _ = played("disc")
    success, steps = np.asarray(carries[-1].record.success), np.asarray(carries[-1].step)
    assert 0 < success.sum() < NUM_LANES
    np.testing.assert_array_equal(steps[~success], EXPERIMENTS["disc"].max_advances)
    assert np.all(np.asarray(carries[-1].is_done))


@each_experiment
def test_a_finished_lane_stays_as_it_is(name):
    carries, table, active = played(name)
    for step, (before, after) in enumerate(zip(carries[:-1], carries[1:], strict=True)):
        finished = np.asarray(before.is_done)
        for one, other in zip(jax.tree.leaves(plain(before)), jax.tree.leaves(plain(after)), strict=True):
            np.testing.assert_array_equal(one[finished], other[finished])
        assert not np.any(table["valid"][finished, step])
        assert np.all(active[finished, step] == 0)
    assert np.all(np.asarray(carries[-2].is_done))


def test_every_planner_meets_the_same_start_and_the_same_noise():
    (one, one_table, _), (other, other_table, _) = played("disc"), played("disc-straight")
    np.testing.assert_allclose(one[0].world, other[0].world, atol=1e-14)
    np.testing.assert_allclose(one[0].belief, other[0].belief, atol=1e-14)
    both = (one_table["valid"] & other_table["valid"]).T
    assert np.all(both[0]) and np.mean(both[1]) > 0.5
    np.testing.assert_allclose(noises(one)[1:][both], noises(other)[1:][both], atol=1e-12)
    assert np.mean(np.any(np.asarray(one[1].world != other[1].world), axis=1)) > 0.9


def test_what_the_planner_draws_does_not_depend_on_the_noise_of_the_world():
    quiet, noisy = (
        PlanningEpisode(parking(position_noise=noise, heading_noise=noise), RandomPlanner(kernel()))
        for noise in (0.0, 0.5)
    )
    one, other = (play(experiment, lanes_of())[0][-1].record.paths for experiment in (quiet, noisy))
    np.testing.assert_allclose(one, other, atol=1e-9)
    assert np.any(np.isfinite(one))


def test_no_two_draws_share_a_key(monkeypatch):
    keys = []

    def note(cls, name):
        method = getattr(cls, name)

        def noted(self, key, *args):
            keys.append(jax.random.key_data(key))
            return method(self, key, *args)

        monkeypatch.setattr(cls, name, noted)

    for cls, name in ((GoalDisc, "reset"), (GoalDisc, "prior"), (GoalDisc, "execute"), (Straight, "plan")):
        note(cls, name)

    @jax.jit
    def keys_of(disc, motions, key):
        experiment = PlanningEpisode(disc, Straight(motions))
        carry = experiment.init(key)
        del keys[2]  # a drive is traced for its shapes there, and not made
        for _ in range(3):
            carry, _ = experiment.advance(carry)
        return jnp.stack(keys)

    found = keys_of(goal_disc(), splines(5), jax.random.key(0))
    assert len(np.unique(found, axis=0)) == len(found) == 2 + 2 * 3


def test_key_reuse_is_checked_here():
    # What makes all tests of this folder tests of how keys are used: a key used twice raises.
    key = jax.random.key(0)
    jax.random.normal(key)
    with pytest.raises(jax.errors.KeyReuseError):
        jax.random.normal(key)


@each_experiment
def test_carries_keep_their_types_and_columns_are_those_that_the_tables_announce(name):
    experiment = EXPERIMENTS[name]
    before = jax.eval_shape(experiment.init, jax.random.key(0))
    after, records = jax.eval_shape(experiment.advance, before)
    rows, summary = records.tables["steps"], jax.eval_shape(experiment.summary, after)
    assert not any(leaf.weak_type for leaf in jax.tree.leaves((before, after, records, summary)))
    described = [jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), tree) for tree in (before, after)]
    assert eqx.tree_equal(*described)
    announced = experiment.tables
    assert set(records.tables) == set(announced) - {"runs"}
    assert set(rows) == {*column_names(announced["steps"]), "valid"}
    assert set(summary) == set(column_names(announced["runs"]))
    for column in announced["steps"]:
        assert rows[column.name].shape == (1,) and rows[column.name].dtype == column.dtype
    for column in announced["runs"]:
        assert summary[column.name].shape == () and summary[column.name].dtype == column.dtype


@pytest.mark.parametrize("name", by_tier(["parking", "parking-on", "disc", "disc-straight"], normal=NORMAL))
def test_the_paths_driven_are_kept(name):
    carries, table, _ = played(name)
    [kept] = snapshot_of(EXPERIMENTS[name], carries[-1]).values()
    paths, steps = np.asarray(kept["paths"]), np.asarray(carries[-1].step)
    np.testing.assert_array_equal(kept["start"], carries[0].world)
    happened = np.arange(paths.shape[1])[None] < steps[:, None]
    assert np.all(np.isfinite(paths[happened])) and np.all(np.isnan(paths[~happened]))
    ends = np.stack([table["x"], table["y"]], axis=-1)[:, : paths.shape[1]]
    np.testing.assert_allclose(paths[happened][:, -1, :2], ends[happened], atol=1e-12)
    # Each path begins within one sample of where the path before it ended.
    before = np.concatenate([np.asarray(kept["start"])[:, None, :2], paths[:, :-1, -1, :2]], axis=1)
    gaps = np.linalg.norm(paths[:, :, 0, :2] - before, axis=-1)[happened]
    np.testing.assert_allclose(gaps, 1.0 / 8.0, atol=0.01)


def test_without_noise_the_reward_is_the_planned_one():
    problem = parking(position_noise=0.0, heading_noise=0.0)
    _, table, _ = play(PlanningEpisode(problem, RandomPlanner(kernel())), lanes_of())
    valid = table["valid"]
    np.testing.assert_allclose(table["planned_reward"][valid], table["reward"][valid], atol=1e-9)
    _, noisy, _ = played("parking")
    assert np.mean(noisy["planned_reward"][noisy["valid"]] == noisy["reward"][noisy["valid"]]) < 0.5


@pytest.mark.parametrize("name", by_tier(["field", "field-myopic"], normal=NORMAL))
def test_on_a_field_all_samples_are_kept_and_nothing_else(name):
    carries, table, _ = played(name)
    kept = snapshot_of(EXPERIMENTS[name], carries[-1])
    assert set(kept) == {"paths", "belief"}
    samples, paths = np.asarray(kept["belief"]["samples"]), np.asarray(kept["paths"]["paths"])
    counts = np.asarray(carries[-1].belief.posterior.count)
    at_samples = eqx.filter_jit(FIELD.values)(f64(samples[..., :2].reshape(-1, 2)))
    values = np.asarray(at_samples).reshape(samples.shape[:2])
    assert len(np.unique(counts)) > 1 or name == "field-myopic"
    for lane in range(NUM_LANES):
        number = counts[lane]
        assert np.all(np.isfinite(samples[lane, :number])) and np.all(np.isnan(samples[lane, number:]))
        # A robot that was stopped repeats its pose: samples were taken at the others.
        at = paths[lane, :, :, :2].reshape(-1, 2)
        begins = np.linalg.norm(samples[lane, :number, None, :2] - at, axis=-1).min(axis=1)
        np.testing.assert_allclose(begins, 0.0, atol=1e-12)
        noise = samples[lane, :number, 2] - values[lane, :number]
        assert number == 0 or np.abs(noise).max() < 0.1 * 5.5


@pytest.mark.parametrize("name", by_tier(["field", "field-myopic"], normal=NORMAL))
def test_on_a_field_the_paid_reward_is_the_planned_one_and_all_is_finite(name):
    carries, table, _ = played(name)
    # Nothing ends an episode but its last step; the row after it is nobody's.
    assert np.all(table["valid"][:, :-1])
    np.testing.assert_allclose(table["planned_reward"], table["reward"], rtol=1e-9, atol=1e-9)
    summary = summary_of(EXPERIMENTS[name], carries[-1])
    for column, values in (table | summary).items():
        assert np.all(np.isfinite(values)), column
    assert np.all(summary["rmse"] > 0.0) and np.all(summary["wrmse"] <= summary["rmse"])
    if name == "field":
        assert summary["collisions"].sum() > 0 and summary["exits"].sum() > 0
        assert 0 < summary["success"].sum() < NUM_LANES


class Broken(GoalDisc):
    """A world whose simulation diverges on the way to success."""

    def execute(self, key, world, path):
        after, reading, events = super().execute(key, world, path)
        yes = jnp.ones((), bool)
        return after, reading, dataclasses.replace(events, success=yes, exited=yes, failed=yes)


def test_a_run_that_diverges_is_no_success():
    whole = goal_disc()
    names = ("radius", "position_noise", "heading_noise", "max_steps")
    problem = Broken(**{name: getattr(whole, name) for name in names})
    experiment = PlanningEpisode(problem, RandomPlanner(kernel()))

    @jax.jit
    def one_step(key):
        after, _ = experiment.advance(experiment.init(key))
        return after, experiment.summary(after)

    after, summary = one_step(jax.random.key(0))
    assert bool(after.is_done) and np.isnan(summary["return"])
    assert not bool(summary["success"]) and int(summary["exits"]) == 0


@pytest.mark.parametrize("motions", [kernel(), splines(5)], ids=["kernel", "splines"])
def test_trajectories_that_the_robot_cannot_follow_are_refused(motions):
    def episode(radius, farthest):
        vehicle = Wide(radius, farthest)
        problem = eqx.tree_at(lambda problem: problem.vehicle, parking(), vehicle)
        return PlanningEpisode(problem, RandomPlanner(motions))

    tightest = tightest_radius(motions)
    episode(0.99 * tightest, 1.0)
    assert_refused(
        [
            (lambda: episode(0.0, 0.9), "^planner.motions.length: got 1; allowed: <= 0.90, "),
            (
                lambda: episode(1.01 * tightest, 1.0),
                "^planner.motions: the tightest trajectory has a radius of",
            ),
        ]
    )


def test_the_tightest_radius_of_a_set_is_that_of_its_sharpest_curve():
    # x = -0.33 u^2 + 0.71 u, y = 0.52 u^2, scaled to 1 m.
    u = np.linspace(0.0, 1.0, 10001)
    x, y = 0.71 - 0.66 * u, 1.04 * u
    speed = np.hypot(x, y)
    radius = speed**3 / np.abs(x * 1.04 - y * -0.66)
    length = np.sum(0.5 * (speed[1:] + speed[:-1])) / 10000
    assert tightest_radius(splines(5)) == pytest.approx(radius.min() / length, rel=2e-3)
    assert tightest_radius(splines(5, length=2.0)) == pytest.approx(2.0 * tightest_radius(splines(5)))


def test_the_tightest_radius_of_a_continuous_family_is_below_that_of_all_its_curves():
    assert tightest_radius(kernel(first_angle=0.0, turn_angle=0.0)) > 1e3
    params = jnp.asarray(np.random.default_rng(0).uniform(-1.0, 1.0, (500, 3)))
    headings = np.asarray(jax.jit(jax.vmap(kernel().path))(params))[..., 2]
    turns = np.diff(np.concatenate([np.zeros((500, 1)), np.unwrap(headings)], axis=1), axis=1)
    assert tightest_radius(kernel()) <= 1.0 / 8.0 / np.abs(turns).max()


def test_the_tightest_radius_of_paths_that_are_stored_is_that_of_their_poses():
    turn = np.linspace(0.1, 1.0, 10)
    arc = np.stack([0.5 * np.sin(2.0 * turn), 0.5 * (1.0 - np.cos(2.0 * turn)), 2.0 * turn], axis=-1)
    motions = Stored(length=f64(1.0), poses=f64(arc[None]), num_samples=10)
    assert tightest_radius(motions) == pytest.approx(0.5)
