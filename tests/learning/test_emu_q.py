"""EMU-Q: Algorithm 6 and the author's code in NumPy, the direct refit, and what the settings mean."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.envs.spaces import Box, Discrete
from bojax.learning import refit, refit_policy
from bojax.learning.base import Episode, Transition
from bojax.learning.features import FourierBasisMap, FourierFeatures
from bojax.learning.settings import (
    EMUQ,
    EMUQPublished,
    FourierBasisFeatures,
    NormalisedRBF,
    RandomFourierFeatures,
)
from bojax.numerics.lanes import LANES
from bojax.numerics.linalg import solve_large
from bojax.numerics.stragglers import LEAST
from tests.learning.probes import exploring
from tests.reference.emu_q import Algorithm6, DirectRefit, PublishedCode, StoredRewards
from tests.tiers import by_tier

NUM_STEPS = 40
OBSERVATIONS = Box(jnp.asarray([-1.0, -2.0]), jnp.asarray([1.0, 2.0]))
ACTIONS = Box(jnp.asarray([-3.0]), jnp.asarray([3.0]))
EXPLORING = exploring()
REFIT_SEED = 9


def transitions(seed: int = 0, num: int = NUM_STEPS) -> Transition:
    """A walk through the box, with two rewards and an absorbing state at its end."""
    rng = np.random.default_rng(seed)
    walk = np.clip(np.cumsum(rng.normal(size=(num + 1, 2)) * 0.3, axis=0), -1.2, 1.2)
    rewards = np.where(np.isin(np.arange(num), [num // 2, num - 1]), 1.0, 0.0)
    return Transition(
        jnp.asarray(walk[:-1]),
        jnp.asarray(rng.uniform(-3.0, 3.0, size=(num, 1))),
        jnp.asarray(rewards),
        jnp.asarray(walk[1:]),
        jnp.asarray(np.arange(num) == num - 1),
    )


def make(schema=EMUQ, **settings):
    features = settings.pop("features", {"num_features": 30})
    kind = "phase" if schema is EMUQPublished else "cos-sin"
    settings = {"draw_actions": "once", "num_actions": 5, "num_samples": 4, "block": 8, **settings}
    learner = build(schema(features=RandomFourierFeatures(**{"form": kind, **features}), **settings))
    init = eqx.filter_jit(online(learner).init)
    return learner, init(jax.random.key(1), OBSERVATIONS, ACTIONS, 4 * NUM_STEPS)


def online(learner):
    """The learner until an episode ends: learners that differ in their refits alone share its programs."""
    return dataclasses.replace(learner, refit="sweeps", max_sweeps=1, refit_block=1)


def observe_all(learner, state, steps: Transition, exploration):
    """The state after an episode's steps, before its end."""
    return _observe_all(online(learner), state, steps, exploration)


@eqx.filter_jit
def _observe_all(learner, state, steps, exploration):
    def one(i, state):
        step = jax.tree.map(lambda x: x[i], steps)
        state = learner.observe(
            jax.random.fold_in(jax.random.key(7), i), state, step, exploration, i % learner.block
        )
        flushed = learner.flush(state)
        is_full = i % learner.block == learner.block - 1
        return jax.tree.map(lambda a, b: jnp.where(is_full, a, b), flushed, state)

    return learner.flush(jax.lax.fori_loop(0, len(steps.reward), one, state))


@eqx.filter_jit
def end_episode(learner, state, episode, exploration, patched):
    """The state after the refit; `patched` is static, so that code that a test replaces is traced anew."""
    del patched
    return learner.end_episode(jax.random.key(REFIT_SEED), state, episode, exploration)


def learn(learner, state, steps: Transition, exploration=EXPLORING, patched: int = 0):
    """Observe all steps, then end the episode: the state before and after that."""
    online = observe_all(learner, state, steps, exploration)
    episode = Episode(steps, jnp.asarray(len(steps.reward), jnp.int32))
    return online, end_episode(learner, online, episode, exploration, patched)


