"""Explanations: their references are filled in from results at hand, and every failed claim has a cause."""

import json

import numpy as np
import pytest

from bojax.report import verdicts
from bojax.report.build import build_report
from bojax.report.explanations import AtHand, causes_of, explanations_of
from bojax.report.findings import evaluate
from bojax.report.source import load
from bojax.report.statistics import time_interval
from tests.report.synthetic import edit_manifest, set_column, write_results


def results(folder, text="Because."):
    """Made-up results, whose explanation of the claim `share-fails` is a text."""
    why = {"claims": ["share-fails"], "cause": "choice", "text": text}
    write_results(folder, recorded=0, report={"explanations": [why], "figures": ["returns"]})
    edit_manifest(folder, lambda manifest: manifest.update(name="mine"))
    return folder


def at_hand(folder):
    """Results with their claims."""
    found = load(folder)
    return AtHand(found, evaluate(found))


def told(folder, others=None):
    """The explanation of the first claim."""
    (each, *_) = explanations_of(at_hand(folder), others or {})
    return each.text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return results(tmp_path_factory.mktemp("explained") / "mine")


def test_references_are_filled_in_from_the_tables(folder, tmp_path):
    own = at_hand(folder)
    runs = own.results.runs_of(own.results.points[0])
    step = own.results.by_step(own.results.points[0], "accumulated_reward")[:, 3]
    for number, (reference, expected) in enumerate(
        (
            ("{kcbts: success}", "80.0% ["),
            ("{kcbts: return}", f"{runs['return'].mean():.0f}"),
            ("{kcbts: accumulated_reward at step 3}", f"{step.mean():.0f}"),
            ("{kcbts: runs}", "40"),
            ("{sbo-9: success}", "45.0% ["),
            ("{claim share-fails: verdict}", "not reproduced"),
            ("{claim share-open: here}", "45.0%"),
            ("{claim share-open: interval}", "[30.7%, 60.2%]"),
            ("{setting 0.5} and {thesis 93%}", "0.5 and 93%"),
        )
    ):
        text = told(results(tmp_path / str(number), reference))
        assert text.startswith(expected) and "{" not in text and "not measured" not in text, (reference, text)


def test_results_that_are_not_at_hand_are_said_to_be_missing(tmp_path):
    missing = [
        "{study-ties / kcbts: return}",
        "{sbo: success}",
        "{nobody: success}",
        "{kcbts: no_such_column}",
        "{kcbts: return of episodes 1-3}",
        "{kcbts: accumulated_reward at step 99}",
        "{kcbts: label}",
        "{claim share-open: share}",
        "{claim nothing: verdict}",
    ]
    own, other = results(tmp_path / "own", " | ".join(missing)), at_hand(results(tmp_path / "other"))
    assert told(own).split(" | ") == ["(not measured here)"] * len(missing)
    assert told(own, {"study-ties": other})[0].isdigit()


def test_runs_without_a_value_are_counted(tmp_path):
    folder = results(tmp_path / "mine", "{kcbts: return}")
    values = load(folder).runs["return"].copy()
    values[:10] = np.nan
    set_column(folder, "return", values)
    assert told(folder).endswith(" in 30 of 40 runs")


def test_mean_times_have_the_interval_of_the_report(tmp_path):
    folder = results(tmp_path / "mine", "{kcbts: steps_to_goal}")
    values = load(folder).runs["steps"].astype(float)
    values[1::40] = np.nan
    set_column(folder, "steps_to_goal", values)
    known = values[load(folder).runs["label"] == "kcbts"]
    interval = " ".join(time_interval(known[np.isfinite(known)]).in_words())
    assert told(folder) == f"{interval} in 39 of 40 runs"


def test_braces_of_earlier_versions_stay(tmp_path):
    assert told(results(tmp_path / "mine", "The set {a, b}.")) == "The set {a, b}."


def test_every_claim_that_fails_has_a_cause(folder):
    build_report(folder)
    causes = {entry["id"]: entry["cause"] for entry in json.loads((folder / "claims.json").read_text())}
    assert causes == {
        "order-holds": None,
        "order-fails": "unexplained",
        "share-holds": None,
        "share-fails": "choice",
        "share-open": "unexplained",
        "trend-holds": None,
        "missing": "untested",
    }


def test_only_claims_are_counted(folder):
    claims = at_hand(folder).claims
    kinds = {"order-fails": "variant", "share-holds": "check"}
    entries = [claim.model_copy(update={"entry_class": kinds.get(claim.id, "claim")}) for claim in claims]
    told = "5 claims: 2 reproduced, 1 not reproduced and 2 inconclusive; 2 variants or checks"
    assert verdicts.in_words(entries) == told
    own = AtHand(at_hand(folder).results, entries)
    assert causes_of(explanations_of(own, {})).startswith("Causes of the 1 not reproduced: 1 a choice that")
    assert verdicts.in_words([entry for entry in entries if not entry.is_claim]) == "2 variants or checks"
