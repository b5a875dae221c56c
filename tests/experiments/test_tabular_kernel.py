"""The kernel of tabular learners, which a CPU interprets, learns the tables of the program of XLA."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bojax.config.catalog  # noqa: F401 (registers every kind)
from bojax.engine.build import build
from bojax.envs.cliff_walking import CliffWalking
from bojax.envs.tabular import moved_to
from bojax.experiments import learning, phases, tabular_kernel
from bojax.experiments.settings import Learning
from bojax.experiments.tabular_kernel import kernel_of
from bojax.learning.tabular import AdditiveRewards, EpsilonGreedy
from bojax.numerics.lanes import LANES
from tests.compiling import REPEATABLY, as_for_a_gpu

CLIFF = {"kind": "cliff-walking", "slip": 0.2, "max_steps": 40}
TAXI = {"kind": "taxi", "max_steps": 40}
CHAIN = {"kind": "chain", "length": 5, "max_length": 8, "max_steps": 30}
FIRST = {"kind": "exploration-values", "ties": "first", "bootstrap": "policy", "kappa": 2.0}
UNCERTAIN = {"kind": "exploration-values", "exploration_reward": "next-uncertainty"}

RUNS = {
    "greedy": {"env": TAXI, "learner": FIRST},
    "at random": {"env": CHAIN, "learner": "epsilon-greedy", "dtype": "float32", "starts": "per-run"},
    "in tests, too": {
        "env": CHAIN,
        "learner": UNCERTAIN,
        "tests_learn": "exploring",
        "stop": "first-success",
    },
    "slipping": {"env": CLIFF, "learner": "additive", "schedule": "until-target", "target_return": 0.5},
}


class Broken(CliffWalking):
    """Returns states that do not exist in the first column, and no number in the second."""

    def outcome(self, state, action, branch):
        found, column = super().outcome(state, action, branch), state % 12
        reward = jnp.where((column == 1) & (action == 3), jnp.nan, found.reward)
        missing = jnp.where(state >= 36, 99, -1)
        after = jnp.where((column == 0) & (action == 3), missing, found.observation)
        return moved_to(after, reward, found.terminated)


def run_of(env=CLIFF, **settings):
    settings = {"learner": "epsilon-greedy", "episodes": 4, "tests": 2, "dtype": "float64"} | settings
    return build(Learning(env=env, **settings), settings["dtype"])


def history(run, lanes=3):
    """The states of some lanes after each episode, and the valid rows of all tables."""
    keys = jax.random.split(jax.random.key(1), lanes)
    carry = jax.jit(jax.vmap(run.init, axis_name=LANES))(keys)
    advance = jax.jit(jax.vmap(run.advance, axis_name=LANES), compiler_options=REPEATABLY)
    found = []
    for _ in range(run.episodes):
        carry, records = advance(carry)
        for rows in records.tables.values():
            is_valid = np.asarray(rows["valid"])
            found += [np.asarray(column, float)[is_valid] for column in rows.values()]
        state = eqx.tree_at(lambda c: c.key, carry, replace_fn=jax.random.key_data)
        found += [np.asarray(leaf, float) for leaf in jax.tree.leaves(state)]
    return carry, found


def both(monkeypatch, run):
    """What is found with kernels and without, and how many kernels there were."""
    monkeypatch.setattr(learning, "run_episode", phases.run_in_blocks)
    by_xla = history(run)
    kernels = []

    def run_kernel(phase, episode):
        kernels.append(kernel_of(phase, episode))
        return kernels[-1](phase, episode)

    monkeypatch.setattr(tabular_kernel, "kernels_run_here", lambda: True)
    monkeypatch.setattr(learning, "run_episode", run_kernel)
    return history(run), by_xla, len(kernels)


@pytest.mark.parametrize("name", RUNS)
def test_a_kernel_learns_what_the_program_of_xla_does(monkeypatch, name):
    (carry, by_kernel), (_, by_xla), kernels = both(monkeypatch, run_of(**RUNS[name]))
    assert kernels in (2, 4)  # of training and of tests, which JAX 0.12 may trace twice
    assert len(np.unique(np.asarray(carry.learner.columns), axis=0)) == 3
    for found, expected in zip(by_kernel, by_xla, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_a_broken_environment_breaks_a_kernel_alike(monkeypatch):
    run = run_of(episodes=8)
    run = eqx.tree_at(lambda r: r.env, run, Broken(**vars(run.env)))
    (carry, by_kernel), (_, by_xla), _ = both(monkeypatch, run)
    assert carry.is_done.any()
    assert (carry.outside > 0).any()
    for found, expected in zip(by_kernel, by_xla, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


class Astray(EpsilonGreedy):
    """Chooses actions that there are not."""

    reads_one_row: ClassVar[bool] = True

    def act(self, key, state, observation, exploration):
        action, expected = super().act(key, state, observation, exploration)
        return jnp.where(action == 1, jnp.where(observation % 2 == 0, -1, 9), action), expected


def test_actions_that_there_are_not_are_not_learned(monkeypatch):
    run = run_of(tests=0)
    run = eqx.tree_at(lambda r: r.learner, run, Astray(**vars(run.learner)))
    (carry, by_kernel), (_, by_xla), _ = both(monkeypatch, run)
    assert (np.asarray(carry.learner.visits).sum((1, 2)) < np.asarray(carry.steps)).all()
    for found, expected in zip(by_kernel, by_xla, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


class Own(AdditiveRewards):
    """A user's learner, which may read the whole table."""