def follow(reference, steps: Transition, after_step=None):
    rows = [np.asarray(leaf) for leaf in jax.tree.leaves(steps)]
    for i in range(len(rows[0])):
        reference.step(*(row[i] for row in rows))
    if after_step is not None:
        after_step(reference)
    reference.end_episode(*rows)


def numpy_features(state):
    return lambda states, actions: np.asarray(_phi(state.features, states, actions))


@eqx.filter_jit
def _phi(features, states, actions):
    return jax.vmap(features)(states, actions)


def reference_of(cls, learner, state, **settings):
    return cls(
        numpy_features(state),
        state.features.num_features,
        lambda: np.asarray(state.candidates),
        lambda: np.asarray(state.samples),
        alpha=float(learner.prior_precision),
        tolerance=float(learner.tolerance),
        max_sweeps=learner.max_sweeps,
        **settings,
    )


@pytest.mark.parametrize("alpha", [0.1, 0.001])
@pytest.mark.parametrize(
    ("schema", "cls", "settings"),
    [(EMUQ, Algorithm6, {}), (EMUQPublished, PublishedCode, {"lengthscale": 0.3})],
    ids=["thesis", "published"],
)
def test_is_the_numpy_version(schema, cls, settings, alpha):
    learner, state = make(schema, prior_precision=alpha, refit="sweeps")
    steps = transitions()
    reference = reference_of(cls, learner, state, **settings)
    online, after = learn(learner, state, steps)
    seen = {}
    follow(reference, steps, lambda r: seen.update(s=r.s, m_q=r.m_q, m_u=r.m_u))
    size = np.abs(seen["m_u"]).max()
    np.testing.assert_allclose(online.posterior.base, seen["s"], atol=1e-9 / alpha)
    np.testing.assert_allclose(online.posterior.mean[:, 0], seen["m_q"], atol=1e-9)
    np.testing.assert_allclose(online.posterior.mean[:, 1], seen["m_u"], atol=1e-9 * size)
    np.testing.assert_allclose(after.posterior.mean[:, 0], reference.m_q, atol=1e-9)
    np.testing.assert_allclose(
        after.posterior.mean[:, 1], reference.m_u, atol=1e-9 * np.abs(reference.m_u).max()
    )
    assert np.abs(after.posterior.mean - online.posterior.mean).max() > 1e-3  # the refit changes something


@pytest.mark.parametrize(("how", "cls"), [("sweeps", Algorithm6), ("direct", DirectRefit)])
def test_exploration_values_with_a_discount_and_bounds_of_their_own_are_the_numpy_versions(how, cls):
    settings = {"discount": 0.9, "u_discount": 0.7, "clips_u": True, "prior_precision": 0.01}
    learner, state = make(refit=how, **settings)
    reference = reference_of(cls, learner, state, gamma=0.9, u_gamma=0.7, clips_u=True)
    steps, start = transitions(), 200.0 * np.random.default_rng(0).normal(size=(2, 30))
    # Weights whose U leaves its bounds, -333 and 0, in both directions.
    state = eqx.tree_at(lambda state: state.posterior.mean, state, jnp.asarray(start.T))
    reference.m_q, reference.m_u = start
    reference.t_q, reference.t_u = start * learner.prior_precision
    phi = numpy_features(state)(*map(np.asarray, (steps.next_observation, steps.action)))
    assert reference.u(phi).min() < -333.3 and reference.u(phi).max() > 0.0
    online, after = learn(learner, state, steps)
    seen = {}
    follow(reference, steps, lambda r: seen.update(m_q=r.m_q, m_u=r.m_u))
    for mean, m_q, m_u in (
        (online.posterior.mean, seen["m_q"], seen["m_u"]),
        (after.posterior.mean, reference.m_q, reference.m_u),
    ):
        np.testing.assert_allclose(mean[:, 0], m_q, atol=1e-9 * np.abs(m_q).max())
        np.testing.assert_allclose(mean[:, 1], m_u, atol=1e-8 * np.abs(m_u).max())


