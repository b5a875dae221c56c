"""The statistics of a report: intervals of means and shares, and Holm's procedure.

Means of fewer than `FEW` runs have Student's t interval, by the jackknife where a statistic depends on
several means, and of the logarithm of a mean time; more runs have a percentile bootstrap interval. Shares
of Booleans have score intervals.

`iqm_interval` and `improvement_interval` are the estimates that Agarwal et al. (2021), Deep Reinforcement
Learning at the Edge of the Statistical Precipice (NeurIPS), recommend for a few runs on several tasks.

Random numbers come from one fixed seed, so that the same table gives the same report.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
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
TAIL = (1 - LEVEL) / 2  # probability outside such an interval on either side, unless `at_tail` changes it
SEED = 0
FEW = 50
"""Number of runs below which a t interval replaces the percentile bootstrap, whose bounds lack the factor
sqrt(n / (n - 1)) and the quantile of Student's t. Of the mean of an exponential variable, the bootstrap
covers 79% with 5 runs and t 88%; from 50 runs on, they differ by less than one percentage point."""
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
    """An estimate and the bounds of its interval: NaN without data; a single run has no bounds."""

    estimate: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def in_words(self, *, as_percent: bool = False) -> tuple[str, str]:
        """The estimate and `[low, high]` as texts; a share as percentages."""
        if not np.isfinite([self.low, self.high]).all():
            return percent(self.estimate) if as_percent else f"{self.estimate:,.6g}", NO_INTERVAL
        if as_percent:
            return percent(self.estimate), f"[{percent(self.low)}, {percent(self.high)}]"
        return with_bounds(self.estimate, self.low, self.high)

    def within(self, least: float, most: float) -> "Interval":
        """The same with its bounds cut to the possible values of what is estimated."""
        return Interval(self.estimate, max(self.low, least), min(self.high, most))


_tail: ContextVar[float] = ContextVar("_tail", default=TAIL)


def tail_in_use() -> float:
    """The probability outside an interval on either side."""
    return _tail.get()


@contextmanager
def at_tail(tail: float) -> Iterator[None]:
    """Context in which every interval and test leaves out this probability on either side."""
    token = _tail.set(tail)
    try:
        yield
    finally:
        _tail.reset(token)


NO_INTERVAL = "(no interval)"  # text in place of the bounds of a single run


def bootstrap_means(values: ArrayLike, *, resamples: int = RESAMPLES) -> Floats:
    """Means of resampled rows, one row of the result per resample.

    Rows are drawn with replacement and every column takes the same rows: columns that belong to the same
    runs stay paired. A resample is a vector of counts, so that all columns cost one matrix product.

    More than `GROUPS` rows are dealt into `GROUPS` groups of equal size (up to one row), and whole groups
    are resampled: time and memory then no longer grow with the number of rows. The rows are shuffled first,
    by a fixed seed, because groups of sorted rows would be nearly equal. The mean of a group then has the
    variance and the skewness of a mean over as many runs, and the resampled means have those of a bootstrap
    of single rows, up to the error of estimating them from `GROUPS` values.

    The result for `[n]` or `[n, columns]` is `[resamples]` or `[resamples, columns]`.
    """
    table = np.asarray(values, dtype=np.float64)
    sizes = np.ones(len(table))
    if len(table) > GROUPS:
        table = table[np.random.default_rng(SEED).permutation(len(table))]
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
    """Means of resampled rows, as `bootstrap_means`, over the values that are not NaN; NaN without any."""
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


def methods(counts: Iterable[int]) -> str:
    """The kinds of intervals of means of these numbers of runs, in words."""
    is_few = {count < FEW for count in counts if count > 1}
    if len(is_few) > 1:
        return f"Student's t below {FEW} runs and bootstrap from there on"
    return "bootstrap" if False in is_few else "Student's t"


def central(samples: Floats, tail: float | None = None) -> tuple[float, float]:
    """Bounds between which all but a share `tail` on either side of `[resamples]` lie."""
    tail = tail_in_use() if tail is None else tail
    low, high = np.quantile(samples, [tail, 1 - tail])
    return float(low), float(high)


def interval_of_means(
    statistic: Callable[[Floats], Any],
    values: ArrayLike,
    tail: float | None = None,
    *,
    is_ratio: bool = False,
    resampled: Floats | None = None,
) -> Interval:
    """Interval of a statistic of the means of columns, of a table `[n]` or `[n, columns]` with a row per run.

    From `FEW` runs on it is a percentile bootstrap, of the means `resampled` if they are known. Fewer have
    the t interval with the jackknife's standard error (Tukey 1958), which is Student's for a mean. A single
    run has no interval. The values are finite; the statistic maps means `[..., columns]` to values `[...]`.
    If it is positive, a ratio or a mean time (`is_ratio`), the interval is computed for its logarithm.
    """
    tail = tail_in_use() if tail is None else tail
    table = np.asarray(values, dtype=np.float64)
    n = len(table)
    estimate = float(statistic(table.mean(axis=0)))
    if n < 2:
        return Interval(estimate)
    if n >= FEW:
        means = bootstrap_means(table) if resampled is None else resampled
        return Interval(estimate, *central(statistic(means), tail))
    from scipy import special  # takes a tenth of a second to import, and few reports need it

    left_out = np.asarray(statistic((table.sum(axis=0) - table) / (n - 1)), dtype=np.float64)
    scale, back = (np.log, np.exp) if is_ratio else (np.asarray, np.asarray)
    half = -float(special.stdtrit(n - 1, tail)) * np.sqrt(n - 1) * float(np.std(scale(left_out)))
    middle = float(scale(estimate))
    return Interval(estimate, float(back(middle - half)), float(back(middle + half)))


def _once(interval: Callable[..., Interval]) -> Callable[..., Interval]:
    """Cache intervals by their values, since claims, figures and tables ask for the same ones."""
    known = lru_cache(maxsize=256)(lambda *columns: interval(*map(np.frombuffer, columns)))
    return wraps(interval)(
        lambda *columns: known(*(np.asarray(x, dtype=np.float64).tobytes() for x in columns))
    )


@_once
def mean_interval(values: Floats) -> Interval:
    """Mean of `[n]` values with its interval; NaN for no value or a NaN among them."""
    if values.size == 0 or not np.isfinite(values).all():
        return Interval()
    return interval_of_means(lambda means: means, values)


@_once
def time_interval(values: Floats) -> Interval:
    """Mean of `[n]` times, such as steps to a goal, with an interval that has no bound below 0.

    Fewer than `FEW` times have the t interval of the logarithm of their mean, as is usual for times to an
    event (Meeker and Escobar 1998, Statistical Methods for Reliability Data, section 7.3): Student's own is
    symmetric, and of a few skewed times it reaches below 0. NaN as `mean_interval`; if a value is not
    positive, or all are equal, the interval comes from `mean_interval`.
    """
    if not np.isfinite(values).all() or not 0 < values.min(initial=np.inf) < values.max(initial=0.0):
        return mean_interval(values)
    return interval_of_means(lambda means: means, values, is_ratio=True)


@_once
def ratio_interval(numerator: Floats, denominator: Floats) -> Interval:
    """Ratio of the means of two columns of equal runs, `[n]` each, with its interval.

    NaN if a mean, or the mean of any resample, is not positive, since the ratio is then meaningless.
    """
    table = np.stack([numerator, denominator], axis=1)
    if table.size == 0 or not np.isfinite(table).all() or not (means := bootstrap_means(table)).min() > 0:
        return Interval()
    return interval_of_means(
        lambda means: means[..., 0] / means[..., 1], table, is_ratio=True, resampled=means
    )


def iqm_interval(strata: Sequence[ArrayLike]) -> Interval:
    """Interquartile mean of the values of all strata, with its stratified percentile bootstrap interval.

    It leaves out the lowest and the highest quarter, rounded down, so that all of up to three values count.
    Every resample draws from each stratum, such as the runs of a task, as many values as it has (Agarwal et
    al. 2021, section 4.1). NaN for no value or a NaN among them; no interval if a stratum has one value.
    """
    tables = [np.asarray(values, dtype=np.float64) for values in strata]
    pooled = np.concatenate(tables) if tables else np.empty(0)
    if not pooled.size or not np.isfinite(pooled).all():
        return Interval()
    order = np.argsort(pooled)
    cut = int(TRIMMED * pooled.size)
    ranked, means = pooled[order], []
    estimate = float(ranked[cut : pooled.size - cut].mean())
    if min(table.size for table in tables) < 2:
        return Interval(estimate)
    for block in _strata_counts([table.size for table in tables], range(len(tables))):
        # A resample repeats each sorted value as often as it was drawn; the middle ranks of it are kept.
        ends = np.cumsum(np.concatenate(block, axis=1)[:, order], axis=1)
        inside = np.clip(ends, cut, pooled.size - cut)
        kept = np.diff(inside, axis=1, prepend=cut)
        means.append(kept @ ranked / (pooled.size - 2 * cut))
    return Interval(estimate, *central(np.concatenate(means)))


def improvement_interval(strata: Sequence[tuple[ArrayLike, ArrayLike]], *, is_paired: bool) -> Interval:
    """Probability that a run of the first kind has a greater value than a run of the second kind.

    The estimate is the mean over strata, such as tasks, of the Mann-Whitney statistic over the product of
    the numbers of runs: the share of pairs of runs, one of each kind, with the greater first value; a tie
    counts half (Agarwal et al. 2021, section 4.3). From `FEW` runs of every kind on, the interval is a
    stratified percentile bootstrap. With fewer, resamples of separated kinds would all be equal: the interval
    is then the score interval of this statistic (Newcombe 2006, Statistics in Medicine 25, pp. 559-573,
    method 5), those of several strata combined by the squares of their widths. It is NaN for a kind without
    values or a NaN among them, and has no bounds for a single run.

    The strata hold the values of both kinds, `[n]` and `[m]`. If they are paired, they belong to the same
    runs, `n = m`, which are resampled together, while the score interval ignores the pairing and is wider.
    Otherwise both kinds are resampled on their own.
    """
    tables = [tuple(np.asarray(each, dtype=np.float64) for each in pair) for pair in strata]
    values = [each for pair in tables for each in pair]
    if not values or not all(each.size and np.isfinite(each).all() for each in values):
        return Interval()
    ones = [np.ones((1, each.size)) for each in values]
    shares = np.array(
        [_improvement(*pair, *drawn)[0] for pair, *drawn in zip(tables, ones[::2], ones[1::2], strict=True)]
    )
    estimate, fewest = float(shares.mean()), min(each.size for each in values)
    if fewest < 2:
        return Interval(estimate)
    if fewest < FEW:
        bounds = [_score_bounds(share, *map(len, pair)) for share, pair in zip(shares, tables, strict=True)]
        low, high = (np.sqrt(((side - shares) ** 2).sum()) / shares.size for side in np.transpose(bounds))
        return Interval(estimate, max(0.0, estimate - float(low)), min(1.0, estimate + float(high)))
    streams = [2 * stratum + (0 if is_paired else side) for stratum in range(len(tables)) for side in (0, 1)]
    means = []
    for counts in _strata_counts([each.size for each in values], streams):
        pairs = zip(tables, counts[::2], counts[1::2], strict=True)
        means.append(np.mean([_improvement(*pair, *drawn) for pair, *drawn in pairs], axis=0))
    return Interval(estimate, *central(np.concatenate(means)))


def _score_bounds(share: float, first: int, second: int) -> tuple[float, float]:
    """Score interval of a Mann-Whitney statistic of two samples of these sizes."""
    z = NormalDist().inv_cdf(1 - TAIL)

    def is_excluded(value: float) -> bool:
        spread = (1 - value) / (2 - value) + value / (1 + value)
        variance = value * (1 - value) * (1 + ((first + second) / 2 - 1) * spread) / (first * second)
        return (share - value) ** 2 > z**2 * variance

    return _bisected(is_excluded, 0.0, share), _bisected(is_excluded, 1.0, share)


def _bisected(is_outside: Callable[[float], bool], outside: float, inside: float) -> float:
    """The place between two at which a condition ends to hold, to the precision of a float."""
    for _ in range(60):
        middle = (outside + inside) / 2
        outside, inside = (middle, inside) if is_outside(middle) else (outside, middle)
    return outside


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
    """Mean, lower and upper bound of every column of `[n, columns]`: pointwise intervals of means.

    NaNs are left out; a column with fewer than two values has a mean but no band.
    """
    table = np.asarray(values, dtype=np.float64)
    is_there = np.isfinite(table)
    count = is_there.sum(axis=0)
    total = np.where(is_there, table, 0.0).sum(axis=0)
    mean = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
    low, high = (np.full(count.shape, np.nan) for _ in range(2))
    if (known := count >= FEW).any():
        samples = bootstrap_present(table[:, known])
        quantile = np.nanquantile if np.isnan(samples).any() else np.quantile  # the same, but slower
        low[known], high[known] = quantile(samples, [TAIL, 1 - TAIL], axis=0)
    if (known := (count > 1) & (count < FEW)).any():
        from scipy import special  # takes a tenth of a second to import, and few reports need it

        freedom = count[known] - 1
        squares = np.where(is_there, table - mean, 0.0)[:, known] ** 2
        error = np.sqrt(squares.sum(axis=0) / freedom / count[known])
        half = special.stdtrit(freedom, 1 - TAIL) * error
        low[known], high[known] = mean[known] - half, mean[known] + half
    return mean, low, high


def share_band(flags: ArrayLike) -> Band:
    """Share, lower and upper bound of every column `[n, columns]` of 0, 1 or NaN: a pointwise Wilson band."""
    table = np.asarray(flags, dtype=np.float64)
    count, hits = np.isfinite(table).sum(axis=0), np.nansum(table, axis=0)
    share = np.divide(hits, count, out=np.full(hits.shape, np.nan), where=count > 0)
    return share, *wilson(hits, count)


def wilson(successes: ArrayLike, trials: ArrayLike, tail: float | None = None) -> tuple[Floats, Floats]:
    """Bounds of Wilson's score interval (1927, eq. 1), without continuity correction; NaN without trials."""
    n = np.asarray(trials, dtype=np.float64)
    n = np.where(n > 0, n, np.nan)
    count = np.where(n > 0, np.asarray(successes, dtype=np.float64), np.nan)
    z = -NormalDist().inv_cdf(tail_in_use() if tail is None else tail)  # which is exact where 1 - tail is not
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
    """Difference of two independent shares, hybrid score interval (Newcombe 1998, method 10)."""
    if not (trials and other_trials):
        return Interval()
    first, second = successes / trials, other_successes / other_trials
    (low, high), (other_low, other_high) = wilson(successes, trials), wilson(other_successes, other_trials)
    below = np.hypot(first - low, other_high - second)
    above = np.hypot(high - first, second - other_low)
    return Interval(first - second, float(first - second - below), float(first - second + above))


