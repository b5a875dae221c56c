"""The statistics of a report: intervals of means and shares, and Holm's procedure.

`iqm_interval` and `improvement_interval` are the estimates that Agarwal et al. (2021), Deep Reinforcement
Learning at the Edge of the Statistical Precipice (NeurIPS), recommend for a few runs on several tasks.

Random numbers come from one fixed seed, so that the same table gives the same report.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, wraps
from statistics import NormalDist
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bojax.report.text import percent, with_bounds

Floats = NDArray[np.float64]

Band: TypeAlias = tuple[Floats, Floats, Floats]  # mean, lower and upper bound of every column of a table
BAND = 1.96  # half the width of a band of 95% of a normal distribution, in standard deviations

RESAMPLES = 10_000
"""Number of bootstrap resamples; it fixes the bounds of a 95% interval to about 1% of its width."""
LEVEL = 0.95  # coverage of every interval in a report
TAIL = (1 - LEVEL) / 2  # probability outside such an interval on either side
SEED = 0
GROUPS = 5_000
"""Largest number of rows that are resampled one by one; more rows are resampled in this many groups of
equal size. The standard deviation of a mean is then known to about 1%, as precisely as `RESAMPLES` fix the
bounds."""
FEW_RESAMPLES = 1_000
"""Number of resamples of a statistic that is no mean, so that its rows cannot be grouped, of more than
`GROUPS` rows: it fixes the bounds of an interval to about 3% of its width."""
TRIMMED = 0.25  # share of the values that an interquartile mean leaves out on either side

# Resamples are counted in blocks of at most this many cells, 16 MB.
_BLOCK_CELLS = 2_000_000


@dataclass(frozen=True)
class Interval:
    """An estimate and the bounds of its interval; NaN where there were no data."""

    estimate: float
    low: float
    high: float

    def in_words(self, *, as_percent: bool = False) -> tuple[str, str]:
        """The estimate and `[low, high]` as texts; a share as percentages."""
        if as_percent:
            return percent(self.estimate), f"[{percent(self.low)}, {percent(self.high)}]"
        return with_bounds(self.estimate, self.low, self.high)


_UNKNOWN = Interval(float("nan"), float("nan"), float("nan"))


def bootstrap_means(values: ArrayLike, *, resamples: int = RESAMPLES) -> Floats:
    """Means of resampled rows, one row of the result per resample.

    Rows are drawn with replacement and every column takes the same rows: columns that belong to the same
    runs stay paired. A resample is a vector of counts, so that all columns cost one matrix product.

    More than `GROUPS` rows are dealt into `GROUPS` groups of equal size (up to one row), and whole groups
    are resampled: time and memory then no longer grow with the number of rows. Runs are independent of each
    other, so the mean of a group has the variance and the skewness of a mean over as many runs, and the
    resampled means have those of a bootstrap of single rows, up to the error of estimating them from
    `GROUPS` values.

    The result for `[n]` or `[n, columns]` is `[resamples]` or `[resamples, columns]`.
    """
    table = np.asarray(values, dtype=np.float64)
    sizes = np.ones(len(table))
    if len(table) > GROUPS:
        sizes = np.bincount(np.arange(len(table)) % GROUPS).astype(np.float64)
        sums = np.zeros((GROUPS, *table.shape[1:]))
        for first in range(0, len(table), GROUPS):
            dealt = table[first : first + GROUPS]
            sums[: len(dealt)] += dealt
        table = sums
    means = np.empty((resamples, *table.shape[1:]))
    block = max(1, _BLOCK_CELLS // max(1, len(table)))
    counts = _counts(len(table), resamples, block)
    for start in range(0, resamples, block):
        drawn = counts[start : start + block].astype(np.float64, copy=False)
        rows = drawn @ sizes
        means[start : start + block] = drawn @ table / rows.reshape(-1, *[1] * (table.ndim - 1))
    return means


@lru_cache(maxsize=2)
def _counts(num_rows: int, resamples: int, block: int, stream: int = 0) -> NDArray[Any]:
    """How often each resample draws each row, `[resamples, rows]`: the same for all tables of a length.

    Counts of different streams are independent. Counts of one block are numbers for a product; those of
    several blocks are small integers, to save memory.
    """
    random = np.random.default_rng(SEED + stream)
    counts = np.empty((resamples, num_rows), dtype=np.float64 if resamples <= block else np.uint16)
    for start in range(0, resamples, block):
        size = min(block, resamples - start)
        drawn = random.integers(0, num_rows, (size, num_rows))
        drawn += np.arange(size)[:, None] * num_rows
        tally = np.bincount(drawn.ravel(), minlength=size * num_rows)
        counts[start : start + size] = tally.reshape(size, num_rows)
    return counts


def bootstrap_present(values: ArrayLike) -> Floats:
    """Means of resampled rows, as `bootstrap_means`, over the values that are not NaN.

    A resample without any value of a column gives NaN in that column.
    """
    table = np.asarray(values, dtype=np.float64)
    is_there = np.isfinite(table)
    if is_there.all():
        return bootstrap_means(table)
    # Both bootstraps draw the same rows, since they have the same seed.
    sums, shares = bootstrap_means(np.where(is_there, table, 0.0)), bootstrap_means(is_there)
    return np.divide(sums, shares, out=np.full(sums.shape, np.nan), where=shares > 0)


def resampled(rows: int) -> str:
    """What `bootstrap_means` resamples for this number of runs, in words."""
    return "whole runs" if rows <= GROUPS else f"{GROUPS:,} groups into which {rows:,} runs were dealt"


def central(samples: Floats) -> tuple[float, float]:
    """Bounds between which `LEVEL` of `[resamples]` lie."""
    low, high = np.quantile(samples, [TAIL, 1 - TAIL])
    return float(low), float(high)


def _once(interval: Callable[..., Interval]) -> Callable[..., Interval]:
    """Cache intervals by their values, since claims, figures and tables ask for the same ones."""
    known = lru_cache(maxsize=256)(lambda *columns: interval(*map(np.frombuffer, columns)))
    return wraps(interval)(
        lambda *columns: known(*(np.asarray(x, dtype=np.float64).tobytes() for x in columns))
    )


@_once
def mean_interval(values: Floats) -> Interval:
    """Mean of `[n]` values with its percentile bootstrap interval; NaN for no value or a NaN among them."""
    if values.size == 0 or not np.isfinite(values).all():
        return _UNKNOWN
    return Interval(float(values.mean()), *central(bootstrap_means(values)))


@_once
def ratio_interval(numerator: Floats, denominator: Floats) -> Interval:
    """Ratio of the means of two columns of equal runs, `[n]` each, with its percentile bootstrap interval.

    NaN if a mean, or that of any resample, is not positive, since the ratio is then meaningless.
    """
    table = np.stack([numerator, denominator], axis=1)
    if table.size == 0 or not np.isfinite(table).all() or not (means := bootstrap_means(table)).min() > 0:
        return _UNKNOWN
    ratio = float(table[:, 0].mean() / table[:, 1].mean())
    return Interval(ratio, *central(means[:, 0] / means[:, 1]))


def iqm_interval(strata: Sequence[ArrayLike]) -> Interval:
    """Interquartile mean of the values of all strata, with its stratified percentile bootstrap interval.

    It leaves out the lowest and the highest quarter, rounded down, so that all of up to three values count.
    Every resample draws from each stratum, such as the runs of a task, as many values as it has (Agarwal et
    al. 2021, section 4.1). NaN for no value or a NaN among them.
    """
    tables = [np.asarray(values, dtype=np.float64) for values in strata]
    pooled = np.concatenate(tables) if tables else np.empty(0)
    if not pooled.size or not np.isfinite(pooled).all():
        return _UNKNOWN
    order = np.argsort(pooled)
    cut = int(TRIMMED * pooled.size)
    ranked, means = pooled[order], []
    for block in _strata_counts([table.size for table in tables], range(len(tables))):
        # A resample repeats each sorted value as often as it was drawn; the middle ranks of it are kept.
        ends = np.cumsum(np.concatenate(block, axis=1)[:, order], axis=1)
        inside = np.clip(ends, cut, pooled.size - cut)
        kept = np.diff(inside, axis=1, prepend=cut)
        means.append(kept @ ranked / (pooled.size - 2 * cut))
    return Interval(float(ranked[cut : pooled.size - cut].mean()), *central(np.concatenate(means)))


def improvement_interval(strata: Sequence[tuple[ArrayLike, ArrayLike]], *, is_paired: bool) -> Interval:
    """Probability that a run of the first kind has a greater value than a run of the second kind.

    The estimate is the mean over strata, such as tasks, of the Mann-Whitney statistic over the product of
    the numbers of runs: the share of pairs of runs, one of each kind, with the greater first value; a tie
    counts half (Agarwal et al. 2021, section 4.3). The interval is a stratified percentile bootstrap; it is
    NaN for a kind without values or a NaN among them.

    The strata hold the values of both kinds, `[n]` and `[m]`. If they are paired, they belong to the same
    runs, `n = m`, which are resampled together. Otherwise both kinds are resampled on their own.
    """
    tables = [tuple(np.asarray(each, dtype=np.float64) for each in pair) for pair in strata]
    values = [each for pair in tables for each in pair]
    if not values or not all(each.size and np.isfinite(each).all() for each in values):
        return _UNKNOWN
    streams = [2 * stratum + (0 if is_paired else side) for stratum in range(len(tables)) for side in (0, 1)]
    shares = []
    ones = [np.ones((1, each.size)) for each in values]
    for counts in (ones, *_strata_counts([each.size for each in values], streams)):
        pairs = zip(tables, counts[::2], counts[1::2], strict=True)
        shares.append(np.mean([_improvement(*pair, *drawn) for pair, *drawn in pairs], axis=0))
    return Interval(float(shares[0][0]), *central(np.concatenate(shares[1:])))


def _improvement(first: Floats, second: Floats, drawn: Floats, other_drawn: Floats) -> Floats:
    """Share of pairs with the greater first value in resamples with these counts `[resamples, n or m]`."""
    order = np.argsort(second)
    below = np.pad(np.cumsum(other_drawn[:, order], axis=1), ((0, 0), (1, 0)))
    places = [np.searchsorted(second[order], first, side=side) for side in ("left", "right")]
    wins = (below[:, places[0]] + below[:, places[1]]) / 2
    return (drawn * wins).sum(axis=1) / (first.size * second.size)


def _strata_counts(sizes: Sequence[int], streams: Sequence[int]) -> Iterator[list[Floats]]:
    """Blocks of resamples of several tables of these lengths: counts `[resamples, rows]` of each table."""
    resamples = RESAMPLES if max(sizes) <= GROUPS else FEW_RESAMPLES
    block = max(1, _BLOCK_CELLS // sum(sizes))
    tables = [_counts(size, resamples, block, stream) for size, stream in zip(sizes, streams, strict=True)]
    for start in range(0, resamples, block):
        yield [table[start : start + block].astype(np.float64, copy=False) for table in tables]


def mean_band(values: ArrayLike) -> Band:
    """Mean, lower and upper bound of every column of `[n, columns]`: a pointwise bootstrap band.

    NaNs are left out; a column with fewer than two values has a mean but no band.
    """
    table = np.asarray(values, dtype=np.float64)
    is_there = np.isfinite(table)
    count = is_there.sum(axis=0)
    total = np.where(is_there, table, 0.0).sum(axis=0)
    mean = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
    low, high = (np.full(count.shape, np.nan) for _ in range(2))
    if (known := count > 1).any():
        samples = bootstrap_present(table[:, known])
        quantile = np.nanquantile if np.isnan(samples).any() else np.quantile  # the same, but slower
        low[known], high[known] = quantile(samples, [TAIL, 1 - TAIL], axis=0)
    return mean, low, high


def share_band(flags: ArrayLike) -> Band:
    """Share, lower and upper bound of every column of `[n, columns]` of 0 and 1: a pointwise Wilson band.

    A NaN is no value; a column without values is NaN.
    """
    table = np.asarray(flags, dtype=np.float64)
    count, hits = np.isfinite(table).sum(axis=0), np.nansum(table, axis=0)
    share = np.divide(hits, count, out=np.full(hits.shape, np.nan), where=count > 0)
    return share, *wilson(hits, count)


def wilson(successes: ArrayLike, trials: ArrayLike) -> tuple[Floats, Floats]:
    """Bounds of Wilson's score interval for a share (Wilson 1927, eq. 1), without continuity correction.

    NaN where there are no trials.
    """
    n = np.asarray(trials, dtype=np.float64)
    n = np.where(n > 0, n, np.nan)
    count = np.where(n > 0, np.asarray(successes, dtype=np.float64), np.nan)
    z = NormalDist().inv_cdf(1 - TAIL)
    share = count / n
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    # At 0 and n the bound equals the share exactly, which rounding must not change.
    return np.where(count == 0, 0.0, centre - half), np.where(count == n, 1.0, centre + half)


def share_interval(flags: ArrayLike) -> Interval:
    """Share of `[n]` booleans that hold, with Wilson's interval."""
    hits = np.asarray(flags, dtype=bool)
    low, high = wilson(hits.sum(), hits.size)
    return Interval(float(hits.mean()) if hits.size else float("nan"), float(low), float(high))


