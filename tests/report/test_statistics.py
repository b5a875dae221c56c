import numpy as np
import pytest
import scipy.stats

from bojax.report import statistics


def test_intervals_agree_with_scipys_paired_percentile_bootstrap():
    random = np.random.default_rng(0)
    values, denominator = random.exponential(size=120), random.gamma(4.0, size=100)
    numerator = 1.5 * denominator + random.gamma(4.0, size=100)
    for interval, columns, statistic in (
        (statistics.mean_interval, (values,), np.mean),
        (
            statistics.ratio_interval,
            (numerator, denominator),
            lambda a, b, axis: np.mean(a, axis=axis) / np.mean(b, axis=axis),
        ),
    ):
        ours = interval(*columns)
        theirs = scipy.stats.bootstrap(
            columns,
            statistic,
            paired=len(columns) > 1,
            method="percentile",
            n_resamples=10_000,
            rng=np.random.default_rng(1),
        ).confidence_interval
        # Two Monte-Carlo estimates of the same quantiles: within a few hundredths of the interval's width.
        width = theirs.high - theirs.low
        assert ours.estimate == pytest.approx(statistic(*columns, axis=0))
        assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=0.03 * width)


def test_few_runs_have_the_t_interval_of_scipy():
    values = np.random.default_rng(0).exponential(size=8)
    ours = statistics.mean_interval(values)
    theirs = scipy.stats.t.interval(0.95, 7, values.mean(), scipy.stats.sem(values))
    assert (ours.low, ours.high) == pytest.approx(theirs)
    # A column with as many values has the same band, whatever other columns lack.
    table = np.vstack([np.stack([values, values], axis=1), [[np.nan, 1.0]] * 60])
    mean, low, high = statistics.mean_band(table)
    assert (mean[0], low[0], high[0]) == pytest.approx((values.mean(), *theirs))
    assert (low[1], high[1]) == pytest.approx(statistics.central(statistics.bootstrap_means(table[:, 1])))


def test_few_times_have_the_t_interval_of_the_logarithm_of_their_mean():
    """With the jackknife written out; it covers an exponential mean as often as it says, unlike Student's."""
    times = np.random.default_rng(1).exponential(300.0, size=5)
    left_out = np.log([np.delete(times, i).mean() for i in range(5)])
    half = scipy.stats.t.ppf(0.975, 4) * np.sqrt(4 / 5 * ((left_out - left_out.mean()) ** 2).sum())
    ours = statistics.time_interval(times)
    assert (ours.low, ours.high) == pytest.approx(times.mean() * np.exp([-half, half]))

    samples = np.random.default_rng(2).exponential(size=(2000, 5))
    for interval, low, high in ((statistics.time_interval, 0.92, 0.96), (statistics.mean_interval, 0.8, 0.9)):
        found = [interval(sample) for sample in samples]
        assert low < np.mean([each.low <= 1 <= each.high for each in found]) < high
        lowest = min(each.low for each in found)
        assert (lowest > 0) == (interval is statistics.time_interval)


def test_times_of_many_runs_and_no_times_have_the_interval_of_a_mean():
    times = np.random.default_rng(1).exponential(300.0, size=60)
    assert statistics.time_interval(times) == statistics.mean_interval(times)
    assert statistics.time_interval([0.0, 1.0, 2.0]) == statistics.mean_interval([0.0, 1.0, 2.0])
    assert np.isnan(statistics.time_interval([]).estimate)
    same = statistics.time_interval([7.0] * 4)
    assert (same.low, same.high) == (7.0, 7.0)


def test_the_ratio_of_few_runs_has_the_t_interval_of_its_logarithm():
    """The jackknife's error of a smooth statistic is that of its linearisation, up to order 1 / n."""
    random = np.random.default_rng(3)
    denominator = random.gamma(20.0, size=40)
    numerator = 1.5 * denominator + random.gamma(20.0, size=40)
    ours = statistics.ratio_interval(numerator, denominator)
    linear = numerator / numerator.mean() - denominator / denominator.mean()
    half = scipy.stats.t.ppf(0.975, 39) * scipy.stats.sem(linear)
    ratio = numerator.mean() / denominator.mean()
    assert (ours.low, ours.high) == pytest.approx((ratio * np.exp(-half), ratio * np.exp(half)), rel=2e-3)


