"""`bojax.minimise`, `bojax.maximise` and `bojax.Optimiser`: plain functions over mixed spaces."""

import math
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bojax
from bojax.api import optimiser
from bojax.api.optimisation import Evaluation
from bojax.optimisation.space import read_space
from tests.refusals import assert_refused

SPACE = {"rate": (1e-5, 1e5, "log"), "depth": (1, 8), "kind": ["b", "c", "a"]}
"""One space for most tests, which share its programs."""

COST = {"a": 0.0, "b": 1.0, "c": 0.3}


def objective(rate, depth, kind):
    """A function of minimum 0 at a rate of 100, a depth of 5 and kind a."""
    return (math.log10(rate) - 2.0) ** 2 + abs(depth - 5) + COST[kind]


@pytest.fixture(scope="module")
def found():
    return bojax.minimise(objective, SPACE, budget=28, progress=False)


def test_the_minimum_of_a_mixed_space_is_found(found):
    assert found.best["depth"] == 5 and found.best["kind"] == "a"
    assert found.best["rate"] == pytest.approx(100.0, rel=0.15)
    assert found.value == objective(**found.best) == min(found.table["value"].to_pylist())
    assert [type(found.best[name]) for name in SPACE] == [float, int, str]
    assert len(found.evaluations) == found.table.num_rows == 28 and found.num_failed == 0


def test_numbers_of_the_model_have_64_bits_and_the_flag_of_the_user_stays(found):
    del found
    # The test process computes in float64; a user's does not.
    with jax.enable_x64(False):
        seen = []

        def function(rate, depth, kind):
            seen.append(jnp.ones(()).dtype)
            return objective(rate, depth, kind)

        result = bojax.minimise(function, SPACE, budget=3, progress=False)
        assert result.predict([result.best])[0].dtype == np.float64
        assert set(map(str, seen)) == {"float32"}


def test_the_same_seed_gives_the_same_points_and_another_one_others():
    def points(seed):
        return bojax.minimise(objective, SPACE, budget=9, seed=seed, progress=False).table

    assert points(3).equals(points(3)) and not points(3).equals(points(4))


def test_maximising_is_minimising_the_negative():
    least = bojax.minimise(objective, SPACE, budget=10, progress=False)
    most = bojax.maximise(lambda **point: -objective(**point), SPACE, budget=10, progress=False)
    assert most.best == least.best and most.value == -least.value


def test_failures_are_not_learned_from_and_not_tried_again():
    def function(rate, depth, kind):
        return math.nan if kind == "a" else objective(rate, depth, kind)

    result = bojax.minimise(function, SPACE, budget=14, progress=False)
    tried = [tuple(each.point.values()) for each in result.evaluations]
    assert result.num_failed > 0 and len(set(tried)) == len(tried)
    assert result.best["kind"] != "a" and math.isfinite(result.value)


def test_all_failures_are_a_result_without_a_best_point():
    result = bojax.minimise(lambda **_: math.inf, SPACE, budget=3, progress=False)
    assert result.best is None and result.value is None and result.num_failed == 3
    assert repr(result) == "OptimisationResult(best=None, value=None, 3 evaluations, 3 failed)"
    for use in (result.plot, lambda: result.predict([])):
        with pytest.raises(ValueError, match="no evaluation has succeeded"):
            use()


@pytest.fixture(params=[1, 3])
def batch(request, monkeypatch):
    """The size of a batch; with room for it, the model has as many rows as elsewhere: programs are shared."""
    monkeypatch.setattr(optimiser, "LEAST_CAPACITY", optimiser.LEAST_CAPACITY + 1 - request.param)
    return request.param


BATCH_OF_THREE = pytest.mark.parametrize("batch", [3], indirect=True)


def test_an_error_of_the_function_is_told_with_its_point_and_what_was_found(batch):
    def function(rate, depth, kind):
        if calls.append(depth) or len(calls) == 3:
            raise KeyError("gone")
        return objective(rate, depth, kind)

    calls = []
    with pytest.raises(bojax.ObjectiveError, match="at rate=.* failed: KeyError: 'gone'") as caught:
        bojax.minimise(function, SPACE, budget=7, batch=batch, progress=False)
    assert len(caught.value.result.evaluations) == 2 and isinstance(caught.value.__cause__, KeyError)


def test_ctrl_c_keeps_what_was_found(batch, capsys):
    def function(rate, depth, kind):
        if calls.append(depth) or len(calls) == 3:
            raise KeyboardInterrupt
        return objective(rate, depth, kind)

    calls = []
    assert len(bojax.minimise(function, SPACE, budget=5, batch=batch).evaluations) == 2
    assert "stopped after 2 evaluations" in capsys.readouterr().err


@BATCH_OF_THREE
def test_workers_with_another_number_of_values_end_in_one_line(batch):
    for number in (2, 4):

        def workers(function, points, number=number):
            return [0.0] * number

        with pytest.raises(bojax.ObjectiveError, match=f"workers: got {number} values; allowed: 3") as caught:
            bojax.minimise(objective, SPACE, budget=7, batch=batch, workers=workers, progress=False)
        assert len(caught.value.result.evaluations) == min(number, 3)


def test_choices_of_several_types_are_a_column_of_text():
    axes = read_space({"x": ["1", 1, None], "y": [True, False], "z": [1, 2.5]})
    told = Evaluation({"x": 1, "y": True, "z": 1}, 0.0), Evaluation({"x": None, "y": False, "z": 2.5}, 1.0)
    table = bojax.OptimisationResult(told, axes, is_maximised=False, is_noisy=False, search=None).table
    rows = [("1", True, 1.0, 0.0), ("None", False, 2.5, 1.0)]
    assert [tuple(row.values()) for row in table.to_pylist()] == rows