def paired_shares(
    flags: ArrayLike, weights: ArrayLike, tail: float | None = None, *, is_ratio: bool = False
) -> Interval:
    """Weighted sum of the shares of columns of booleans `[n, columns]`, whose rows are runs.

    The distances of Wilson's bounds from the shares are combined as standard errors are, with the
    correlations of the columns. For a difference, weights 1 and -1, this is the interval for paired shares of
    Newcombe (1998, Statistics in Medicine 17, pp. 2635-2650, method 10), for other sums that of Zou and
    Donner (2008, Statistics in Medicine 27, pp. 1693-1702). NaN for no runs.

    With `is_ratio`, the sum is one of logarithms, and estimate and bounds are its exponentials: weights 1 and
    -1 give the ratio of two shares, NaN if one is 0.
    """
    table, weight = np.asarray(flags, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    n, hits = len(table), table.sum(axis=0)
    if not n or (is_ratio and not hits.all()):
        return Interval()
    scale, back = (np.log, np.exp) if is_ratio else (np.asarray, np.asarray)
    ends = weight * scale(np.stack(wilson(hits, n, tail)))
    each = weight * scale(hits / n)
    correlation = _phi(table) * np.outer(np.sign(weight), np.sign(weight))
    low, high = (
        np.sqrt(max(0.0, float(room @ correlation @ room)))
        for room in (each - ends.min(axis=0), ends.max(axis=0) - each)
    )
    return Interval(*(float(back(value)) for value in (each.sum(), each.sum() - low, each.sum() + high)))


def _phi(table: Floats) -> Floats:
    """Correlations of columns of 0 and 1; positive ones are corrected for continuity (Newcombe 1998)."""
    n, hits = len(table), table.sum(axis=0)
    product = n * (table.T @ table) - np.outer(hits, hits)
    product = np.where(product > 0, np.maximum(product - n / 2, 0.0), product)
    spread = np.sqrt(np.outer(hits * (n - hits), hits * (n - hits)))
    phi = np.divide(product, spread, out=np.zeros_like(product), where=spread > 0)
    np.fill_diagonal(phi, 1.0)
    return phi


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
    half = float(special.stdtrit(freedom, 1 - tail_in_use())) * np.sqrt(variance)
    return Interval(difference, float(difference - half), float(difference + half))


def holm_levels(p_values: ArrayLike, alpha: float) -> Floats:
    """The level at which Holm's step-down procedure tests each hypothesis (Holm 1979).

    The k-th smallest p-value is tested at `alpha / (m - k + 1)`. From the first hypothesis that is kept
    on, the rest are kept as well: they are given the level of that one. So `p <= level` is exactly
    Holm's decision, and a confidence bound at that level excludes zero exactly where Holm rejects. A
    hypothesis whose p-value is NaN counts among the m and is kept; its level is NaN.
    """
    p = np.asarray(p_values, dtype=np.float64)
    levels = np.empty_like(p)
    level = 0.0
    is_rejecting = True
    for rank, index in enumerate(np.argsort(p, kind="stable")):
        if is_rejecting:
            level = alpha / (p.size - rank)
            is_rejecting = bool(p[index] <= level)
        levels[index] = level if np.isfinite(p[index]) else np.nan
    return levels


def p_value(is_excluded: Callable[[float], bool]) -> float:
    """Least one-sided level at which a bound excludes a value; 1 if it does not even at level 0.5."""
    return _bisected(lambda level: not is_excluded(level), 0.0, 0.5) if is_excluded(0.5) else 1.0


def holm_intervals(
    sample: Floats, share_bounds: Callable[[int, float], tuple[float, float]] | None = None
) -> list[Interval]:
    """Interval of the mean of every column of `[runs, columns]`, two rows or more, to be compared with 0.

    It is one-sided in both directions: each bound is at the level that Holm's correction over the columns
    gives to its side. For shares, `share_bounds` gives the bounds of a column, by its index and the
    probability of one tail.
    """
    means = None if share_bounds is not None or len(sample) < FEW else bootstrap_means(sample)

    def bounds_at(column: int, tail: float) -> tuple[float, float]:
        if share_bounds is not None:
            return share_bounds(column, tail)
        if means is not None:
            return central(means[:, column], tail)
        found = interval_of_means(lambda means: means, sample[:, column], tail)
        return found.low, found.high

    columns = range(sample.shape[1])
    if means is not None:
        above, below = (means <= 0).mean(axis=0), (means >= 0).mean(axis=0)
    else:
        above = [p_value(lambda tail, k=k: bounds_at(k, tail)[0] > 0) for k in columns]
        below = [p_value(lambda tail, k=k: bounds_at(k, tail)[1] < 0) for k in columns]
    low_tails, high_tails = (holm_levels(each, tail_in_use()) for each in (above, below))
    return [
        Interval(float(sample[:, k].mean()), bounds_at(k, low_tails[k])[0], bounds_at(k, high_tails[k])[1])
        for k in columns
    ]
