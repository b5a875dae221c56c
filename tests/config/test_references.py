"""References in explanations: how they are read, and that those of the shipped sweeps can be filled in."""

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import pytest

from bojax.config.errors import ConfigError
from bojax.config.files import available
from bojax.config.points import Sweep
from bojax.config.references import Mean, OfClaim, matching, pieces, references
from bojax.config.sweep import load_sweep
from bojax.config.sweep_checks import check_reference
from bojax.engine.build import build
from bojax.results.schema import column_names
from tests.config.test_claims import explained
from tests.config.typed_numbers import typed_numbers


@dataclass
class Place:
    """A point of a sweep."""

    label: str
    variant: str
    swept: dict[str, Any] = field(default_factory=dict)


def test_what_stands_in_braces_is_a_mean_a_claim_or_itself():
    text = "With {setting 0.5} m {a/b,\n length 2: return} against {study-x / claim fig-4.4/order: verdict}."
    assert [*pieces(text)] == [
        "With ",
        "0.5",
        " m ",
        Mean("", "a/b, length 2", "return"),
        " against ",
        OfClaim("study-x", "fig-4.4/order", "verdict"),
        ".",
    ]
    assert references("{a: return at step 8}{s / a: return of tests 3-12}{a: return of episodes 1-5}") == [
        Mean("", "a", "return", step=8),
        Mean("s", "a", "return", episodes=(3, 12), phase="test"),
        Mean("", "a", "return", episodes=(1, 5)),
    ]


def test_points_are_named_by_variant_before_label_and_by_swept_values():
    points = [
        Place("sbo", "sbo", {"planner.depth": 1}),
        Place("sbo", "sbo-9", {"planner.depth": 1, "problem.length": 2.0}),
        Place("sbo", "sbo-9", {"planner.depth": 1, "problem.length": 0.5}),
        Place("kcbts", "a, b"),
    ]
    for name, expected in (
        ("sbo", [0]),
        ("sbo-9", [1, 2]),
        ("sbo-9, length 2", [1]),
        ("sbo-9, depth 1, problem.length 0.5", [2]),
        ("sbo-9, length 3", []),
        ("kcbts", [3]),
        ("a, b", [3]),
        ("c", []),
    ):
        assert matching(points, name) == [points[index] for index in expected], name


def test_typed_numbers_are_results_without_a_reference():
    text = (
        "In Fig. 4.4, Figs. 5.2 to 5.4, Table 5.1 and 5.3, Section 4.7.1, p. 97 and (4.13), {a: return} with "
        "{setting 0.5} m against {thesis 93.5%}, 20 actions, 3 of 4 planners, see table-5.3-hopper."
    )
    assert typed_numbers(text) == []
    text = (
        "Returns 0.83 and 1,234.5, in 97.5% and 40% of the runs, in all of 200\nruns, for 8 (4.50) or (0.08)."
    )
    assert typed_numbers(text) == ["0.83", "1,234.5", "97.5%", "40%", "of 200 runs", "4.50", "0.08"]


COLUMNS_OF_MERGED = {"run", "runs", "seed", "nans", "point", "label"}
"""Columns of `runs.parquet` that no experiment declares, and the number of runs."""


shipped = cache(load_sweep)


@cache
def tables_of(sweep: str, name: str) -> dict[str, set[str]]:
    """The columns of each table of the point of a sweep with a name, which is the first of its variants."""
    experiment = build(matching(shipped(sweep).points, name)[0].config)
    return {key: {*column_names(table)} for key, table in experiment.tables.items()}


def check_columns(sweep: Sweep) -> None:
    """Refuse columns of claims and of explanations that their points lack."""
    own = sweep.name if sweep.is_published else "parking"
    for claim in sweep.claims:
        values = dict(claim.test)
        if isinstance(column := values.get("column"), str):
            for name in claim.test.names:
                known = set[str]().union(*tables_of(own, name).values())
                assert column in known, f"{claim.id}: {column} of {name}"
    for explanation in sweep.report.get("explanations", ()):
        for reference in references(explanation["text"]):
            other = shipped(reference.sweep) if reference.sweep else sweep
            check_reference(reference, other, sweep.name)
            if isinstance(reference, Mean):
                table = "steps" if reference.step else "episodes" if reference.episodes else "runs"
                known = tables_of(reference.sweep or own, reference.point)[table] | COLUMNS_OF_MERGED
                assert reference.column in known, f"{sweep.name}: {reference}"


def made_up(text: str, column: str = "success") -> Sweep:
    """A sweep with one claim, explained by a text."""
    return explained({"claims": ["a"], "cause": "unexplained", "text": text}, column=column)


def test_columns_and_points_that_cannot_exist_are_found():
    check_columns(
        made_up("{kcbts: runs}, {kcbts: accumulated_reward at step 3}, {fig-5.2a / additive: steps}")
    )
    for text, column in (
        ("{kcbts: retur}", "success"),
        ("{kcbts: x of episodes 1-2}", "success"),
        ("", "succes"),
    ):
        with pytest.raises((AssertionError, KeyError)):
            check_columns(made_up(text or "Because.", column))
    for text, reason in (
        ("fig-5.2a / kcbts", "unknown point"),
        ("fig-5.6b / emu-q", "the name of .* points"),
    ):
        with pytest.raises(ConfigError, match=reason):
            check_columns(made_up(f"{{{text}: steps}}"))


def test_the_explanations_and_claims_of_shipped_sweeps_refer_to_what_exists():
    sweeps = [shipped(name) for name in available("sweeps")]
    explained = [sweep for sweep in sweeps if sweep.claims]
    assert len(explained) > 20
    for sweep in explained:
        check_columns(sweep)