def share_difference(successes: int, trials: int, other_successes: int, other_trials: int) -> Interval:
    """Difference of two independent shares with the hybrid score interval (Newcombe 1998, method 10)."""
    first, second = successes / trials, other_successes / other_trials
    (low, high), (other_low, other_high) = wilson(successes, trials), wilson(other_successes, other_trials)
    below = np.hypot(first - low, other_high - second)
    above = np.hypot(high - first, second - other_low)
    return Interval(first - second, float(first - second - below), float(first - second + above))


def fisher_p_value(successes: int, trials: int, other_successes: int, other_trials: int) -> float:
    """Two-sided p-value of Fisher's exact test of whether two independent shares are equal."""
    from scipy import stats  # takes half a second to import, and few reports need it

    pairs = ((successes, trials), (other_successes, other_trials))
    result: Any = stats.fisher_exact([[hits, runs - hits] for hits, runs in pairs])
    return float(result.pvalue)


def welch_difference(first: tuple[float, float, int], second: tuple[float, float, int]) -> Interval:
    """Difference of two independent means with Welch's t interval.

    Each is given by its mean, its standard deviation (of n - 1) and its number of values.
    """
    variances = np.array([first[1] ** 2 / first[2], second[1] ** 2 / second[2]])
    difference, variance = first[0] - second[0], float(variances.sum())
    if variance == 0:
        return Interval(difference, difference, difference)
    from scipy import special  # takes a tenth of a second to import, and few reports need it

    freedom = variance**2 / float((variances**2 / np.array([first[2] - 1, second[2] - 1])).sum())
    half = float(special.stdtrit(freedom, 1 - TAIL)) * np.sqrt(variance)
    return Interval(difference, float(difference - half), float(difference + half))


def holm_levels(p_values: ArrayLike, alpha: float) -> Floats:
    """The level at which Holm's step-down procedure tests each hypothesis (Holm 1979).

    The k-th smallest p-value is tested at `alpha / (m - k + 1)`. From the first hypothesis that is kept
    on, the rest are kept as well: they are given the level of that one. So `p <= level` is exactly
    Holm's decision, and a confidence bound at that level excludes zero exactly where Holm rejects.
    """
    p = np.asarray(p_values, dtype=np.float64)
    levels = np.empty_like(p)
    level = 0.0
    is_rejecting = True
    for rank, index in enumerate(np.argsort(p, kind="stable")):
        if is_rejecting:
            level = alpha / (p.size - rank)
            is_rejecting = bool(p[index] <= level)
        levels[index] = level
    return levels