@pytest.mark.parametrize(("rewards", "cls"), [("recomputed", Algorithm6), ("stored", StoredRewards)])
def test_a_second_episode_is_the_numpy_version_too(rewards, cls):
    learner, state = make(refit="sweeps", refit_rewards=rewards)
    reference = reference_of(cls, learner, state)
    first, second = transitions(0), transitions(1)
    _, after = learn(learner, state, first)
    _, after = learn(learner, after, second)
    follow(reference, first)
    rows = [np.asarray(leaf) for leaf in jax.tree.leaves(second)]
    for i in range(NUM_STEPS):
        reference.step(*(row[i] for row in rows))
    both = [np.concatenate([np.asarray(a), b]) for a, b in zip(jax.tree.leaves(first), rows, strict=True)]
    reference.end_episode(*both)
    assert int(after.memory.count) == 2 * NUM_STEPS
    np.testing.assert_allclose(after.posterior.mean[:, 0], reference.m_q, atol=1e-9)
    np.testing.assert_allclose(
        after.posterior.mean[:, 1], reference.m_u, atol=1e-9 * np.abs(reference.m_u).max()
    )


def test_stored_rewards_make_another_u_and_leave_with_the_memory():
    steps = transitions()
    after = []
    for rewards in ("recomputed", "stored"):
        learner, state = make(refit="direct", refit_rewards=rewards)
        after.append(learn(learner, state, steps)[1])
    assert after[0].stored is None
    assert int(after[1].stored.count) == NUM_STEPS
    q, u = np.abs(after[0].posterior.mean - after[1].posterior.mean).max(axis=0)
    assert q == 0.0 and u > 1e-3  # Q is fitted first, with the U of before
    kept = learner.policy_state(after[1])
    assert len(kept.stored.values) == len(kept.memory.rewards) == 1
    np.testing.assert_array_equal(kept.posterior.mean, after[1].posterior.mean)


def test_readings_of_terminal_states_are_one_program():
    readings = [{}, {"terminal_u": "bootstrap"}, {"terminal_u": "zero", "terminal_q": "bootstrap"}]
    assert len({jax.tree.structure(build(EMUQ(**reading))) for reading in readings}) == 1


@pytest.mark.parametrize("terminal_u", by_tier(["absorbing", "bootstrap", "zero"], normal=["bootstrap"]))
def test_sweeps_converge_to_the_direct_solution(terminal_u):
    # One candidate: the policy is given. With several, sweeps may go back and forth between policies.
    settings = {"terminal_u": terminal_u, "num_actions": 1, "discount": 0.9, "tolerance": 1e-10}
    steps = transitions()
    means = {}
    for how in ("sweeps", "direct"):
        learner, state = make(refit=how, max_sweeps=2000 if how == "sweeps" else 50, **settings)
        means[how] = learn(learner, state, steps)[1].posterior.mean
    np.testing.assert_allclose(means["sweeps"], means["direct"], atol=1e-7 * np.abs(means["direct"]).max())


@pytest.mark.parametrize("size", [512, 7])
def test_direct_solutions_are_those_of_numpy(monkeypatch, size):
    # All changed transitions at once, or in several parts.
    solved = []

    def counted(matrix, constants):
        jax.debug.callback(lambda: solved.append(1))
        return solve_large(matrix, constants)

    monkeypatch.setattr(refit, "solve_large", counted)
    monkeypatch.setattr(refit, "CHANGED_ON_CPU", size)
    features = {"num_features": 30, "action_lengthscale": 0.1, "state_lengthscale": 0.3}
    learner, state = make(refit="direct", tolerance=1e-6, features=features, draw_actions="always")
    steps, start = transitions(), 3.0 * np.random.default_rng(2).normal(size=(2, 30))
    state = observe_all(learner, state, steps, EXPLORING)
    state = eqx.tree_at(lambda state: state.posterior.mean, state, jnp.asarray(start.T))
    episode = Episode(steps, jnp.asarray(NUM_STEPS, jnp.int32))
    after = end_episode(learner, state, episode, EXPLORING, patched=size)
    jax.effects_barrier()

    candidates, samples = learner.actions(jax.random.split(jax.random.key(REFIT_SEED))[1], state)
    reference = reference_of(DirectRefit, learner, state)
    reference.candidates, reference.samples = lambda: np.asarray(candidates), lambda: np.asarray(samples)
    reference.s, (reference.m_q, reference.m_u) = np.asarray(state.posterior.base), start
    reference.end_episode(*(np.asarray(leaf) for leaf in jax.tree.leaves(steps)))
    assert 5 < reference.policies < learner.max_sweeps
    # One solution for each policy of Q; its last one is also that of U, unless the policies are irregular.
    assert len(solved) == reference.policies + (reference.growths == 2)
    np.testing.assert_allclose(after.posterior.mean[:, 0], reference.m_q, atol=1e-8)
    np.testing.assert_allclose(
        after.posterior.mean[:, 1], reference.m_u, atol=1e-9 * np.abs(reference.m_u).max()
    )