# By number of runs: number of samples, and the least coverage of 95% intervals of an exponential mean in per
# cent. The percentile bootstrap covers 78.9, 85.8, 90.5, 93.5 and 94.7, Student's t 88.5, 89.8, 92.0, 94.0
# and 94.9. Three standard errors of the estimated coverage are left.
COVERAGE = {5: (20_000, 87.7), 10: (20_000, 89.0), 20: (20_000, 91.3), 50: (600, 90.5), 200: (600, 92.0)}


def test_intervals_of_a_skewed_mean_cover_it_as_often_as_the_documentation_says():
    random = np.random.default_rng(0)
    for size, (samples, least) in COVERAGE.items():
        # Each column is a sample; the bands of columns are the intervals of their means.
        _, low, high = statistics.mean_band(random.exponential(size=(size, samples)))
        assert 100 * np.mean((low <= 1) & (high >= 1)) > least, size


def test_a_single_run_has_no_interval():
    for interval in (
        statistics.mean_interval([3.0]),
        statistics.ratio_interval([3.0], [2.0]),
        statistics.iqm_interval([[3.0], [1.0, 2.0]]),
        statistics.improvement_interval([([3.0], [1.0, 2.0])], is_paired=False),
    ):
        assert np.isfinite(interval.estimate) and np.isnan([interval.low, interval.high]).all()
    assert statistics.mean_interval([3.0]).in_words() == ("3", "(no interval)")


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


def test_sorted_rows_are_dealt_into_groups_as_different_as_unsorted_ones():
    values = np.random.default_rng(0).exponential(size=20_000)
    width = np.ptp(statistics.central(statistics.bootstrap_means(np.sort(values), resamples=2000)))
    assert width == pytest.approx(2 * 1.96 * values.std() / np.sqrt(values.size), rel=0.06)


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


def test_wilson_agrees_with_scipy():
    for successes, trials in ((0, 200), (1, 7), (103, 200), (200, 200)):
        theirs = scipy.stats.binomtest(successes, trials).proportion_ci(method="wilson")
        ours = [float(bound) for bound in statistics.wilson(successes, trials)]
        assert ours == pytest.approx([theirs.low, theirs.high], abs=1e-12)


def test_differences_of_shares_are_those_that_newcombe_printed():
    """Newcombe (1998), Table II, method 10."""
    for counts, bounds in {
        (56, 70, 48, 80): (0.0524, 0.3339),
        (9, 10, 3, 10): (0.1705, 0.8090),
        (5, 56, 0, 29): (-0.0381, 0.1926),
        (0, 10, 0, 20): (-0.1611, 0.2775),
        (10, 10, 0, 10): (0.6075, 1.0000),
    }.items():
        interval = statistics.share_difference(*counts)
        assert (interval.low, interval.high) == pytest.approx(bounds, abs=6e-5)
        assert interval.estimate == counts[0] / counts[1] - counts[2] / counts[3]


def newcombe_paired(both, first, second, none):
    """Method 10 of Newcombe (1998, Statistics in Medicine 17, pp. 2635-2650) as it is written there."""
    n = both + first + second + none
    ours, theirs = both + first, both + second
    bounds = [scipy.stats.binomtest(hits, n).proportion_ci(method="wilson") for hits in (ours, theirs)]
    below = [hits / n - bound.low for hits, bound in zip((ours, theirs), bounds, strict=True)]
    above = [bound.high - hits / n for hits, bound in zip((ours, theirs), bounds, strict=True)]
    margins = ours * (n - ours) * theirs * (n - theirs)
    product = both * none - first * second
    product = max(product - n / 2, 0) if product > 0 else product
    phi = product / np.sqrt(margins) if margins else 0.0
    difference = (first - second) / n
    low = difference - np.sqrt(below[0] ** 2 - 2 * phi * below[0] * above[1] + above[1] ** 2)
    return low, difference + np.sqrt(above[0] ** 2 - 2 * phi * above[0] * below[1] + below[1] ** 2)