class OwnOfOneRow(EpsilonGreedy):
    """A user's learner that says that it does not."""

    reads_one_row: ClassVar[bool] = True


class OwnUpdate(EpsilonGreedy):
    """A user's learner with another update."""

    reads_one_row: ClassVar[bool] = True

    def observe(self, key, state, transition, exploration, step_in_block):
        return state


def test_what_is_a_kernel(monkeypatch):
    def is_kernel(run):
        carry = jax.eval_shape(run.init, jax.random.key(0))

        def begin(carry):
            phase = run.training(carry)
            episode = phase.begin(carry.learner, *run.reset(carry, phase), ~carry.is_done)
            found.append(kernel_of(phase, episode) is not None)
            return episode

        found = []
        jax.eval_shape(begin, carry)
        return found[0]

    run = run_of()
    assert is_kernel(run) == (jax.default_backend() == "gpu")
    monkeypatch.setattr(tabular_kernel, "kernels_run_here", lambda: True)
    assert is_kernel(run)
    assert is_kernel(eqx.tree_at(lambda r: r.learner, run, OwnOfOneRow(**vars(run.learner))))
    assert not is_kernel(eqx.tree_at(lambda r: r.learner, run, OwnUpdate(**vars(run.learner))))
    additive = run_of(learner="additive")
    assert not is_kernel(eqx.tree_at(lambda r: r.learner, additive, Own(**vars(additive.learner))))
    assert not is_kernel(run_of(action_repeat=2))
    assert not is_kernel(run_of(learner="dora"))
    monkeypatch.setattr(tabular_kernel, "MOST_SCALARS", 100)
    assert not is_kernel(run)


class Known(CliffWalking):
    """Goes from cell to cell, whatever the action is, and never ends."""

    def step(self, key, state, action):
        after = jnp.where(state == 5, jnp.int32(6), jnp.int32(5))
        return after, moved_to(after, jnp.ones((), self.slip.dtype), jnp.zeros((), bool))


class Rich(CliffWalking):
    """Has a text among its fields, and numbers of Python and truths in its state."""

    name: str = "rich"

    def reset(self, key):
        return super().reset(key), 0, jnp.zeros(2, bool)

    def observe(self, state):
        return state[0]

    def step(self, key, state, action):
        cell, time, seen = state
        after, found = super().step(key, cell, action)
        turn = jnp.select([time % 3 == 0, time % 3 == 1], [1, 2], 3)
        return (after, time + turn, jnp.maximum(seen, jnp.arange(2, dtype=jnp.int32) == after % 2)), found


class Chancy(CliffWalking):
    """Draws random numbers in the ways that users know."""

    def step(self, key, state, action):
        first, second, *rest = jax.random.split(key, 5)
        action = jnp.where(
            jax.random.bernoulli(rest[0], 0.2), jax.random.randint(first, (), 0, 4, jnp.int32), action
        )
        dtype = self.slip.dtype
        pushed = jax.random.choice(second, 3, p=jnp.asarray([0.7, 0.2, 0.1], dtype)).astype(jnp.int32)
        noise = jax.random.normal(rest[1], (), jnp.float32).astype(dtype) + jax.random.exponential(
            rest[2], (), dtype
        )
        after, found = super().step(jax.random.fold_in(key, pushed), state, action)
        return after, replace(found, reward=found.reward + 0.1 * noise)


@pytest.mark.parametrize("env", [CliffWalking, Known, Rich, Chancy])
def test_a_gpu_gets_the_kernel_and_a_cpu_the_loop(monkeypatch, env):
    """Triton's program is made on any machine, and compiled on a GPU."""
    run = run_of()
    run = eqx.tree_at(lambda r: r.env, run, env(**vars(run.env)))
    carry = jax.eval_shape(jax.vmap(run.init), jax.random.split(jax.random.key(0), 2))
    monkeypatch.setattr(tabular_kernel, "kernels_run_here", lambda: True)
    with as_for_a_gpu(monkeypatch):
        traced = jax.jit(jax.vmap(run.advance, axis_name=LANES)).trace(carry)
        for platform, is_kernel in (("cuda", True), ("cpu", False)):
            assert ("triton" in traced.lower(lowering_platforms=(platform,)).as_text()) == is_kernel


@pytest.mark.parametrize(
    ("env", "settings"),
    [(Known, {}), (Known, {"tests_learn": "exploiting"}), (Rich, {"tests": 0}), (Chancy, {"tests": 0})],
)
def test_what_is_known_of_a_step_is_known_to_a_kernel(monkeypatch, env, settings):
    rounding = 1e-6 if env is Chancy else 1e-12  # whose noise is drawn in 32 bits
    run = run_of(**settings)
    run = eqx.tree_at(lambda r: r.env, run, env(**vars(run.env)))
    (_, by_kernel), (_, by_xla), _ = both(monkeypatch, run)
    for found, expected in zip(by_kernel, by_xla, strict=True):
        np.testing.assert_allclose(found, expected, rtol=rounding, atol=rounding)
