"""Bayesian linear regression against its closed form, scikit-learn, and the laws of conditioning."""

import functools
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from sklearn.linear_model import BayesianRidge, Ridge

from bojax.models.bayesian_linear_regression import (
    BayesianLinearRegression,
    log_marginal_likelihood,
    maximise_evidence,
)
from bojax.numerics.linalg import covariance_floor
from tests.reference import bayesian_linear_regression as reference
from tests.refusals import assert_refused
from tests.tiers import by_tier

PRIOR, NOISE = jnp.asarray(0.5), jnp.asarray(4.0)
BLOCKS = (0, 4)
fit = jax.jit(BayesianLinearRegression.fit)
prior_of = jax.jit(BayesianLinearRegression.prior, static_argnums=0, static_argnames=("num_targets", "block"))
evidence = jax.jit(log_marginal_likelihood)
best_precisions = jax.jit(maximise_evidence)
predict = eqx.filter_jit(BayesianLinearRegression.predict)
update = jax.jit(BayesianLinearRegression.update)
update_batch = jax.jit(BayesianLinearRegression.update_batch)
covariance_of = jax.jit(lambda model: model.covariance)
covariance_times = jax.jit(BayesianLinearRegression.covariance_times)
variances_and_product = jax.jit(BayesianLinearRegression.variances_and_product)
flush = jax.jit(BayesianLinearRegression.flush)
row = jax.jit(BayesianLinearRegression.row)
evidence_slopes = jax.jit(jax.grad(log_marginal_likelihood, argnums=(2, 3)))


def observations(num: int, num_features: int = 6, num_targets: tuple[int, ...] = (), seed: int = 0):
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(num, num_features))
    weights = rng.normal(size=(num_features, *num_targets))
    targets = features @ weights + 0.5 * rng.normal(size=(num, *num_targets))
    return features, targets


