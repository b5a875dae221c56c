"""The entries of the shipped sweeps: what is counted, and what may be said of it."""

import re

import pytest

from bojax.config.files import available
from bojax.config.sweep import load_sweep
from tests.config.typed_numbers import typed_numbers


@pytest.fixture(scope="module")
def sweeps():
    return [sweep for name in available("sweeps") if (sweep := load_sweep(name)).source.stem == name]


@pytest.fixture(scope="module")
def claims(sweeps):
    return [claim for sweep in sweeps for claim in sweep.claims]


def test_no_entry_occurs_twice(claims):
    ids = [claim.id for claim in claims]
    assert len(set(ids)) == len(ids)


def test_what_is_counted_has_a_page_of_the_thesis_and_a_printed_counterpart(claims):
    for claim in claims:
        if claim.entry_class == "claim":
            is_of_others = claim.id.startswith("pomdp-")
            assert re.search(r"\b20\d\d\b" if is_of_others else r"p\. \d+", claim.source), claim.id
            assert "published code" not in claim.source, claim.id


def test_margins_and_factors_are_said_to_be_ours(claims):
    """The thesis prints no margin and no factor, and no tolerance of a share."""
    for claim in claims:
        test = claim.test
        if getattr(test, "margin", None) or getattr(test, "factor", None):
            assert claim.own_bound, claim.id
        if test.kind == "agrees" and test.share is not None:
            assert claim.own_bound, claim.id


def test_results_in_explanations_are_references(sweeps):
    """A typed number would stay as it is when the results change."""
    for sweep in sweeps:
        for each in sweep.report.get("explanations", ()):
            assert typed_numbers(each["text"]) == [], (sweep.name, each["claims"])
