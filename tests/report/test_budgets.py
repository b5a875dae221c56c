"""Runs of different length: what holds after the end of a run, and up to which budget."""

import numpy as np

from bojax.report.budgets import Series, budget_of, common_budget, held, interval_of_times, times_within
from bojax.report.statistics import time_interval

NAN = np.nan


def series(end, *, is_final=False):
    return Series(np.arange(1.0, end + 1), np.arange(1.0, end + 1), float(end), is_final)


def test_only_a_final_run_keeps_its_last_value_up_to_the_budget_of_its_setting():
    """Of two runs, the first is final, neither or both; elsewhere, another setting has more columns."""
    first, neither, both = [True, False], [False, False], [True, True]
    for final, ends, table, kept in (
        (first, [1, 3], [[1, 2, NAN, NAN], [3, 4, 5, 6]], [[1, 2, 2, 2], [3, 4, 5, 6]]),
        (neither, [1, 3], [[1, 2, NAN, NAN], [3, 4, 5, 6]], [[1, 2, NAN, NAN], [3, 4, 5, 6]]),
        (first, [0, 2], [[1, NAN, NAN, NAN], [3, 4, 5, NAN]], [[1, 1, 1, NAN], [3, 4, 5, NAN]]),
        (both, [0, 2], [[1, NAN, NAN, NAN], [3, 4, 5, NAN]], [[1, 1, 1, 1], [3, 4, 5, 5]]),
        (first, [2, 3], [[0, 1, NAN, NAN], [0, 1, 2, 3]], [[0, 1, NAN, NAN], [0, 1, 2, 3]]),  # a recorded NaN
        (first, [-1, 1], [[NAN, NAN], [1, 2]], [[NAN, NAN], [1, 2]]),  # a run without any column
    ):
        found = held(np.array(table, float), np.array(ends), np.array(final))
        np.testing.assert_array_equal(found, kept)


def test_the_common_budget_is_the_least_of_the_longest_runs():
    short, long = [series(3), series(5)], [series(4, is_final=True), series(9)]
    finals = [series(7, is_final=True), series(2, is_final=True)]
    assert [budget_of(each) for each in (short, long, finals)] == [5, 9, np.inf]
    assert common_budget([short, long, finals]) == 5
    assert common_budget([finals, finals[1:]]) == 7


def test_a_score_is_the_mean_of_the_last_tenth_up_to_the_budget():
    run = series(100)
    assert run.score(100) == np.arange(91, 101).mean()
    assert run.score(50) == np.arange(46, 51).mean()
    assert run.score(50, last=3) == 49 and run.score(50, last=500) == np.arange(1, 51).mean()
    assert series(100, is_final=True).score(100) == 100  # holds from then on
    assert series(100, is_final=True).score(50) == run.score(50)  # it has not ended yet
    assert np.isnan(run.score(0))


def test_a_value_holds_until_the_next():
    run = Series(np.array([2.0, 5.0]), np.array([1.0, 7.0]), 6.0)
    np.testing.assert_array_equal(run.at(np.array([1.0, 2, 4.5, 5, 50])), [NAN, 1, 1, 7, 7])


def test_a_time_to_an_event_is_at_most_the_budget():
    assert times_within(np.array([3.0, NAN, 30.0]), 10).tolist() == [3, 10, 10]


def test_no_bound_of_a_mean_time_is_beyond_what_the_runs_allow():
    times, ends = np.array([30.0, NAN, 2.0]), np.array([400.0, 400.0, 350.0])
    counted = np.array([30.0, 400.0, 2.0])
    free = time_interval(counted)
    assert free.low < 1 and free.high > 400
    found = interval_of_times(times, ends, counted)(counted)
    assert (found.estimate, found.low, found.high) == (144, 1, 400)
    # Nothing limits runs that ended with the event.
    assert interval_of_times(counted, counted, counted)(counted).high == free.high