CELLS = [(36, 12, 2, 0), (20, 12, 2, 16), (40, 3, 9, 60), (53, 1, 0, 0), (54, 0, 0, 0), (0, 30, 0, 0)]


@pytest.mark.parametrize("cells", CELLS)
def test_differences_of_paired_shares_have_newcombes_interval(cells):
    """The number of runs in which both hold, only the first, only the second, and neither."""
    flags = np.repeat([[1, 1], [1, 0], [0, 1], [0, 0]], cells, axis=0)
    interval = statistics.paired_shares(flags, [1, -1])
    assert (interval.low, interval.high) == pytest.approx(newcombe_paired(*cells), abs=1e-12)
    turned = statistics.paired_shares(flags, [-1, 1])
    assert (-turned.high, -turned.low) == pytest.approx((interval.low, interval.high))


def test_one_share_has_wilsons_interval_and_a_ratio_of_shares_that_of_their_logarithms():
    flags = np.random.default_rng(0).random((40, 2)) < [0.6, 0.8]
    one, wilson = statistics.paired_shares(flags[:, :1], [1.0]), statistics.share_interval(flags[:, 0])
    assert (one.low, one.high) == pytest.approx((wilson.low, wilson.high))
    ratio = statistics.paired_shares(np.repeat([[1, 1], [1, 0]], [25, 25], axis=0), [1, -1], is_ratio=True)
    (low, high), (ones, _) = statistics.wilson(25, 50), statistics.wilson(50, 50)
    # Shares 1 and 1/2, without correlation.
    assert ratio.estimate == 2.0
    assert np.log(2 / ratio.low) == pytest.approx(np.hypot(np.log(ones), np.log(2 * high)))
    assert np.log(ratio.high / 2) == pytest.approx(np.log(0.5 / low))
    assert np.isnan(statistics.paired_shares([[1, 0]], [1, -1], is_ratio=True).estimate)


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
    for p_values, alpha, levels in (
        ([0.03, 0.001, 0.02], 0.06, [0.06, 0.02, 0.03]),
        ([0.04, 0.03], 0.05, [0.025, 0.025]),  # 0.03 > 0.025 is kept, and so is 0.04 although 0.04 < 0.05
        ([np.nan, 0.01], 0.05, [np.nan, 0.025]),  # a hypothesis without a p-value counts and is kept
    ):
        np.testing.assert_allclose(statistics.holm_levels(p_values, alpha), levels)


def test_a_p_value_is_the_level_at_which_the_bound_passes_a_value():
    """Of Student's t: the p-value of scipy's one-sided test."""
    values = np.random.default_rng(0).normal(0.4, 1.0, 12)

    def low(level):
        return statistics.interval_of_means(lambda means: means, values, level).low

    theirs = scipy.stats.ttest_1samp(values, 0.0, alternative="greater").pvalue
    assert statistics.p_value(lambda level: low(level) > 0) == pytest.approx(theirs)
    assert statistics.p_value(lambda level: low(level) > 100) == 1.0
    flags = np.repeat([[True, False]], 1000, axis=0)
    assert statistics.p_value(lambda level: statistics.paired_shares(flags, [1, -1], level).low > 0) < 1e-15


def test_no_data_and_nan_have_no_interval():
    for values in ([], [1.0, np.nan]):
        for interval in (
            statistics.mean_interval(values),
            statistics.iqm_interval([values]),
            statistics.improvement_interval([(values, [1.0])], is_paired=False),
            statistics.share_interval([]),
            statistics.share_difference(0, 0, 1, 2),
            statistics.share_difference(1, 2, 0, 0),
            statistics.paired_shares(np.zeros((0, 2)), [1, -1]),
        ):
            assert np.isnan([interval.estimate, interval.low, interval.high]).all()


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
    mean, ratio = statistics.mean_interval(values), statistics.ratio_interval(values, values[::-1])
    assert len(drawn) == 2 and statistics.mean_interval(values.tolist()) == mean
    assert statistics.ratio_interval(values, values[::-1]) == ratio and len(drawn) == 2
    assert statistics.mean_interval(values + 1e-12) != mean and len(drawn) == 3