def unstable():
    """A learner, a state before its refit, and the transitions; most policies of its refits cycle."""
    features = {"num_features": 30, "action_lengthscale": 0.1, "state_lengthscale": 0.3}
    learner, state = make(refit="direct", tolerance=1e-6, features=features, draw_actions="always")
    steps = transitions()
    state = observe_all(learner, state, steps, EXPLORING)
    episode = Episode(steps, jnp.asarray(NUM_STEPS, jnp.int32))
    memory = state.memory.add(episode, jnp.asarray(True))
    return learner, eqx.tree_at(lambda state: state.memory, state, memory), steps


def test_rounding_does_not_decide_which_policy_of_a_cycle_is_returned():
    """From a policy of a cycle of two, the weights change by the same norm with each policy."""
    learner, state, steps = unstable()
    candidates, _ = learner.actions(jax.random.split(jax.random.key(REFIT_SEED))[1], state)
    reference = reference_of(DirectRefit, learner, state)
    reference.s = np.asarray(state.posterior.base)
    phi, (_, _, rewards, nexts, is_last) = numpy_features(state), map(np.asarray, jax.tree.leaves(steps))
    gain = reference.s @ phi(*map(np.asarray, (steps.observation, steps.action))).T
    discount = np.where(is_last, 0.0, reference.gamma)[:, None]
    cycles = []
    for seed in (3, 16, 26, 35, 38):
        reference.m_q, reference.m_u = 3.0 * np.random.default_rng(seed).normal(size=(2, 30))
        solved = []
        for _ in range(24):
            following = phi(nexts, reference.policy(nexts, np.asarray(candidates)))
            reference.m_q = np.linalg.solve(np.eye(30) - gain @ (discount * following), gain @ rewards)
            solved.append(reference.m_q)
        np.testing.assert_allclose(solved[-1], solved[-3], atol=1e-9)
        assert np.abs(solved[-1] - solved[-2]).max() > 0.1 * np.abs(solved[-1]).max()
        cycles.append((solved[-1], reference.m_u))
    means = np.stack(cycles).swapaxes(1, 2)

    @jax.jit
    def refitted(means, order, noise):
        def one(mean):
            memory = jax.tree.map(lambda x: x[order] if x.ndim else x, state.memory)
            memory = eqx.tree_at(
                lambda memory: memory.rewards, memory, memory.rewards * (1.0 + 1e-13 * noise)
            )
            before = eqx.tree_at(lambda s: (s.memory, s.posterior.mean), state, (memory, mean))
            key, kappa = jax.random.key(REFIT_SEED), jnp.asarray(reference.kappa)
            return learner.refitted(key, before, kappa, jnp.asarray(True))

        return jax.lax.map(one, means)

    rng, same = np.random.default_rng(0), np.arange(len(state.memory.rewards))
    for _ in range(6):
        order = np.concatenate([rng.permutation(NUM_STEPS), same[NUM_STEPS:]])
        changed = means * (1.0 + 1e-13 * rng.normal(size=means.shape))
        found = refitted(changed, order, rng.normal(size=len(same)))
        # The first policy comes again after two: the solution that it is greedy for is the start.
        np.testing.assert_allclose(found[..., 0], means[..., 0], atol=1e-8)


