"""The exploration state of every episode under each schedule (thesis, Section 5.5)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.learning import settings


def exploration_states(schema, num=12, reached=False, dtype="float64"):
    """Scale and is_learning of the first episodes."""
    schedule = build(schema, dtype)
    episodes = jnp.arange(num, dtype=jnp.int32)
    found = jax.vmap(lambda e: schedule(e, jnp.asarray(reached)))(episodes)
    return np.asarray(found.scale), np.asarray(found.is_learning)


@pytest.mark.parametrize("rate", [0.0, 1e-3, 0.1, 1e4, 1e5])
def test_decay_is_1_over_1_plus_c_t_with_t_the_episodes_before(rate):
    exploration, learns = exploration_states(settings.Decay(rate=rate))
    assert exploration == pytest.approx([1.0 / (1.0 + rate * t) for t in range(12)])
    assert exploration[0] == 1.0 and np.all(learns)


@pytest.mark.parametrize("final", [0.0, 0.2])
def test_linear_falls_to_its_final_share_and_stays_there(final):
    exploration, learns = exploration_states(settings.Linear(episodes=4, final=final))
    falling = [1.0, 0.75, 0.5, 0.25, *[0.0] * 8]
    assert exploration == pytest.approx([final + (1.0 - final) * share for share in falling])
    assert np.all(learns)


@pytest.mark.parametrize("learns_without", [True, False])
def test_a_budget_explores_then_does_not_and_can_go_on_after_a_pause(learns_without):
    for resume_after, again in ((None, [0.0] * 5), (4, [1.0] * 5)):
        schema = settings.Budget(episodes=3, resume_after=resume_after, learns_without=learns_without)
        exploration, learns = exploration_states(schema)
        expected = [1.0] * 3 + [0.0] * 4 + again
        assert exploration.tolist() == expected
        assert learns.tolist() == [learns_without or share == 1.0 for share in expected]


def test_constant_explores_and_learns_always_and_exploit_never():
    for schema, expected in (
        (settings.Constant(), True),
        (settings.Exploit(), False),
        (settings.Budget(episodes=0), False),
    ):
        exploration, learns = exploration_states(schema)
        assert np.all(exploration == expected) and np.all(learns == expected)


@pytest.mark.parametrize("learns_after", [True, False])
def test_until_target_explores_while_the_target_is_not_reached(learns_after):
    schema = settings.UntilTarget(learns_after=learns_after)
    for reached in (False, True):
        exploration, learns = exploration_states(schema, reached=reached)
        assert np.all(exploration == (0.0 if reached else 1.0))
        assert np.all(learns == (learns_after or not reached))
