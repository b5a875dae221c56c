"""What pictures and films draw of state problems, and what an episode records for them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.config.catalog import kinds
from bojax.engine.build import build
from bojax.experiments.planning import PlanningEpisode
from bojax.planning.belief_planner import PolicyPlanner
from bojax.problems.state_space import NUM_DRAWN
from tests.problems.test_state_checks import STATE_PROBLEMS, Line


@pytest.mark.parametrize("kind", STATE_PROBLEMS)
def test_a_state_is_drawn_within_its_scenery(kind):
    problem = build(kinds("problem")[kind]())
    outline = problem.outline()
    border = None if outline is None else outline.as_numbers()["border"]
    points = eqx.filter_jit(lambda key: problem.sketch(problem.initial(key)))(jax.random.key(0))
    assert {point.shape for point in points.values()} in ({(1,)}, {(2,)})
    if border is not None:
        for point in np.stack(list(points.values())):
            assert np.all(point >= border[:2]) and np.all(point <= border[2:])


def test_an_episode_records_the_true_states_and_its_beliefs():
    class Marching(Line):
        """Ends after the third step or so; the marker does not move."""

        __module__ = "bojax.problems.own"  # so that it is not checked, as classes of users are

        def sketch(self, state):
            return {"marker": jnp.full_like(state, 3.0), "x": state}

    episode = PlanningEpisode(
        Marching(num_particles=200), PolicyPlanner(lambda problem, key, belief: jnp.ones(1))
    )
    carry, states, means = eqx.filter_jit(episode.init)(jax.random.key(4)), [], []
    advance, snapshot = eqx.filter_jit(episode.advance), eqx.filter_jit(episode.snapshot)
    while not carry.is_done:
        states.append(float(carry.world[0]))
        means.append(float(carry.belief.mean[0]))
        carry, _ = advance(carry)
    states.append(float(carry.world[0]))
    sketch = snapshot(carry)["sketch"]
    num = len(states)
    assert 1 < num < 7 and set(sketch) == {"marker", "x"}
    assert sketch["x"].shape == (6, 1 + NUM_DRAWN, 1)
    assert np.all(sketch["marker"][:num] == 3.0) and np.all(np.isnan(sketch["marker"][num:]))
    np.testing.assert_array_equal(sketch["x"][:num, 0, 0], states)
    # The states that are drawn have the mean of the belief.
    np.testing.assert_allclose(sketch["x"][: num - 1, 1:, 0].mean(axis=1), means, atol=0.1)
