"""Learned hyper-parameters against scikit-learn's, against those that made the data, and at the limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process import kernels as sk

from bojax.models.evidence import maximise, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern32, Scaled
from bojax.models.means import ConstantMean
from bojax.numerics.linalg import noise_floor
from tests.refusals import assert_refused

BOUNDS = (1e-6, 1e6)
learn = eqx.filter_jit(relearn)
fit = eqx.filter_jit(GaussianProcess.fit)
evidence_of = jax.jit(GaussianProcess.log_marginal_likelihood)


def kernel(lengthscales=(0.5, 0.5), variance=1.0, dtype=jnp.float64) -> Scaled:
    return Scaled(RBF(jnp.asarray(lengthscales, dtype)), jnp.asarray(variance, dtype))


def posterior(x, y, capacity=None, noise_variance=0.1, dtype=jnp.float64) -> GaussianProcess:
    x, y = jnp.asarray(x, dtype), jnp.asarray(y, dtype)
    return fit(kernel(dtype=dtype), jnp.asarray(noise_variance, dtype), x, y, capacity=capacity)


def scikit_learn(x, y) -> GaussianProcessRegressor:
    """Ours, with five starts."""
    composite = sk.ConstantKernel(1.0, BOUNDS) * sk.RBF([0.5, 0.5], BOUNDS) + sk.WhiteKernel(0.1, BOUNDS)
    return GaussianProcessRegressor(composite, alpha=0.0, n_restarts_optimizer=4, random_state=0).fit(x, y)


def data(name: str):
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (25, 2))
    noise = rng.normal(size=25)
    return x, {
        "waves": np.sin(4.0 * x[:, 0]) + x[:, 1] ** 2 + 0.1 * noise,
        "one column": 100.0 * np.cos(3.0 * x[:, 1]) + noise,
        "noise": noise,
        "steps": np.sign(x[:, 0] + x[:, 1]) + 0.01 * noise,
    }[name]


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("name", ["waves", "one column", "noise", "steps"])
def test_explains_the_data_as_well_as_scikit_learn(name):
    x, y = data(name)
    gp, optimum = learn(posterior(x, y), jax.random.key(0))
    reference = scikit_learn(x, y)
    assert optimum.value > reference.log_marginal_likelihood_value_ - 1e-2
    np.testing.assert_allclose(evidence_of(gp), optimum.value, rtol=1e-9)
    # The same hyper-parameters mean the same evidence there.
    learned = [gp.kernel.variance, *gp.kernel.kernel.lengthscale, gp.noise_variance]
    theirs = reference.log_marginal_likelihood(np.log(np.asarray(learned)))
    np.testing.assert_allclose(optimum.value, theirs, rtol=0, atol=1e-7)
    assert np.all((np.asarray(learned) >= BOUNDS[0]) & (np.asarray(learned) <= BOUNDS[1]))


@pytest.fixture(scope="module")
def lanes():
    """Posteriors of 25, 8, 1 and no observations with room for 25, in a batch, before and after."""
    gps = [posterior(*(column[:num] for column in data("waves")), capacity=25) for num in (25, 8, 1, 0)]
    before = jax.tree.map(lambda *leaves: jnp.stack(leaves), *gps)
    keys = jax.random.split(jax.random.key(4), 4)
    return before, jax.jit(jax.vmap(lambda gp, key: relearn(gp, key, num_starts=6)))(before, keys)


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
def test_a_batch_learns_in_one_program(lanes):
    before, (after, optimum) = lanes
    evidences = jax.jit(jax.vmap(evidence_of))
    was, learned = evidences(before), evidences(after)
    np.testing.assert_allclose(learned, optimum.value, rtol=1e-9, atol=1e-12)
    assert np.all(learned[:3] > was[:3]) and np.all(optimum.is_finite)
    for lane, num in enumerate((25, 8)):
        reference = scikit_learn(*(column[:num] for column in data("waves")))
        assert learned[lane] > reference.log_marginal_likelihood_value_ - 1e-2


def test_without_observations_nothing_changes(lanes):
    before, (after, _) = lanes
    for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(new[3], old[3])


def test_observations_that_are_not_numbers_are_left_out():
    x, y = data("waves")
    fewer = np.arange(len(y)) != 3
    y[3] = np.nan
    gp, optimum = learn(posterior(x, y), jax.random.key(0))
    expected, _ = learn(posterior(x[fewer], y[fewer], capacity=25), jax.random.key(0))
    assert optimum.is_finite and gp.num_ignored == 1
    np.testing.assert_allclose(gp.noise_variance, expected.noise_variance, rtol=1e-3)


def test_a_learned_constant_mean_is_the_best_one():
    x, y = data("waves")
    shifted = posterior(x, y + 50.0)
    gp, _ = learn(shifted, jax.random.key(0), learn_mean=True)
    best = gp.mean.value
    for other in (best - 0.01, best + 0.01):
        assert evidence_of(eqx.tree_at(lambda gp: gp.mean.value, gp, other)) < evidence_of(gp)
    covariance = gp.kernel.gram(gp.x, gp.x) + gp.noise_variance * np.eye(len(y))
    weights = np.linalg.solve(covariance, np.ones(len(y)))
    np.testing.assert_allclose(best, weights @ (y + 50.0) / weights.sum(), rtol=1e-6)
    assert GaussianProcess.prior(kernel(), 0.1, 4, 2).with_constant_mean().mean.value == 0.0


def test_a_parameter_at_a_bound_has_not_converged():
    optimum = maximise_slope(jnp.asarray(1.0), jnp.asarray(2.0))
    assert optimum.is_at_bound == (True, False) and not optimum.has_converged
    inside = maximise_slope(jnp.asarray(0.0), jnp.asarray(2.0))
    assert not any(inside.is_at_bound) and inside.has_converged


@jax.jit
def maximise_slope(slope, peak):
    """A function that rises with its first parameter, for ever if the slope is not 0."""

    def objective(params):
        rises, has_peak = params
        logs = jnp.log(rises), jnp.log(has_peak / peak)
        return slope * logs[0] - (1.0 - slope) * logs[0] ** 2 - logs[1] ** 2

    return maximise(objective, (jnp.asarray(1.0), jnp.asarray(1.0)), jax.random.key(0), num_starts=2)


def test_a_learned_noise_below_the_floor_is_returned_as_the_floor():
    x = np.linspace(-1.0, 1.0, 12, dtype=np.float32)[:, None]
    gp = posterior(np.tile(x, 2), np.sin(x[:, 0]), dtype=np.float32)
    learned, _ = learn(gp, jax.random.key(0))
    floor = noise_floor(np.float32) * learned.kernel(learned.x[0], learned.x[0])
    np.testing.assert_allclose(learned.noise_variance, floor, rtol=1e-5)


def test_a_start_that_meets_nan_never_wins():
    # -(log p)^2, but NaN for p < 1/2, where many of the starting points are.
    def objective(p):
        return jnp.where(p["p"] < 0.5, jnp.nan, -(jnp.log(p["p"]) ** 2))

    def best(start):
        return maximise(objective, {"p": start}, jax.random.key(5), num_starts=16, spread=3.0)

    best = jax.jit(best)
    for start in (0.1, 30.0):  # the objective is NaN at 0.1
        optimum = best(jnp.asarray(start))
        np.testing.assert_allclose(optimum.params["p"], 1.0, atol=1e-2)
        assert optimum.has_converged
    # From here no start reaches a number: the first is returned, and said to be worth nothing.
    nowhere = best(jnp.asarray(1e-6))
    assert not nowhere.is_finite and not nowhere.has_converged
    assert nowhere.value == -jnp.inf and nowhere.params["p"] == 1e-6


def test_known_noise_and_the_mean_are_held_fixed():
    x, y = (jnp.asarray(column) for column in data("waves"))
    mean, noises = ConstantMean(jnp.asarray(1.0)), jnp.full((25,), 0.02)
    gp = fit(kernel(), jnp.asarray(0.3), x, y, mean=mean, noise_variances=noises)
    learned, optimum = learn(gp, jax.random.key(0), noise_variances=noises, num_starts=2)
    assert learned.noise_variance == 0.3 and eqx.tree_equal(learned.mean, mean)
    assert optimum.value > evidence_of(gp) + 0.1
    same = fit(learned.kernel, jnp.asarray(0.02), x, y, mean=mean)
    np.testing.assert_allclose(evidence_of(same), optimum.value, rtol=1e-9)


def test_a_prior_pulls_and_decides_where_the_data_are_silent():
    def log_prior(kernel, noise_variance):
        del noise_variance
        return norm.logpdf(jnp.log(kernel.lengthscale), jnp.log(0.7), 0.3)

    def learned(num):
        x, y = (jnp.asarray(column) for column in data("steps"))
        count = jnp.asarray(num, jnp.int32)
        gp = fit(Matern32(jnp.asarray(0.3)), jnp.asarray(0.1), x, y, count=count)
        gp, _ = learn(gp, jax.random.key(0), log_prior=log_prior, learn_noise=False, num_starts=3)
        assert gp.noise_variance == 0.1
        return gp.kernel.lengthscale

    np.testing.assert_allclose(learned(0), 0.7, rtol=1e-3)
    assert 0.01 < abs(np.log(learned(25) / 0.7)) < 1.0


def test_a_search_that_cannot_be_is_refused():
    gp, key = GaussianProcess.fit("rbf", 0.1, [0.0, 1.0], [1.0, 2.0]), jax.random.key(0)
    wrong = ((1.0, 0.1), (0.0, 1.0), (1.0, float("inf")))
    assert_refused(
        [
            (lambda: relearn(gp, key, num_starts=0), "num_starts: got 0; allowed: an integer >= 1"),
            (lambda: relearn(gp, key, num_steps=0), "num_steps: got 0; allowed: an integer >= 1"),
            *(
                (lambda b=b: relearn(gp, key, bounds=b), "bounds: got .*; allowed: 0 < low < high")
                for b in wrong
            ),
        ]
    )
