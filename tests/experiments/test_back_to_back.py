"""Training episodes that lanes begin on their own are those that all lanes begin together."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from bojax.config.catalog import named
from bojax.engine.build import build
from bojax.envs.base import Env, TimeStep
from bojax.envs.spaces import Box
from bojax.experiments import back_to_back
from bojax.learning.dora import DORA
from bojax.numerics.lanes import LANES
from tests.compiling import REPEATABLY


class Walk(Env):
    """A walk that ends outside of [-1, 1]; its state has numbers, and its step never ends from zeros."""

    power: Float[Array, ""]
    max_steps: int = eqx.field(static=True, default=40)

    @property
    def observation_space(self):
        return Box(-jnp.ones(1, self.power.dtype), jnp.ones(1, self.power.dtype))

    action_space = observation_space

    def reset(self, key):
        return {
            "place": jax.random.uniform(key, (1,), self.power.dtype, -0.9, 0.5),
            "size": 0.1,
            "has_moved": False,
        }

    def observe(self, state):
        return state["place"]

    def step(self, key, state, action):
        size = jnp.asarray(state["size"], self.power.dtype)
        force = jax.lax.while_loop(lambda x: x < 1.0, lambda x: 2.0 * x, size)
        noise = jax.random.normal(jax.random.fold_in(key, 0), (1,), self.power.dtype)
        place = state["place"] + 0.1 * self.power * force * (action + noise)
        outside, success = jnp.abs(place[0]) > 1.0, place[0] > 1.0
        step = TimeStep(place, success.astype(self.power.dtype), outside, jnp.zeros_like(outside), success)
        return {"place": place, "size": size, "has_moved": jnp.ones((), bool)}, step


def compiled(run):
    return jax.jit(jax.vmap(run.advance, axis_name=LANES), compiler_options=REPEATABLY)


def history(run, lanes=4, advances=None, advance=None):
    """Summaries and rows of all advances of some lanes, and the number of advances."""
    advance = advance or compiled(run)
    keys = jax.random.split(jax.random.key(3), lanes)
    carry = jax.jit(jax.vmap(run.init, axis_name=LANES))(keys)
    found, steps = [], np.zeros(lanes, int)
    for _ in range(advances or run.max_advances):
        if not advances and np.all(carry.is_done):
            break
        carry, records = advance(carry)
        found.append(jax.tree.map(np.asarray, records.tables))
        steps += np.asarray(records.active_steps)
    np.testing.assert_array_equal(steps, carry.steps)
    tables = [
        {
            name: {
                key: np.concatenate([f[name][key][lane][f[name]["valid"][lane]] for f in found]) for key in of
            }
            for name, of in found[0].items()
        }
        for lane in range(lanes)
    ]
    return carry, jax.jit(jax.vmap(run.summary))(carry), tables, len(found)


def run_of(learner, **settings):
    config = {"env": Walk(jnp.ones((), jnp.float64)), "learner": learner, "episodes": 12} | settings
    return build(named("experiment", {"kind": "learning", "dtype": "float64"} | config), "float64")


@pytest.mark.parametrize(
    ("learner", "settings"),
    [
        (
            {"kind": "rff-q", "features": {"num_features": 20}},
            {"stop": "first-success", "schedule": {"kind": "decay", "rate": 0.3}},
        ),
        ("dora", {"action_repeat": 3, "starts": "per-run"}),
        ({"kind": "bootstrapped-q", "width": 8}, {"episodes": 5}),
    ],
)
def test_episodes_do_not_depend_on_those_of_other_lanes(learner, settings, monkeypatch):
    monkeypatch.setattr(back_to_back, "MOST_STEPS", 150)
    run = run_of(learner, **settings)
    assert run.max_advances < run.episodes
    _, own, tables, few = history(run)
    together = run.one_by_one()
    assert together.max_advances == together.episodes
    _, expected, expected_tables, many = history(together)
    assert few < many
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9), own, expected)
    lengths = [len(of["episodes"]["length"]) for of in tables]
    assert len({tuple(of["episodes"]["length"]) for of in tables}) == len(tables) and max(lengths) > 1
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9), tables, expected_tables)


def test_an_advance_is_as_long_as_there_is_room_for_and_a_run_that_has_ended_stays_as_it_is(monkeypatch):
    monkeypatch.setattr(back_to_back, "MOST_EPISODES", 3)
    run = run_of("dora", env=Walk(jnp.asarray(0.01, jnp.float64), max_steps=2), episodes=8)
    advance = compiled(run)
    carry, _, tables, _ = history(run, advances=1, advance=advance)
    np.testing.assert_array_equal(carry.episode, 3)
    assert all(list(of["episodes"]["length"]) == [2, 2, 2] for of in tables)
    carry, _, _, _ = history(run, advances=3, advance=advance)
    np.testing.assert_array_equal(carry.episode, 8)
    assert run.max_advances == 3 and np.all(carry.is_done)
    after, records = advance(carry)
    assert not np.any(records.tables["episodes"]["valid"]) and not np.any(records.tables["steps"]["valid"])
    np.testing.assert_array_equal(records.active_steps, 0)
    before, after = (jax.tree.map(_plain, state) for state in (carry, after))
    jax.tree.map(np.testing.assert_array_equal, after, before)


def test_no_step_is_computed_of_a_state_that_was_never_reset(monkeypatch):
    monkeypatch.setattr(back_to_back, "MOST_STEPS", 80)
    run = run_of({"kind": "rff-q", "features": {"num_features": 6}}, episodes=200, stop="first-success")
    carry, _, _, num_advances = history(run, lanes=6)
    assert num_advances > 1 and len(np.unique(carry.episode)) > 2  # some runs had ended before


class Doubtful(DORA):
    """A learner whose `end_episode` may read the transitions."""

    def end_episode(self, key, state, episode, exploration):
        return super().end_episode(key, state, episode, exploration)


def test_a_learner_that_overrides_the_end_of_an_episode_gets_its_transitions():
    learner = run_of("dora").learner
    assert not learner.learns_from_episodes
    assert Doubtful(**vars(learner)).learns_from_episodes


def _plain(leaf):
    return jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf


@pytest.mark.parametrize(
    "settings",
    [
        {"learner": "emu-q"},  # refits after an episode
        {"tests": 1},
        {"map_episodes": [1]},
        {"env": Walk(jnp.ones((), jnp.float64), max_steps=1200)},  # two have no room
        {"env": "taxi", "learner": "epsilon-greedy"},  # an episode is a kernel
    ],
)
def test_lanes_end_their_episodes_together_where_that_is_better(settings):
    run = run_of(**({"learner": "dora"} | settings))
    assert run.max_advances == run.episodes and run.steps_per_advance == run.env.max_steps