def test_refits_of_a_batch_are_those_of_single_runs():
    """Lanes need different numbers of policies and of iterations; the last ones are gathered.

    The policies of these refits do not become stable.
    """
    learner, state, _ = unstable()
    rng = np.random.default_rng(9)
    sizes = rng.choice([0.0, 3.0], LEAST, p=[0.9, 0.1])
    means = jnp.asarray(sizes[:, None, None] * rng.normal(size=(LEAST, 30, 2)))

    is_active = jnp.asarray(rng.random(LEAST) < 0.9)

    def refitted(given):
        mean, is_active = given
        before = eqx.tree_at(lambda state: state.posterior.mean, state, mean)
        return learner.refitted(jax.random.key(REFIT_SEED), before, jnp.asarray(1.0), is_active)

    alone = jax.jit(lambda given: jax.lax.map(refitted, given))((means, is_active))
    together = jax.jit(jax.vmap(refitted, axis_name=LANES))((means, is_active))
    np.testing.assert_allclose(together, alone, atol=1e-8)
    np.testing.assert_array_equal(together[~is_active], means[~is_active])


def test_values_of_greedy_actions_are_the_same_on_a_gpu(monkeypatch):
    learner, state = make()
    candidates = refit_policy.Candidates.of(learner, state, state.candidates, jnp.asarray(0.5))
    mean = jnp.asarray(np.random.default_rng(0).normal(size=(30, 2)))
    x = jax.vmap(state.features.state)(transitions().next_observation)
    on_cpu = candidates.values(mean, mean[:, 0])(x)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    np.testing.assert_allclose(candidates.values(mean, mean[:, 0])(x), on_cpu, rtol=1e-12)


@pytest.mark.parametrize("how", by_tier(["sweeps", "direct"], normal=["direct"]))
def test_blocks_of_a_refit_do_not_matter_nor_whether_features_are_stored_or_recomputed(monkeypatch, how):
    steps = transitions()
    means = [
        learn(*make(refit=how, refit_block=block), steps)[1].posterior.mean for block in (7, NUM_STEPS, 512)
    ]
    for name in ("NUM_STORED", "NUM_STORED_ON_CPU"):
        monkeypatch.setattr(refit_policy, name, 16)
    means.append(learn(*make(refit=how, refit_block=10), steps, patched=16)[1].posterior.mean)
    for mean in means[1:]:
        np.testing.assert_allclose(means[0], mean, atol=1e-9)


@pytest.mark.parametrize("schema", [EMUQ, EMUQPublished])
def test_without_learning_nothing_changes(schema):
    settings = {"refit_rewards": "stored"} if schema is EMUQ else {"refit": "sweeps"}
    learner, state = make(schema, **settings)
    _, state = learn(learner, state, transitions())
    online, after = learn(learner, state, transitions(1), exploring(is_learning=False))
    for before, now in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(before, now)
    assert int(online.memory.count) == NUM_STEPS


@eqx.filter_jit
def drawn(spec, seed):
    """Features of the two boxes."""
    return spec.draw(jax.random.key(seed), OBSERVATIONS, ACTIONS, jnp.dtype(jnp.float64))


@eqx.filter_jit
def products(features, state, action, actions, weights, matrix):
    """The features of a pair of state and action, and all that is made of the parts of both."""
    x, y, ys = features.state(state), features.action(action), jax.vmap(features.action)(actions)
    phis = jax.vmap(features.join, (None, 0))(x, ys)
    product, form = x @ features.split(weights, y), x @ features.mean_form(matrix, ys) @ x
    return features(state, action), phis, product, form, features.values(weights, state, actions)


