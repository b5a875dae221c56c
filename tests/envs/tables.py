"""Transition tables of our environments as NumPy arrays."""

from collections import Counter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np


def tables(env):
    """Probability `[S, A, K]` and transition `[S, A, K]`."""
    return jax.tree.map(np.asarray, eqx.filter_jit(lambda e: e.transitions())(env))


def branches(env):
    """Every pair's outcomes: `{(state, action): {(next state, reward, terminated): probability}}`."""
    probability, transition = tables(env)
    found = {}
    for pair in np.ndindex(probability.shape[:2]):
        outcomes = Counter()
        for k, p in enumerate(probability[pair]):
            index = (*pair, k)
            next_state = int(transition.observation[index])
            outcomes[next_state, float(transition.reward[index]), bool(transition.terminated[index])] += p
        found[pair] = {outcome: p for outcome, p in outcomes.items() if p > 0}
    return found


def frequencies(env, state, action, draws=4000, seed=0):
    """Outcomes of many steps from one pair, as `branches` gives them."""
    keys = jax.random.split(jax.random.key(seed), draws)
    step = eqx.filter_jit(eqx.filter_vmap(lambda k: env.step(k, jnp.int32(state), jnp.int32(action))))
    after, transition = step(keys)
    assert np.array_equal(after, transition.observation)
    outcomes = zip(
        np.asarray(after).tolist(),
        np.asarray(transition.reward).tolist(),
        np.asarray(transition.terminated).tolist(),
        strict=True,
    )
    return {outcome: count / draws for outcome, count in Counter(outcomes).items()}