def test_a_result_stays_as_it_was():
    search = bojax.Optimiser({"x": (-1.0, 1.0)}, noisy=True)
    search.tell({"x": 0.5}, 1.0)
    result = search.result()
    value = result.predict([{"x": 0.0}])[0]
    search.tell({"x": 0.0}, 5.0)
    assert result.predict([{"x": 0.0}])[0] == value != search.result().predict([{"x": 0.0}])[0]


@BATCH_OF_THREE
def test_a_batch_is_evaluated_by_an_executor_and_known_points_count(batch):
    known = [({"rate": 100.0, "depth": 5, "kind": "a"}, 0.0)]
    with ThreadPoolExecutor(3) as pool:
        result = bojax.minimise(
            objective, SPACE, budget=7, batch=batch, known=known, workers=pool.map, progress=False
        )
    assert len(result.evaluations) == 8 and result.best == known[0][0]
    assert len({tuple(each.point.values()) for each in result.evaluations}) == 8


def test_a_small_space_is_tried_once():
    tried = []
    result = bojax.maximise(
        lambda x: tried.append(x) or -abs(x - 3), {"x": (1, 5)}, budget=20, progress=False
    )
    assert sorted(tried) == [1, 2, 3, 4, 5] and result.best == {"x": 3}


@pytest.mark.parametrize("maximise", [False, True])
def test_a_noisy_function_has_the_point_of_the_best_mean(maximise):
    random, sign = np.random.default_rng(0), -1.0 if maximise else 1.0
    optimise = bojax.maximise if maximise else bojax.minimise

    def noisy(x):
        return sign * (x - 0.3) ** 2 + 0.1 * random.standard_normal()

    result = optimise(noisy, {"x": (-1.0, 1.0)}, budget=24, noisy=True, progress=False)
    assert abs(result.best["x"] - 0.3) < 0.25
    assert abs(result.value) < 0.1


def test_step_by_step_with_points_of_ones_own_and_more_than_the_capacity(monkeypatch):
    monkeypatch.setattr(optimiser, "LEAST_CAPACITY", 16)  # twice as many have the programs of other tests
    search = bojax.Optimiser({"x": (-1.0, 1.0)}, noisy=True, capacity=16)
    assert search.ask() == search.ask()
    random = np.random.default_rng(1)
    points = [{"x": x} for x in random.uniform(-1.0, 1.0, 24)]
    search.tell_batch(points, [point["x"] ** 2 for point in points])
    search.tell(search.ask(), 0.0)
    result = search.result()
    assert len(result.evaluations) == 25
    with pytest.raises(ValueError, match="points: got a single point; allowed: a list"):
        result.predict({"x": 0.5})
    mean, _ = result.predict([{"x": 0.5}])
    assert mean[0] == pytest.approx(0.25, abs=0.05)


def test_wrong_arguments_end_in_one_line(found):
    def use(function=objective, space=SPACE, **options):
        return partial(bojax.minimise, function, space, **options)

    def predict(depth, kind="a"):
        return partial(found.predict, [{"rate": 1.0, "depth": depth, "kind": kind}])

    alone, integer = {"rate": 1.0}, "an integer from 1 to 8"
    assert_refused(
        [
            (use(3), "function: got 3"),
            (use(space={"x": (1, 0)}), "x: got 1 and 0"),
            (use(budget=0), "budget: got 0; allowed: an integer >= 1"),
            (use(budget=10**6), "evaluations: got 1000000; allowed: <= 10000"),
            (partial(bojax.Optimiser, SPACE, capacity=10**6), "evaluations: got 1000000; allowed: <= 10000"),
            (use(batch=0), "batch: got 0"),
            (use(initial=0.5), "initial: got 0.5"),
            (use(known=[(alone, 0.0)]), "got .*a value for each of rate"),
            (use(known=[({**alone, "depth": 0, "kind": "a"}, 0.0)]), f"depth: got 0; allowed: {integer}"),
            (use(known=[alone]), "known: got .*; allowed: pairs of a point and its value"),
            (
                use(known=[({**alone, "depth": 1, "kind": "a"}, 10**400)]),
                "value: got 1000.*allowed: a number",
            ),
            (use(noisy="no"), 'noisy: got "no"; allowed: True or False'),
            (use(progress="no"), 'progress: got "no"; allowed: True or False'),
            (use(seed=-1), "seed: got -1; allowed: an integer >= 0"),
            (use(seed=2**63), "seed: got 9223372036854775808; allowed: below"),
            (lambda: bojax.Optimiser(SPACE).ask_batch("a"), 'number: got "a"; allowed: an integer >= 1'),
            (lambda: bojax.Optimiser(SPACE).tell_batch([], [1.0]), "values: got 1; allowed: 0, one for each"),
            (use(workers=4), "workers: got 4; allowed: a function such as"),
            (use(seed="a"), 'seed: got "a"; allowed: an integer'),
            (partial(bojax.maximise, objective, SPACE, seed="a"), 'seed: got "a"; allowed: an integer'),
            (lambda: bojax.Optimiser(SPACE).ask_batch(2), "number: got 2; allowed: from 1 to 1"),
            (partial(found.predict, []), r"points: got \[\]; allowed: at least one point"),
            (partial(found.predict, [alone]), "got .*allowed: a value for each of rate"),
            (predict(2, "zzz"), 'kind: got "zzz"; allowed: "b", "c", "a"'),
            (predict(2.5), f"depth: got 2.5; allowed: {integer}"),
            (predict(9), f"depth: got 9; allowed: {integer}"),
        ]
    )


def test_the_figure_has_a_panel_for_the_progress_and_for_each_axis(found):
    picture = found.plot()
    assert len(picture.figure.axes) == 4 and picture.png.startswith(b"\x89PNG")
