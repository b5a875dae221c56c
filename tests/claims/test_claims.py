import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from bojax.claims.samples import MIN_RUNS
from bojax.config import claims as schemas
from bojax.report import statistics, verdicts
from bojax.report.findings import evaluate
from bojax.report.manifest import ClaimEntry
from bojax.report.source import load
from tests.report.synthetic import CLAIMS, set_column, write_results

EXPECTED = {
    "order-holds": "reproduced",
    "order-fails": "not reproduced",
    "share-holds": "reproduced",
    "share-fails": "not reproduced",
    "share-open": "inconclusive",
    "trend-holds": "reproduced",
    "missing": "inconclusive",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_results(tmp_path_factory.mktemp("claims") / "results", runs=40)


@pytest.fixture(scope="module")
def entries(folder):
    return {entry.id: entry for entry in evaluate(load(folder))}


def judge(folder, test) -> verdicts.TestedClaim:
    """The entry of one claim with this test on the results of a folder."""
    results = load(folder)
    claim = ClaimEntry(id="x", source="s", claim="c", test=test)
    return evaluate(replace(results, manifest=results.manifest.model_copy(update={"claims": [claim]})))[0]


def test_verdicts_of_clear_cases(entries):
    assert {key: entry.verdict for key, entry in entries.items()} == EXPECTED


def test_entries_hold_the_keys_of_the_results_format(entries):
    keys = (
        "id source claim class cause own_bound thesis ours interval runs verdict share configurations changed"
    )
    written = [entry.model_dump(mode="json", by_alias=True) for entry in entries.values()]
    assert all([*entry] == [*keys.split(), "test"] for entry in written)
    json.dumps(written, allow_nan=False)


def test_the_best_variant_stands_for_a_label(entries):
    assert entries["order-holds"].test.chosen == {"sbo": "sbo-9"}
    # 9 of 20 runs of sbo-9 park, 5 of 20 of sbo-5.
    assert entries["share-open"].ours == pytest.approx(0.45)


def test_the_page_says_by_what_a_variant_was_chosen(entries):
    for id, test, words in (
        ("order-holds", {}, "greatest mean return"),
        ("order-holds", {"greater": None, "less": ["sbo", "kcbts"], "column": "rmse"}, "least mean rmse"),
        ("share-open", {}, "greatest mean return"),
        ("share-open", {"window": {"from": 1, "to": 3}, "column": "length"}, "greatest mean length"),
    ):
        entry = entries[id].model_dump(by_alias=True)
        entry["test"] |= test
        (sentence,) = verdicts.TestedClaim.model_validate(entry).stand_ins
        assert sentence == f"sbo is represented by sbo-9, the variant with the {words}"


def test_a_variant_can_be_named_itself(folder):
    entry = judge(
        folder,
        {"kind": "share", "by": "variant", "label": "sbo-5", "column": "success", "above": 0.0},
    )
    assert entry.ours == pytest.approx(0.25)
    assert entry.verdict == "reproduced"


def test_settings_that_do_not_differ_leave_an_order_open(folder):
    entry = judge(
        folder, {"kind": "order", "by": "variant", "column": "seed", "greater": ["kcbts", "random"]}
    )
    assert entry.verdict == "inconclusive"
    assert entry.interval == [0.0, 0.0]


def test_a_trend_may_leave_out_runs_that_have_ended(folder):
    test = {"kind": "trend", "label": "kcbts", "column": "accumulated_reward", "from": 4, "to": 14}
    entry = judge(folder, {**test, "direction": "falls", "ended": "left-out"})
    rows = pq.read_table(folder / "steps.parquet").to_pylist()
    values = [(row["step"], row["accumulated_reward"]) for row in rows if row["label"] == "kcbts"]
    later = np.mean([value for step, value in values if 4 < step <= 14])
    assert entry.ours == pytest.approx(later - np.mean([value for step, value in values if step == 4]))
    low, high = entry.interval
    assert low < entry.ours < high and entry.runs == 40


def test_what_cannot_be_tested_is_inconclusive_and_says_why(folder):
    trend = {"kind": "trend", "column": "accumulated_reward", "direction": "falls"}
    for test, reason in (
        (
            {**trend, "label": "random", "from": 14, "to": 15, "ended": "left-out"},
            "10 active runs: at least 20",
        ),
        ({**trend, "label": "sbo", "from": 6, "to": 40}, "the longest took 15"),
        ({"kind": "share", "label": "cbts", "column": "success", "above": 0.5}, "no runs of cbts"),
        ({"kind": "share", "label": "sbo", "column": "parked", "above": 0.5}, "no column parked"),
        ({"kind": "order", "column": "rmse", "greater": ["sbo", "random"]}, "no column rmse"),
        (
            {"kind": "order", "column": "return", "greater": ["sbo", "random"], "margin": "wide"},
            "margin: got",
        ),
        ({"kind": "spectrum"}, "unknown test"),
        ({"kind": "order", "greater": ["sbo", "random"]}, "column"),
    ):
        entry = judge(folder, test)
        assert entry.verdict == "inconclusive"
        assert entry.ours is None and entry.interval is None
        assert reason in entry.test.reason


def test_too_few_runs_decide_nothing(tmp_path):
    entries = evaluate(load(write_results(tmp_path / "few", runs=MIN_RUNS - 1)))
    assert {entry.verdict for entry in entries} == {"inconclusive"}
    assert f"at least {MIN_RUNS}" in entries[0].test.reason


def test_booleans_that_hold_in_all_runs_have_an_interval_in_every_test(tmp_path):
    """The bootstrap of equal values has no width, as if their share were known exactly."""
    copy = write_results(tmp_path / "equal", runs=40)
    set_column(copy, "success", True)
    low, high = statistics.wilson(40, 40)
    both, ratio = float(1 - low), float(1 / low)  # the upper bound of either share is 1
    names = {"column": "success", "by": "variant"}
    cases = [
        ({"kind": "mean", "label": "kcbts", "above": 0.5}, [float(low), 1.0], "reproduced"),
        ({"kind": "similar", "labels": ["kcbts", "random"], "margin": 0.2}, [-both, both], "reproduced"),
        (
            {"kind": "similar", "labels": ["kcbts", "random"], "factor": 1.05},
            [1 / ratio, ratio],
            "inconclusive",
        ),
        ({"kind": "ratio", "label": "kcbts", "to": "random", "expected": 2.0}, [1 / ratio, ratio], None),
        ({"kind": "order", "greater": ["kcbts", "random"]}, [-both, both], "inconclusive"),
        ({"kind": "order", "greater": ["kcbts", "random"], "margin": 0.2}, [0.2 - both, 0.2 + both], None),
    ]
    for test, bounds, verdict in cases:
        entry = judge(copy, {**names, **test})
        assert entry.interval == pytest.approx(bounds), test
        assert verdict in (None, entry.verdict), test
        assert ("Wilson" if test["kind"] == "mean" else "Newcombe") in entry.test.method


def test_orders_of_shares_allow_for_a_share_of_a_lead(folder):
    """The tested sum has three shares: its interval is that of their weights."""
    test = {"column": "success", "greater": ["sbo-9", "kcbts"], "margin": 0.5, "baseline": "random"}
    entry = judge(folder, {"kind": "order", "by": "variant", **test})
    points = {point.variant: point for point in load(folder).points}
    flags = load(folder).paired([points[name] for name in ("sbo-9", "kcbts", "random")], "success")
    found = statistics.paired_shares(flags, [1.0, -0.5, -0.5])
    assert entry.interval == pytest.approx([found.low, found.high], rel=1e-9)


@pytest.mark.parametrize(("runs", "method"), [(40, "Student's t"), (60, "percentile bootstrap")])
def test_orders_of_means_say_which_interval_they_have(tmp_path, runs, method):
    folder = write_results(tmp_path / "results", runs=runs)
    entry = judge(folder, {"kind": "order", "column": "return", "greater": ["kcbts", "random"]})
    points = {point.label: point for point in load(folder).points}
    ours, theirs = load(folder).paired([points["kcbts"], points["random"]], "return").T
    expected = statistics.mean_interval(ours - theirs)
    assert entry.interval == pytest.approx([expected.low, expected.high])
    assert method in entry.test.method


def test_a_nan_is_a_reason_not_a_number(folder):
    results = load(folder)
    results.runs["return"] = np.where(np.arange(results.runs["return"].size) == 3, np.nan, 1.0)
    entry = evaluate(results)[0]
    assert entry.verdict == "inconclusive"
    assert "1 run of kcbts without a finite return" in entry.test.reason


def test_claims_as_a_sweep_writes_them_give_the_verdict_of_the_file(folder):
    for claim in CLAIMS:
        written = schemas.Claim.model_validate(claim).model_dump(mode="json")
        assert judge(folder, written["test"]).verdict == EXPECTED[claim["id"]]
