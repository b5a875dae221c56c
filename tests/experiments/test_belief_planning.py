"""Episodes of planners on state problems."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.config.errors import ConfigError
from bojax.config.sweep import load_config
from bojax.engine.build import build
from bojax.numerics.lanes import LANES

SMALL = ["planner.iterations=12", "num_particles=64", "problem.max_steps=6", "planner.depth=4"]


def experiment(name: str, *changes: str):
    """The experiment of a shipped config with a tiny budget."""
    config = load_config(name, [*SMALL, *changes]).points[0].config
    return build(config, "float32")


def advanced(episode, lanes: int, length: int = 6):
    """The carries and the rows of all lanes, advanced together."""
    keys = jax.vmap(lambda run: jax.random.fold_in(jax.random.key(3), run))(jnp.arange(lanes))
    carry = jax.vmap(episode.init, axis_name=LANES)(keys)
    advance = jax.jit(jax.vmap(episode.advance, axis_name=LANES))
    rows = []
    for _ in range(length):
        carry, records = advance(carry)
        rows.append(jax.tree.map(np.asarray, records.tables["steps"]))
    return carry, jax.tree.map(lambda *each: np.concatenate(each, axis=1), *rows)


@pytest.mark.parametrize("name", ["vdp-tag", "light-dark"])
def test_returns_are_those_of_the_steps_and_lanes_differ(name):
    episode = experiment(name)
    carry, rows = advanced(episode, 5)
    summary = jax.tree.map(np.asarray, jax.vmap(episode.summary)(carry))
    discounts = float(episode.problem.discount) ** np.arange(6)
    for lane in range(5):
        rewards = np.where(rows["valid"][lane], rows["reward"][lane], 0.0)
        np.testing.assert_allclose(summary["return"][lane], rewards.sum(), rtol=1e-5)
        np.testing.assert_allclose(summary["discounted_return"][lane], rewards @ discounts, rtol=1e-5)
        assert summary["steps"][lane] == rows["valid"][lane].sum()
        np.testing.assert_allclose(
            rows["accumulated_reward"][lane][rows["valid"][lane]],
            rewards.cumsum()[rows["valid"][lane]],
            rtol=1e-5,
        )
    states = np.stack([value for key, value in rows.items() if key.startswith("state_")])
    assert len({states[:, lane].tobytes() for lane in range(5)}) == 5
    assert np.isfinite(states).all() and np.isfinite(rows["planned_value"]).all()


def test_a_finished_lane_keeps_its_state():
    episode = experiment("light-dark", "problem.moves=[0]")  # every episode stops at once
    carry, rows = advanced(episode, 3, length=3)
    assert rows["valid"].sum(axis=1).tolist() == [1, 1, 1] and (np.asarray(carry.step) == 1).all()
    assert set(np.asarray(carry.accumulated).tolist()) <= {100.0, -100.0}


def test_planners_face_the_same_initial_states():
    first = [advanced(experiment("vdp-tag", *planner), 3, 1)[1] for planner in ([], ["planner=pft-dpw"])]
    starts = [
        np.asarray(jax.vmap(experiment("vdp-tag", *words).init)(jax.random.split(jax.random.key(0), 3)).state)
        for words in ([], ["planner=pft-dpw"])
    ]
    np.testing.assert_array_equal(*starts)
    assert all(rows["valid"].all() for rows in first)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        (
            "vdp-tag",
            ["planner.leaf_value=state-value"],
            "planner.leaf_value: got state-value; the problem has no values",
        ),
        (
            "light-dark",
            ["planner=pomcpow", "planner.leaf_value.policy=to-next-ml"],
            "does not fit the problem",
        ),
        ("vdp-tag", ["planner=vomcpow", "planner.proposal.variance=[1,1,1]"], "does not fit the problem"),
    ],
)
def test_a_planner_that_needs_what_the_problem_lacks_is_refused(name, changes, message):
    with pytest.raises((ConfigError, ValueError), match=message):
        experiment(name, *changes)
