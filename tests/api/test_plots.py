"""Figures of models show what the models predict."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bojax
from bojax.acquisition.bayesian_optimisation import BayesianOptimisation
from bojax.models.estimators import GaussianProcessRegressor
from bojax.models.gaussian_process import GaussianProcess
from tests.refusals import assert_refused


@pytest.fixture(scope="module")
def gp():
    return jax.jit(
        lambda x, y: GaussianProcess.fit({"kind": "rbf", "lengthscale": 0.7}, 0.01, x, y, capacity=5)
    )(jnp.asarray([[-1.0], [0.2], [1.0]]), jnp.asarray([0.5, 1.0, -1.0]))


@pytest.fixture(scope="module")
def search():
    search = BayesianOptimisation("rbf", "log-ei", 1e-4, [0, -1], [2, 1], 4, num_candidates=16)

    @jax.jit
    def told(key):
        state = search.tell(search.init(key), [0.5, 0.0], 10.0)
        return search.tell(state, [1.5, 0.5], 30.0)

    return search, told(jax.random.key(0))


def test_a_process_on_a_line_is_drawn_as_it_predicts(gp):
    picture = bojax.plot_gp(gp, -2, 2, samples=2, acquisition="ucb")
    above, below = picture.figure.axes
    *draws, mean = above.lines
    x = np.asarray(mean.get_xdata())
    expected, variance = jax.jit(GaussianProcess.predict)(gp, jnp.asarray(x)[:, None])
    np.testing.assert_allclose(mean.get_ydata(), expected, atol=1e-12)
    assert (x[0], x[-1]) == (-2.0, 2.0) and len(draws) == 2
    band = above.collections[0].get_paths()[0].vertices
    np.testing.assert_allclose(band[:, 1].max(), np.max(expected + 1.96 * np.sqrt(variance)), atol=1e-9)
    np.testing.assert_allclose(below.lines[0].get_ydata(), expected + 10.0 * np.sqrt(variance), atol=1e-9)
    observed = above.collections[1].get_offsets()
    np.testing.assert_allclose(observed, [[-1.0, 0.5], [0.2, 1.0], [1.0, -1.0]])
    assert picture.png.startswith(b"\x89PNG") and "2 joint draws" in picture.caption


def test_a_search_in_two_dimensions_is_drawn_in_the_units_of_the_objective(search):
    picture = bojax.plot_search(*search)
    mean, std, score = picture.figure.axes[:3]
    values = np.asarray(mean.collections[0].get_array())
    # Both observations are points of the grid; rows are the second input.
    np.testing.assert_allclose([values[20, 10], values[30, 30]], [10.0, 30.0], atol=0.1)
    assert np.asarray(std.collections[0].get_array())[30, 30] < 0.5
    np.testing.assert_allclose(mean.collections[1].get_offsets(), [[0.5, 0.0], [1.5, 0.5]])
    assert len(score.collections) == 3 and "a cross marks its maximum" in picture.caption


def test_improvement_over_no_observation_is_the_same_everywhere():
    picture = bojax.plot_gp(GaussianProcess.prior("rbf", 1, 2, 1), 0, 1, acquisition="ei")
    score = picture.figure.axes[1].lines[0].get_ydata()
    assert np.isfinite(score).all() and np.ptp(score) == 0.0


def test_what_cannot_be_drawn_is_refused_in_one_line(gp):
    prior, plot = GaussianProcess.prior, bojax.plot_gp
    assert_refused(
        [
            (lambda: plot(gp, 2, 1), r"low, high: got 2.0 and 1.0; allowed: low < high"),
            (lambda: plot(gp, [0, 0], 1), r"low, high: got shapes \(2,\) and \(\); allowed: 1 numbers"),
            (lambda: plot(gp, acquisition=3), "acquisition: got 3; allowed: an instance of Acquisition"),
            (lambda: plot(gp, samples=-1), "samples: got -1; allowed: an integer >= 0"),
            (lambda: plot(gp, acquisition="eii"), 'unknown acquisition; .*did you mean "ei"'),
            (lambda: plot(prior("rbf", 1, 2, 1)), "low, high: required for a process"),
            (lambda: plot(prior("rbf", 1, 2, 3), 0, 1), "3 dimensions is not drawn"),
            (lambda: plot(prior("rbf", 1, 2, 2), 0, 1, samples=1), "samples: got 1"),
            (lambda: plot(GaussianProcessRegressor()), "has not been fitted"),
            (lambda: plot((gp, None)), "gp: got tuple; allowed: a GaussianProcess"),  # as `relearn` returns
        ]
    )
