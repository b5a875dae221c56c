import numpy as np
import pytest
import scipy.stats

from bojax.report import statistics


def test_mean_interval_agrees_with_scipys_percentile_bootstrap():
    values = np.random.default_rng(0).exponential(size=120)
    ours = statistics.mean_interval(values)
    theirs = scipy.stats.bootstrap(
        (values,), np.mean, method="percentile", n_resamples=10_000, rng=np.random.default_rng(1)
    ).confidence_interval
    # Two Monte-Carlo estimates of the same quantiles: within a few hundredths of the interval's width.
    width = theirs.high - theirs.low
    assert ours.estimate == pytest.approx(values.mean())
    assert ours.low == pytest.approx(theirs.low, abs=0.03 * width)
    assert ours.high == pytest.approx(theirs.high, abs=0.03 * width)


def test_ratio_interval_agrees_with_scipys_paired_bootstrap():
    random = np.random.default_rng(0)
    denominator = random.gamma(4.0, size=100)
    numerator = 1.5 * denominator + random.gamma(4.0, size=100)
    ours = statistics.ratio_interval(numerator, denominator)
    theirs = scipy.stats.bootstrap(
        (numerator, denominator),
        lambda a, b, axis: np.mean(a, axis=axis) / np.mean(b, axis=axis),
        paired=True,
        method="percentile",
        n_resamples=10_000,
        rng=np.random.default_rng(1),
    ).confidence_interval
    width = theirs.high - theirs.low
    assert ours.estimate == pytest.approx(numerator.mean() / denominator.mean())
    assert ours.low == pytest.approx(theirs.low, abs=0.03 * width)
    assert ours.high == pytest.approx(theirs.high, abs=0.03 * width)


def test_means_that_may_be_zero_have_no_ratio():
    values = np.random.default_rng(0).normal(0.1, 1.0, size=50)
    assert np.isnan(statistics.ratio_interval(values, values + 5).low)
    assert np.isnan(statistics.ratio_interval(values + 5, values).low)


def test_bootstrap_is_the_same_every_time_whatever_the_block(monkeypatch):
    values = np.random.default_rng(0).normal(size=(50, 2))
    whole = statistics.bootstrap_means(values, resamples=300)
    np.testing.assert_array_equal(whole, statistics.bootstrap_means(values, resamples=300))
    assert whole.shape == (300, 2)
    monkeypatch.setattr(statistics, "_BLOCK_CELLS", 50 * 100)
    np.testing.assert_allclose(statistics.bootstrap_means(values, resamples=300), whole, rtol=1e-12)


def test_columns_are_resampled_together():
    column = np.random.default_rng(0).normal(size=40)
    means = statistics.bootstrap_means(np.stack([column, column + 1.0], axis=1), resamples=200)
    np.testing.assert_allclose(means[:, 1] - means[:, 0], 1.0, rtol=1e-12)


def test_many_rows_are_resampled_in_groups_with_the_same_distribution(monkeypatch):
    values = np.random.default_rng(0).lognormal(0.0, 1.2, size=12_345)
    grouped = statistics.bootstrap_means(values, resamples=4000)
    monkeypatch.setattr(statistics, "GROUPS", values.size)
    single = statistics.bootstrap_means(values, resamples=4000)
    assert grouped.mean() == pytest.approx(values.mean(), rel=1e-3)
    assert grouped.std() == pytest.approx(single.std(), rel=0.08)
    assert scipy.stats.skew(grouped) == pytest.approx(scipy.stats.skew(single), abs=0.15)


def test_rare_events_stay_rare_events_in_groups():
    flags = np.zeros(30_001)
    flags[[7, 20_000, 29_999]] = 1.0
    hits = np.round(statistics.bootstrap_means(flags) * flags.size)
    for count in range(6):  # three events, resampled: Poisson of mean 3
        assert np.mean(hits == count) == pytest.approx(scipy.stats.poisson.pmf(count, 3), abs=0.02)


def test_the_bootstrap_draws_no_more_than_its_groups(monkeypatch):
    drawn = []
    counts = statistics._counts
    monkeypatch.setattr(statistics, "_counts", lambda rows, *rest: drawn.append(rows) or counts(rows, *rest))
    statistics.bootstrap_means(np.arange(100_000.0), resamples=10)
    statistics.bootstrap_means(np.arange(1000.0), resamples=10)
    assert drawn == [statistics.GROUPS, 1000]
    assert statistics.resampled(1000) == "whole runs"
    assert "5,000 groups into which 100,000 runs" in statistics.resampled(100_000)


