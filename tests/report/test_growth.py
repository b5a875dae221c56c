"""Laws of growth: the fits of SciPy, laws that hold exactly, resamples at once."""

import numpy as np
import pytest
import scipy.optimize

from bojax.report.growth import LAWS, errors_of, fit

X = np.array([2.0, 5.0, 9.0, 14.0, 20.0])
CURVES = {
    "linear": lambda x, a, b: a + b * x,
    "quadratic": lambda x, a, b: a + b * x**2,
    "exponential": lambda x, a, b: a * np.exp(b * x),
}
TRUTH = {"linear": (4.0, 3.0), "quadratic": (-3.0, 2.1), "exponential": (3.0, 0.25)}


@pytest.mark.parametrize("law", LAWS)
def test_a_law_that_holds_is_found_exactly(law):
    means = CURVES[law](X, *TRUTH[law])
    found = fit(law, X, means, 0.05 * np.abs(means))
    assert (float(found.a), float(found.b)) == pytest.approx(TRUTH[law], rel=2e-3)
    np.testing.assert_allclose(found(X), means, rtol=5e-3)
    assert found.misfit < 0.05


@pytest.mark.parametrize("law", LAWS)
def test_the_fit_is_scipys_weighted_least_squares(law):
    random = np.random.default_rng(3)
    means = CURVES[law](X, *TRUTH[law]) * (1 + 0.1 * random.normal(size=X.size))
    errors = 0.05 * means * random.uniform(0.5, 2.0, size=X.size)
    found = fit(law, X, means, errors)
    theirs, _ = scipy.optimize.curve_fit(CURVES[law], X, means, p0=TRUTH[law], sigma=errors)
    squares = np.mean(((CURVES[law](X, *theirs) - means) / errors) ** 2)
    # The rate of the exponential is that of a grid: the squares tell how near it is.
    assert float(found.misfit) ** 2 == pytest.approx(squares, rel=2e-3)
    assert (float(found.a), float(found.b)) == pytest.approx(tuple(theirs), rel=2e-2)


@pytest.mark.parametrize("law", LAWS)
def test_resamples_are_fitted_one_by_one(law):
    means = np.random.default_rng(0).uniform(5, 50, size=(3, X.size)).cumsum(axis=1)
    errors = np.full(X.size, 2.0)
    together = fit(law, X, means, errors)
    for row, misfit in zip(means, together.misfit, strict=True):
        assert float(fit(law, X, row, errors).misfit) == pytest.approx(float(misfit), rel=2e-2)


def test_a_decreasing_exponential_has_a_negative_rate():
    means = CURVES["exponential"](X, 40.0, -0.1)
    found = fit("exponential", X, means, 0.05 * means)
    assert float(found.b) == pytest.approx(-0.1, rel=0.01)
    assert str(found).startswith("40.") and "exp(\N{MINUS SIGN}0." in str(found)


def test_errors_are_standard_errors_with_a_floor():
    values = np.array([[9.0, 10.0], [11.0, 10.0], [np.nan, 10.0]])
    first, second = errors_of(values)
    assert first == pytest.approx(np.sqrt(2.0 / 2 + 0.5**2))
    assert second == pytest.approx(0.5)  # what never varies is still known to 5% only


def test_laws_are_written_with_their_coefficients():
    means = 4.0 + 3.0 * X
    assert str(fit("linear", X, means, np.ones(5))) == "4.00 + 3.00 x"
    assert str(fit("quadratic", X, 50 - 0.1 * X**2, np.ones(5))) == "50.0 \N{MINUS SIGN} 0.100 x²"
    assert str(fit("linear", X, X - 8, np.ones(5))) == "\N{MINUS SIGN}8.00 + 1.00 x"