def test_features_are_bilinear():
    zeros = jnp.zeros(200), jnp.zeros((200, 200))
    specs = (
        RandomFourierFeatures(num_features=200),
        RandomFourierFeatures(num_features=200, form="phase"),
        FourierBasisFeatures(order=2),
        NormalisedRBF(num_state_centres=12, num_action_centres=3),
    )
    s, a, actions = jnp.asarray([0.3, -1.1]), jnp.asarray([1.7]), jnp.asarray([[1.7], [-0.4], [2.9]])
    unit = np.concatenate(jax.jit(lambda s, a: (OBSERVATIONS.to_unit(s), ACTIONS.to_unit(a)))(s, a))
    for schema in specs:
        features = drawn(build(schema), 3)
        rng, number = np.random.default_rng(0), features.num_features
        weights, matrix = rng.normal(size=number), rng.normal(size=(number, number))
        made = products(features, s, a, actions, jnp.asarray(weights), jnp.asarray(matrix))
        phi, phis, product, form, values = (np.asarray(part) for part in made)
        np.testing.assert_allclose(weights @ phi, product, atol=1e-12)
        np.testing.assert_allclose(form, np.mean([phi @ matrix @ phi for phi in phis]), atol=1e-12)
        np.testing.assert_allclose(values, phis @ weights, atol=1e-12)
        if isinstance(features, FourierBasisMap):
            every = np.indices((3, 3, 3)).reshape(3, -1).T  # (5.23) of the action and both observations
            np.testing.assert_allclose(phi, np.cos(np.pi * every @ np.roll(unit, 1)), atol=1e-12)
        if isinstance(features, FourierFeatures):
            frequencies = np.concatenate([features.state_frequencies, features.action_frequencies], axis=1)
            angles = frequencies @ unit + np.asarray(features.phases)
            half = angles[: len(angles) // 2]
            waves = [np.cos(half), np.sin(half)] if features.has_sines else [np.cos(angles)]
            np.testing.assert_allclose(phi, features.amplitude * np.concatenate(waves), atol=1e-12)
    # Random Fourier features have unit norm, those of the published code about half of it.
    for form, norm, atol in (("cos-sin", 1.0, 1e-12), ("phase", 0.5, 0.1)):
        phi = products(
            drawn(build(RandomFourierFeatures(num_features=200, form=form)), 0), s, a, actions, *zeros
        )[0]
        np.testing.assert_allclose(np.sum(np.asarray(phi) ** 2), norm, atol=atol)


def test_indicators_are_a_table():
    spec = build(EMUQ(features={"kind": "indicators"})).features
    features = spec.draw(jax.random.key(0), Discrete(4), Discrete(3), jnp.dtype(jnp.float64))
    phi = features(jnp.asarray(2), jnp.asarray(1))
    np.testing.assert_array_equal(np.nonzero(phi)[0], [2 * 3 + 1])
    matrix = np.random.default_rng(0).normal(size=(12, 12))
    form = features.mean_form(jnp.asarray(matrix), jax.vmap(features.action)(jnp.arange(3)))
    pairs = 2 * 3 + np.arange(3)
    x = features.state(jnp.asarray(2))
    np.testing.assert_allclose(x @ form @ x, matrix[pairs, pairs].mean(), atol=1e-12)
    with pytest.raises(ValueError, match="discrete"):
        spec.draw(jax.random.key(0), OBSERVATIONS, Discrete(3), jnp.dtype(jnp.float64))


def test_refinement_never_makes_the_action_worse():
    learner, state = make()
    _, after = learn(learner, state, transitions())

    @eqx.filter_jit
    def act(learner, key):
        where = OBSERVATIONS.from_unit(jax.random.uniform(jax.random.clone(key), (2,)))
        action, _ = learner.act(key, after, where, EXPLORING)
        q, u = learner.values(after, where, action)
        return action, q + learner.exploration_weight * u

    gains, refined = [], make(refine_steps=12)[0]
    for seed in range(5):
        (_, coarse), (action, fine) = (act(each, jax.random.key(seed)) for each in (learner, refined))
        assert -3.0 <= float(action[0]) <= 3.0
        gains.append(float(fine - coarse))
    assert min(gains) >= -1e-12 and max(gains) > 0.0