@pytest.mark.parametrize(("successes", "trials"), [(0, 200), (1, 7), (103, 200), (200, 200)])
def test_wilson_agrees_with_scipy(successes, trials):
    low, high = statistics.wilson(successes, trials)
    theirs = scipy.stats.binomtest(successes, trials).proportion_ci(method="wilson")
    assert float(low) == pytest.approx(theirs.low, abs=1e-12)
    assert float(high) == pytest.approx(theirs.high, abs=1e-12)


@pytest.mark.parametrize(
    ("counts", "bounds"),
    [
        # Newcombe (1998), Table II, method 10.
        ((56, 70, 48, 80), (0.0524, 0.3339)),
        ((9, 10, 3, 10), (0.1705, 0.8090)),
        ((5, 56, 0, 29), (-0.0381, 0.1926)),
        ((0, 10, 0, 20), (-0.1611, 0.2775)),
        ((10, 10, 0, 10), (0.6075, 1.0000)),
    ],
)
def test_differences_of_shares_are_those_that_newcombe_printed(counts, bounds):
    interval = statistics.share_difference(*counts)
    assert (interval.low, interval.high) == pytest.approx(bounds, abs=6e-5)
    assert interval.estimate == counts[0] / counts[1] - counts[2] / counts[3]


@pytest.mark.parametrize("second", [(2.95, 0.38, 20), (1.0, 5.0, 2), (3.0, 0.0, 20)])
def test_differences_of_means_agree_with_scipys_welch_test(second):
    first = (3.1, 0.6, 200)
    ours = statistics.welch_difference(first, second)
    theirs = scipy.stats.ttest_ind_from_stats(*first, *second, equal_var=False)
    # The t-test says how far 0 is from the difference; its interval ends where that is the quantile.
    error = (first[0] - second[0]) / theirs.statistic
    freedom = error**4 / sum((s**2 / n) ** 2 / (n - 1) for _, s, n in (first, second))
    half = scipy.stats.t.ppf(0.975, freedom) * error
    assert (ours.low, ours.high) == pytest.approx((ours.estimate - half, ours.estimate + half))
    is_significant = not ours.low <= 0 <= ours.high
    assert is_significant == (theirs.pvalue < 0.05)


def test_holm_tests_the_smallest_at_the_strictest_level_and_stops_at_the_first_kept():
    np.testing.assert_allclose(statistics.holm_levels([0.03, 0.001, 0.02], 0.06), [0.06, 0.02, 0.03])
    # 0.03 > 0.025 is kept, and so is 0.04 although 0.04 < 0.05.
    levels = statistics.holm_levels([0.04, 0.03], 0.05)
    np.testing.assert_allclose(levels, [0.025, 0.025])


def test_no_data_and_nan_have_no_interval():
    for values in ([], [1.0, float("nan")]):
        assert np.isnan(statistics.mean_interval(values).estimate)
    assert np.isnan(statistics.share_interval([]).low)


def test_a_band_of_shares_counts_only_the_runs_with_a_value():
    flags = [[0, 1, np.nan], [0, 1, np.nan], [1, np.nan, np.nan]]
    share, low, high = statistics.share_band(flags)
    np.testing.assert_allclose(share, [1 / 3, 1, np.nan])
    for column, (hits, trials) in enumerate([(1, 3), (2, 2), (0, 0)]):
        np.testing.assert_array_equal([low[column], high[column]], statistics.wilson(hits, trials))


def test_claims_figures_and_tables_share_the_resamples_of_equal_values(monkeypatch):
    drawn = []
    original = statistics.bootstrap_means
    monkeypatch.setattr(statistics, "bootstrap_means", lambda table: drawn.append(1) or original(table))
    values = np.random.default_rng(11).exponential(size=50)
    first = statistics.mean_interval(values), statistics.ratio_interval(values, values[::-1])
    assert len(drawn) == 2
    assert (
        statistics.mean_interval(values.tolist()),
        statistics.ratio_interval(values, values[::-1]),
    ) == first
    assert len(drawn) == 2
    assert statistics.mean_interval(values + 1e-12) != first[0] and len(drawn) == 3
