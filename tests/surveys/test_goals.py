"""Weights of goals: a region, places near a threshold, and places that may be among the highest."""

import numpy as np
import pytest
from scipy.stats import norm

from bojax.surveys.goals import HIGHEST, Goal, parse_goal


def test_hot_spots_are_weighted_by_the_probability_of_being_among_the_highest():
    random = np.random.default_rng(0)
    mean, deviation = random.normal(size=500), random.uniform(0.1, 1.0, 500)
    weights = Goal("hotspots").weights(mean, deviation)
    assert weights.mean() == pytest.approx(HIGHEST)
    # Each weight is P(f > level) of one common level.
    levels = mean - deviation * norm.ppf(weights)
    np.testing.assert_allclose(levels, levels[0], rtol=1e-6)
    assert np.corrcoef(weights, mean)[0, 1] > 0.5


def test_known_hot_spots_are_the_highest_tenth():
    mean = np.arange(100.0)
    np.testing.assert_allclose(Goal("hotspots").weights(mean, np.full(100, 1e-3)), mean >= 90.0, atol=1e-6)


def test_a_threshold_is_weighted_by_the_straddle():
    mean, deviation = np.array([0.0, 4.0, 5.0, 9.0]), np.array([1.0, 1.0, 0.5, 3.0])
    expected = [0.0, 1.96 - 1.0, 1.96 * 0.5, 1.96 * 3.0 - 4.0]
    np.testing.assert_allclose(Goal("threshold", threshold=5.0).weights(mean, deviation), expected)


@pytest.mark.parametrize(
    "goal", [Goal("hotspots"), Goal("threshold", threshold=0.3), Goal("threshold", 99.0)]
)
def test_weights_are_even_without_knowledge(goal):
    weights = goal.weights(np.zeros(20), np.ones(20))
    assert np.ptp(weights) == 0.0 and weights[0] > 0.0


def test_goals_are_parsed():
    assert parse_goal("map") == ("map", "")
    assert parse_goal("threshold=-2.5") == ("threshold", "-2.5")
    assert parse_goal("region=a=b.geojson") == ("region", "a=b.geojson")
    for text in ("maps", "threshold", "threshold=", "threshold=deep", "threshold=nan", "region=", "map=1"):
        with pytest.raises(ValueError, match=r"^got .*; allowed: "):
            parse_goal(text)


def outcomes(mean, explained, number=400_000):
    """Means that samples may leave at each place: independent draws `[number, M]`."""
    return mean + np.sqrt(explained) * np.random.default_rng(1).standard_normal((number, len(mean)))


MEAN, VARIANCE = np.array([0.3, -0.5, 1.2, 0.9]), np.array([1.0, 0.5, 0.2, 0.8])
EXPLAINED = np.array([0.6, 0.45, 0.0, 0.79])


def test_the_loss_of_hot_spots_is_the_expected_improvement_over_the_highest_mean():
    for highest, given in ((MEAN.max(), ()), (0.2, (0.2,)), (1.4, (1.4,))):
        improvement = np.maximum(outcomes(MEAN, EXPLAINED) - highest, 0.0)
        found = Goal("hotspots").loss(MEAN, VARIANCE, EXPLAINED, *given)
        assert found == pytest.approx(-np.sqrt(np.mean(improvement**2)), rel=5e-3)


def test_the_loss_of_a_threshold_is_the_share_that_will_be_on_its_wrong_side():
    means = outcomes(MEAN, EXPLAINED)
    left = np.sqrt(VARIANCE - EXPLAINED)
    is_wrong = norm.cdf(-np.abs(means - 0.7) / left)  # of the field around the mean, given each outcome
    found = Goal("threshold", threshold=0.7).loss(MEAN, VARIANCE, EXPLAINED)
    assert found == pytest.approx(is_wrong.mean(), rel=2e-3)
    known = Goal("threshold", threshold=0.7).loss(MEAN, VARIANCE, VARIANCE)
    assert known == pytest.approx(0.0, abs=1e-3)


def test_losses_without_knowledge_fall_with_the_variance_that_is_explained():
    explained = np.random.default_rng(2).uniform(0.0, 1.0, (30, 50))
    mean, variance = np.zeros(50), np.ones(50)
    order = np.argsort(explained.mean(axis=1))
    for kind in ("map", "hotspots"):
        found = Goal(kind).loss(mean, variance, explained)
        np.testing.assert_array_equal(np.argsort(-found), order)
    np.testing.assert_allclose(
        Goal().loss(mean, variance, explained) ** 2, 1.0 - explained.mean(axis=1), rtol=1e-12
    )


@pytest.mark.parametrize("kind", ["hotspots", "threshold"])
def test_a_place_of_which_samples_tell_nothing_counts_for_nothing(kind):
    mean, variance = np.array([0.0, 3.0, -2.0]), np.ones(3)
    explained = np.array([[0.2, 0.3, 0.0], [0.2, 0.3, 1e-300]])
    with np.errstate(over="ignore"):
        none, hardly = Goal(kind, threshold=1.0).loss(mean, variance, explained)
    assert np.isfinite(none) and none == hardly