def clustered(num: int, num_features: int, spread: float, dtype, seed: int = 0):
    """Random Fourier features of points around 8 places, and a linear function of them."""
    rng = np.random.default_rng(seed)
    frequencies = rng.normal(size=(num_features // 2, 3)) / 0.3
    points = rng.uniform(-1.0, 1.0, (8, 3))[rng.integers(0, 8, num)] + spread * rng.normal(size=(num, 3))
    angles = points @ frequencies.T
    features = np.concatenate([np.cos(angles), np.sin(angles)], axis=1) / np.sqrt(num_features / 2)
    return features.astype(dtype), (features @ rng.normal(size=num_features)).astype(dtype)


@eqx.filter_jit
def condition(model: BayesianLinearRegression, features, targets, sample_weight=None):
    """The posterior after the observations, one after the other, flushed whenever the block is full."""
    block = max(1, len(model.rows))
    sample_weight = jnp.ones(len(features), features.dtype) if sample_weight is None else sample_weight

    def step(model, observation):
        features, target, weight = observation
        return update(model, features, target, sample_weight=weight), None

    def full_block(model, observations):
        return jax.lax.scan(step, model, observations)[0].flush(), None

    observations = (features, targets, sample_weight)
    whole = len(features) // block * block
    in_blocks = jax.tree.map(lambda a: a[:whole].reshape(-1, block, *a.shape[1:]), observations)
    model, _ = jax.lax.scan(full_block, model, in_blocks)
    return jax.lax.scan(step, model, jax.tree.map(lambda a: a[whole:], observations))[0]


def prior(num_features: int = 6, block: int = 0, num_targets: int | None = None) -> BayesianLinearRegression:
    return prior_of(num_features, PRIOR, NOISE, num_targets=num_targets, block=block)


def assert_same_posterior(one: BayesianLinearRegression, mean, covariance, rtol: float = 1e-12):
    np.testing.assert_allclose(one.mean, mean, atol=rtol * (1.0 + np.abs(mean).max()), rtol=0)
    np.testing.assert_allclose(covariance_of(one), covariance, atol=rtol * np.abs(covariance).max(), rtol=0)


def test_a_fit_is_the_closed_form():
    for num in (0, 1, 4, 30):
        for num_targets in ((), (2,)):
            features, targets = observations(num, num_targets=num_targets)
            expected = reference.posterior(features, targets, 0.5, 4.0)
            assert_same_posterior(fit(features, targets, PRIOR, NOISE), *expected)
    assert_same_posterior(update_batch(prior(), *observations(0)), np.zeros(6), np.eye(6) / 0.5, 1e-15)


# A full block, and a last one that is half full.
@pytest.mark.parametrize("num", by_tier([1, 4, 30, 31], normal=[4, 30]))
@pytest.mark.parametrize("num_targets", [(), (2,)])
@pytest.mark.parametrize("block", BLOCKS)
def test_one_observation_at_a_time_gives_the_batch_posterior_in_any_order(num, num_targets, block):
    features, targets = observations(num, num_targets=num_targets)
    for order in (np.arange(num), np.random.default_rng(1).permutation(num)):
        model = condition(prior(6, block, *num_targets), features[order], targets[order])
        assert_same_posterior(model, *reference.posterior(features, targets, 0.5, 4.0))
        np.testing.assert_array_equal(covariance_of(model), covariance_of(model).T)


# With blocks, a batch of one fills the block that is half full, and the next one fills several.
@pytest.mark.parametrize("sizes", by_tier([(30,), (1, 29), (10, 5, 15)], normal=[(1, 29)]))
@pytest.mark.parametrize("num_targets", [(), (2,)])
@pytest.mark.parametrize("block", BLOCKS)
def test_batches_of_any_size_give_the_same_posterior(sizes, num_targets, block):
    features, targets = observations(60, num_targets=num_targets)
    model = condition(prior(6, block, *num_targets), features[:30], targets[:30])  # leaves a block half full
    for start, size in zip(30 + np.cumsum((0, *sizes)), sizes, strict=False):
        now = slice(start, start + size)
        model = update_batch(model, features[now], targets[now])
    assert_same_posterior(model, *reference.posterior(features, targets, 0.5, 4.0), 1e-11)


@pytest.mark.parametrize("block", BLOCKS)
def test_predictions_are_those_of_scikit_learn(block):
    features, targets = observations(30)
    queries = observations(10, seed=1)[0]
    ridge = BayesianRidge(fit_intercept=False).fit(features, targets)
    alpha, beta = jnp.asarray(ridge.lambda_), jnp.asarray(ridge.alpha_)
    model = condition(BayesianLinearRegression.prior(6, alpha, beta, block=block), features, targets)
    mean, std = ridge.predict(np.asarray(queries), return_std=True)
    np.testing.assert_allclose(predict(model, queries, with_noise=True)[0], mean, rtol=1e-10)
    np.testing.assert_allclose(predict(model, queries, with_noise=True)[1], std**2, rtol=1e-10)
    np.testing.assert_allclose(predict(model, queries)[1], std**2 - 1.0 / ridge.alpha_, rtol=1e-9)
    shrunk = Ridge(ridge.lambda_ / ridge.alpha_, fit_intercept=False).fit(features, targets)
    np.testing.assert_allclose(model.mean, shrunk.coef_, rtol=1e-10)


@pytest.mark.parametrize("block", BLOCKS)
def test_the_covariance_times_many_features_is_one_product(block):
    features, targets = observations(30)
    model = condition(prior(6, block), features, targets)
    queries = observations(10, seed=1)[0]
    np.testing.assert_allclose(
        covariance_times(model, queries), queries @ covariance_of(model), rtol=1e-11, atol=1e-13
    )
    one = covariance_times(model, queries[0])
    np.testing.assert_allclose(one, covariance_of(model) @ queries[0], rtol=1e-11, atol=1e-13)
    variances, product = variances_and_product(model, queries)
    np.testing.assert_allclose(variances, predict(model, queries)[1], rtol=1e-11)
    np.testing.assert_allclose(product, one, rtol=1e-11, atol=1e-13)
    given = update(model, queries[0], targets[0], product=one)
    expected = update(model, queries[0], targets[0])
    assert_same_posterior(given, expected.mean, covariance_of(expected))


@pytest.mark.parametrize("block", BLOCKS)
def test_the_row_corrects_the_variances_for_the_next_observation(block):
    features, targets = observations(30)
    model = condition(prior(6, block), features, targets)
    queries = observations(10, seed=1)[0]
    before = predict(model, queries)[1]
    after = predict(update(model, features[0], targets[0]), queries)[1]
    corrected = before - (queries @ np.asarray(row(model, features[0]))) ** 2
    np.testing.assert_allclose(corrected, after, rtol=1e-12)
    assert np.all(after < before)


@pytest.mark.parametrize("block", BLOCKS)
def test_an_observation_without_weight_leaves_no_trace_whatever_it_holds(block):
    features, targets = observations(30)
    model = condition(prior(6, block), features, targets)
    nothing = np.asarray(0.0)
    for held, target in ((features[0], targets[0]), (np.full(6, np.nan), np.asarray(np.inf))):
        after = update(model, held, target, sample_weight=nothing)
        np.testing.assert_array_equal(after.mean, model.mean)
        queries = observations(10, seed=1)[0]
        np.testing.assert_array_equal(flush(after).mean, model.mean)
        np.testing.assert_allclose(predict(after, queries)[1], predict(model, queries)[1], rtol=1e-13)
        np.testing.assert_array_equal(row(model, held, sample_weight=nothing), 0.0)


@pytest.mark.parametrize("block", BLOCKS)
def test_weighted_observations_are_repeated_ones(block):
    features, targets = observations(8)
    times = np.asarray([0, 1, 2, 3, 0, 1, 1, 5])
    expected = reference.posterior(np.repeat(features, times, 0), np.repeat(targets, times, 0), 0.5, 4.0)
    features[0], targets[4] = np.nan, np.nan
    weight = times.astype(float)
    assert_same_posterior(condition(prior(6, block), features, targets, weight), *expected)
    assert_same_posterior(fit(features, targets, PRIOR, NOISE, sample_weight=weight), *expected)
    assert_same_posterior(update_batch(prior(6, block), features, targets, sample_weight=weight), *expected)


@pytest.mark.parametrize("block", BLOCKS)
def test_observations_that_are_not_finite_are_left_out_and_counted(block):
    features, targets = observations(30)
    seen = ~np.isin(np.arange(30), [6, 7, 8])
    expected = reference.posterior(features[seen], targets[seen], 0.5, 4.0)
    targets[6], targets[7], features[8, 2] = np.nan, -np.inf, np.inf
    for model in (
        condition(prior(6, block), features, targets),
        fit(features, targets, PRIOR, NOISE),
        update_batch(prior(6, block), features, targets),
    ):
        assert_same_posterior(model, *expected)
        assert model.num_ignored == 3 and flush(model).num_ignored == 3


def test_outside_of_jit_what_would_be_left_out_is_refused():
    features, targets = observations(3)
    model, holed = prior(6), np.where(np.arange(3) == 1, np.nan, targets)
    one_of_three = "targets: 1 of 3 numbers are not finite"
    assert_refused(
        [
            (lambda: model.update(features[0], np.nan), "targets: 1 of 1 numbers are not finite"),
            (lambda: model.update(np.inf * features[0], 1.0), "features: 6 of 6 numbers are not finite"),
            (lambda: model.update_batch(features, holed), one_of_three),
            (lambda: BayesianLinearRegression.fit(features, holed, 0.5, 4.0), one_of_three),
        ]
    )
    assert model.update(features[0], np.nan, sample_weight=0.0).num_ignored == 0


def test_a_noise_variance_below_the_floor_is_raised_with_a_warning():
    features, targets = observations(3)
    quiet = BayesianLinearRegression.prior(6, 0.5, 1e14)
    for call in (
        lambda: quiet.update(features[0], targets[0]),
        lambda: quiet.update_batch(features, targets),
        lambda: BayesianLinearRegression.fit(features, targets, 0.5, 1e14),
    ):
        with pytest.warns(UserWarning, match="noise_precision: a noise variance of 1e-14 is raised"):
            call()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prior(6).update(features[0], targets[0]).update_batch(features, targets)


def test_a_step_in_the_block_given_by_the_caller_changes_nothing():
    features, targets = observations(10)
    runs = np.stack([features, 2.0 * features])

    def flushed(features):
        def update(step, model):
            return model.update(features[step], jnp.asarray(targets)[step], step_in_block=step)

        return jax.lax.fori_loop(0, 10, update, prior(6, 10)).flush()

    models = jax.jit(jax.vmap(flushed))(runs)
    for lane, seen in enumerate(runs):
        expected = reference.posterior(seen, targets, 0.5, 4.0)
        assert_same_posterior(jax.tree.map(lambda leaf, at=lane: leaf[at], models), *expected)


def test_what_is_updated_more_often_than_the_block_is_long_forgets_the_oldest_rows():
    features, targets = observations(6)
    model = prior(6, 4)
    for phi, target in zip(features, targets, strict=True):
        model = update(model, phi, target)
    assert np.all(np.linalg.eigvalsh(covariance_of(model)) > 0.0)
    exact = reference.posterior(features, targets, 0.5, 4.0)[1]
    assert np.all(np.linalg.eigvalsh(covariance_of(model) - exact) > -1e-14)


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("repeated", [False, True])
def test_the_variance_is_never_negative_and_never_grows(block, dtype, repeated):
    features, targets = clustered(60, 20, 0.0 if repeated else 0.3, dtype)
    model = prior_of(20, jnp.asarray(0.1, dtype), jnp.asarray(10.0, dtype), block=block)
    variance = predict(model, features)[1]
    for i in range(60):
        model = update(model, features[i], targets[i])
        model = flush(model) if block and i % block == block - 1 else model
        before, variance = variance, predict(model, features)[1]
        assert np.all(variance >= 0.0)
        assert np.all(variance <= before + 200.0 * np.finfo(dtype).eps)
    assert np.all(variance < 0.1)


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize(
    "prior_precision, noise_precision",
    [(1e-6, 1e6), (1e-6, 1.0), (1.0, 1e6), (1e-6, 1e-6), (1e6, 1e6), (1e6, 1e-6)],
)
def test_extreme_precisions_keep_the_posterior(block, prior_precision, noise_precision):
    features, targets = clustered(60, 10, 0.3, jnp.float64)
    alpha, beta = jnp.asarray(prior_precision), jnp.asarray(noise_precision)
    # The only bound: a noise below the floor of its prior variance counts as that; features have length 1.
    seen = min(noise_precision, prior_precision / covariance_floor(jnp.float64))
    mean, covariance = reference.posterior(features, targets, prior_precision, seen)
    models = {
        "fit": fit(features, targets, alpha, beta),
        "rows": condition(prior_of(10, alpha, beta, block=block), features, targets),
        "batch": update_batch(prior_of(10, alpha, beta, block=block), features, targets),
    }
    for model in models.values():
        found_mean, variance = predict(model, features)
        expected = np.sum(features * (features @ covariance), axis=1)
        np.testing.assert_allclose(found_mean, features @ mean, atol=1e-4)
        # A difference from the prior variance keeps this many of its digits.
        np.testing.assert_allclose(variance, expected, rtol=1e-9, atol=1e-13 / prior_precision)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("way", ["fit", "batch"])
def test_observations_given_together_share_the_floor_of_the_noise(dtype, way):
    # Feature vectors of lengths from 0.03 to 1, nearly collinear, with noise far below the floor.
    rng = np.random.default_rng(4)
    features = rng.normal(size=(40, 4)) * 10.0 ** rng.uniform(-1.5, 0.0, (40, 1))
    features[:, 3] = features[:, 0] + features[:, 1] + 1e-3 * features[:, 3]
    features = (features / np.sqrt(np.max(np.sum(features**2, axis=1)))).astype(dtype)
    weights = rng.uniform(0.1, 1.0, 40).astype(dtype)
    targets = (features.astype(float) @ rng.normal(size=4) + 0.1 * rng.normal(size=40)).astype(dtype)
    alpha, beta = jnp.asarray(1e-2, dtype), jnp.asarray(1e15, dtype)
    if way == "fit":
        model = fit(features, targets, alpha, beta, sample_weight=weights)
    else:
        model = prior_of(4, alpha, beta)
        model = update_batch(model, features, targets, sample_weight=weights)
    exact = [np.asarray(values, np.float64) for values in (features, targets, weights)]
    longest = np.max(exact[2] * np.sum(exact[0] ** 2, axis=1))
    root = np.sqrt(exact[2] * 1e-2 / (covariance_floor(dtype) * longest))
    mean, covariance = reference.posterior(exact[0] * root[:, None], exact[1] * root, 1e-2, 1.0)
    found_mean, variance = predict(model, features)
    np.testing.assert_allclose(found_mean, exact[0] @ mean, atol=2e-4)
    expected = np.sum(exact[0] * (exact[0] @ covariance), axis=1)
    noise = covariance_floor(dtype) * longest / 1e-2
    np.testing.assert_allclose(variance, expected, atol=3e-3 * noise)


@pytest.mark.parametrize("prior_precision, bounds", [(0.1, (2e-3, 3e-4)), (1e-3, (3e-2, 8e-3))])
def test_a_block_keeps_more_digits_in_single_precision(prior_precision, bounds):
    # Relative errors of the variance, measured over three data sets: at most 6e-4 without a block and 1e-4
    # with one at the first precision, 1.1e-2 and 2.7e-3 at the second.
    features, targets = clustered(3000, 40, 0.05, jnp.float32)
    alpha, beta = jnp.asarray(prior_precision, jnp.float32), jnp.asarray(1.0, jnp.float32)
    seen = np.asarray(features, np.float64)
    precision = min(1.0, prior_precision / covariance_floor(jnp.float32))
    _, covariance = reference.posterior(seen, targets, prior_precision, precision)
    exact = np.sum(seen @ covariance * seen, axis=1)
    worst = []
    for block in (0, 16):
        model = condition(prior_of(40, alpha, beta, block=block), features, targets)
        variance = np.asarray(predict(model, features)[1])
        worst.append(np.abs(variance / exact - 1.0).max())
    assert worst[0] < bounds[0] and worst[1] < bounds[1]
    assert worst[1] < 0.5 * worst[0]


def test_a_batch_of_models_is_a_loop_with_a_shared_count_of_updates():
    alphas, weights = np.asarray([0.1, 1.0, 10.0]), np.asarray([1.0, 0.0, 1.0])
    data = [observations(10, seed=seed) for seed in range(3)]
    features, targets = (np.stack(column) for column in zip(*data, strict=True))

    def posterior(alpha, features, targets, weight):
        model = BayesianLinearRegression.prior(6, alpha, NOISE, block=4)
        return condition(model, features, targets, jnp.full(10, weight))

    batched, one = jax.jit(jax.vmap(posterior))(alphas, features, targets, weights), jax.jit(posterior)
    for lane in range(3):
        alone = one(alphas[lane], features[lane], targets[lane], weights[lane])
        np.testing.assert_allclose(batched.mean[lane], alone.mean, atol=1e-13)
        np.testing.assert_allclose(batched.base[lane], alone.base, atol=1e-13)
        np.testing.assert_allclose(batched.rows[lane], alone.rows, atol=1e-13)
    assert not np.any(batched.mean[1])


def test_an_update_has_no_branch():
    model, (features, targets) = prior(6, 4), observations(1)
    step = functools.partial(BayesianLinearRegression.update, sample_weight=jnp.asarray(1.0))
    program = jax.jit(step).lower(model, features[0], targets[0]).as_text()
    assert "stablehlo.case" not in program and "stablehlo.while" not in program


@pytest.mark.parametrize("num, num_features", [(0, 3), (1, 3), (4, 7), (30, 6)])
@pytest.mark.parametrize("precisions", [(0.5, 4.0), (10.0, 0.1), (1e-3, 1e3)])
def test_the_evidence_is_the_density_of_the_targets(num, num_features, precisions):
    features, targets = observations(num, num_features)
    alpha, beta = precisions
    found = evidence(features, targets, *map(jnp.asarray, precisions))
    np.testing.assert_allclose(
        found, -reference.negative_log_evidence(features, targets, alpha, beta), rtol=1e-9, atol=1e-14
    )
    if num:
        covariance = np.eye(num) / beta + features @ features.T / alpha
        expected = stats.multivariate_normal(np.zeros(num), covariance).logpdf(targets)
        # SciPy inverts this matrix, whose condition number is up to 1e8.
        np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.parametrize("num", [1, 4, 30])
@pytest.mark.parametrize("precisions", [(0.5, 4.0), (10.0, 0.1)])
def test_the_gradient_of_the_evidence_is_exact(num, precisions):
    features, targets = observations(num)
    alpha, beta = precisions
    found = evidence_slopes(features, targets, jnp.asarray(alpha), jnp.asarray(beta))
    np.testing.assert_allclose(found, reference.evidence_gradient(features, targets, alpha, beta), rtol=1e-9)


@pytest.mark.parametrize("num, num_features", [(30, 6), (20, 15), (15, 40)])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_best_precisions_are_those_of_scikit_learn(num, num_features, seed):
    features, targets = observations(num, num_features, seed=seed)
    alpha, beta = best_precisions(features, targets)
    flat = {"alpha_1": 0.0, "alpha_2": 0.0, "lambda_1": 0.0, "lambda_2": 0.0}
    ridge = BayesianRidge(max_iter=20000, tol=1e-14, fit_intercept=False, **flat).fit(features, targets)
    ours = evidence(features, targets, alpha, beta)
    theirs = evidence(features, targets, jnp.asarray(ridge.lambda_), jnp.asarray(ridge.alpha_))
    assert ours >= theirs - 1e-9
    if num > num_features:
        np.testing.assert_allclose((alpha, beta), (ridge.lambda_, ridge.alpha_), rtol=1e-6)


def test_units_of_the_targets_only_scale_the_precisions():
    features, targets = observations(30)
    for unit in (1e-6, 1e6):
        scaled = best_precisions(features, unit * targets)
        np.testing.assert_allclose(
            np.asarray(scaled) * unit**2, np.asarray(best_precisions(features, targets)), rtol=1e-6
        )


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("case", ["zeros", "no features", "one", "noiseless", "noise"])
def test_the_best_precisions_are_finite_whatever_the_data(case, dtype):
    features, targets = observations(12, 4)
    features, targets = {
        "zeros": (features, 0.0 * targets),
        "no features": (0.0 * features, targets),
        "one": (features[:1], targets[:1]),
        "noiseless": (features, features @ np.ones(4)),
        "noise": (features, np.random.default_rng(3).normal(size=12)),
    }[case]
    found = best_precisions(features.astype(dtype), targets.astype(dtype))
    assert all(precision.dtype == dtype for precision in found)
    assert np.all(np.isfinite(found)) and np.all(np.asarray(found) > 0.0)
    if case == "noiseless":
        np.testing.assert_allclose(found[1], 1.0 / (covariance_floor(dtype) * np.mean(targets**2)), rtol=1e-3)


def test_lists_and_python_numbers_are_as_good_as_arrays():
    def everything(features, targets, alpha, beta, weights, row, target, weight):
        model = BayesianLinearRegression.fit(features, targets, alpha, beta, sample_weight=weights)
        model = model.update(row, target, sample_weight=weight)
        model = model.update_batch(features, targets, sample_weight=weights)
        return model, model.predict(features), log_marginal_likelihood(features, targets, alpha, beta)

    given = [[1, 0], [0.5, 1]], [1, 2.5], 0.5, 4, (1, 0), [1, 2], np.float32(3.0), 2
    arrays = [jnp.asarray(value, float) for value in given]
    lists = jax.jit(lambda: everything(*given))()
    assert eqx.tree_equal(lists, jax.jit(everything)(*arrays), rtol=1e-12, atol=1e-12)


def test_inputs_of_the_wrong_shape_are_refused():
    model, three, fit = prior(2), [[1, 0], [0, 1], [1, 1]], BayesianLinearRegression.fit
    rows = r"targets: got shape \(2,\); allowed: 3 rows, one for each row of"
    assert_refused(
        [
            (lambda: fit(three, [1, 2], 1, 1), rows),
            (lambda: model.predict([[1]]), r"features: got shape \(1, 1\); allowed: \[points, 2\]"),
            (lambda: model.update([1, 2, 3], 0), r"features: got shape \(3,\); allowed: \[2\]"),
            (lambda: maximise_evidence(*map(jnp.asarray, observations(0))), "observations: got 0"),
            (lambda: prior(num_features=0), "num_features: got 0; allowed: an integer >= 1"),
            (lambda: prior(block=-1), "block: got -1; allowed: an integer >= 0"),
            (lambda: prior(num_targets=0), "num_targets: got 0; allowed: an integer >= 1"),
            (lambda: fit(three, [1, 2, 3], 0, 1), "prior_precision: got 0.0; allowed: a number > 0"),
            (lambda: fit(three, [1, 2, 3], 1, -1), "noise_precision: got -1.0; allowed: a number > 0"),
            (lambda: fit(three, [1, 2, 3], 1, 1, sample_weight=[1, -1, 1]), "sample_weight: got a negative"),
            (lambda: fit(three, [1, 2, 3], 1, 1, sample_weight=[1]), r"sample_weight: got shape \(1,\)"),
            (
                lambda: prior(block=2).update([1] * 6, 0, step_in_block=2),
                "step_in_block: got 2; allowed: from 0",
            ),
            (lambda: maximise_evidence([[1], [2]], [1, np.nan]), "targets: 1 of 2 numbers are not finite"),
        ]
    )
