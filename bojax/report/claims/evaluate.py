"""Verdicts on the claims of a sweep: each is decided by the statistical test that the claim names.

A claim is `reproduced` or `not reproduced` where an interval excludes the opposite, and otherwise
`inconclusive`. It is also `inconclusive`, with the reason, where data are missing or too few, or where the
test fails.
"""

import importlib
from dataclasses import astuple
from typing import Any

import numpy as np

from bojax.config.claims import Claim, Test
from bojax.report.claims.finding import Finding
from bojax.report.claims.samples import Undecidable
from bojax.report.columns import NoColumn
from bojax.report.manifest import Unread
from bojax.report.source import Results
from bojax.results.store import ResultsError
from bojax.text import error_line


def evaluate(results: Results) -> list[dict[str, Any]]:
    """The entries of `claims.json`, one per claim of the sweep, in its order."""
    return [_entry(results, claim) for claim in results.claims]


def decide(results: Results, test: Test) -> Finding:
    """Make a test."""
    module, _, name = type(test).target.partition(":")
    try:
        return getattr(importlib.import_module(module), name)(results, test)
    except NoColumn as error:
        raise Undecidable(str(error)) from None


def _entry(results: Results, claim: Claim | Unread) -> dict[str, Any]:
    is_read = isinstance(claim, Claim)
    settings = claim.model_dump(mode="json") if is_read else claim.mapping
    test = claim.test.model_dump(mode="json", exclude_none=True) if is_read else settings.get("test") or {}
    entry: dict[str, Any] = {key: settings.get(key) for key in ("id", "source", "claim", "thesis")}
    entry |= {"changed": dict(results.manifest.changed), "ours": None, "interval": None, "runs": 0}
    entry["verdict"] = "inconclusive"
    try:
        if isinstance(claim, Unread):
            raise Undecidable(claim.reason)
        finding = decide(results, claim.test)
        numbers = [number for each in finding.comparisons for number in astuple(each.interval)]
        if not np.isfinite([*numbers, 0.0 if isinstance(finding.ours, str) else finding.ours]).all():
            raise Undecidable("the numbers are too large for their mean to be finite")
    except ResultsError:
        raise
    except Exception as error:  # a failed test must not cost the other verdicts
        reason = str(error) if isinstance(error, Undecidable) else f"the test failed: {error_line(error)}"
        return {**entry, "test": {**test, "reason": reason}}
    comparisons = [
        {"of": each.of, "estimate": _rounded(estimate), "interval": [_rounded(low), _rounded(high)]}
        for each in finding.comparisons
        for estimate, low, high in [astuple(each.interval)]
    ]
    return {
        **entry,
        "ours": finding.ours if isinstance(finding.ours, str) else _rounded(finding.ours),
        "interval": comparisons[finding.comparisons.index(finding.decisive)]["interval"],
        "runs": finding.runs,
        "verdict": finding.verdict,
        "test": {
            **test,
            "method": finding.method,
            "comparisons": comparisons,
            "chosen": dict(finding.chosen),
        },
    }


def _rounded(value: float) -> float:
    # Ten digits: sums in another order differ in the last bits, and the file should not.
    return float(f"{value:.10g}")
