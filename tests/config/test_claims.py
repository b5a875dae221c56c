"""What the tests of claims take, and what they refuse."""

import pydantic
import pytest

from bojax.config.claims import Claim
from bojax.config.errors import ConfigError
from bojax.config.sweep import load_sweep
from bojax.config.yaml_file import parse
from tests.refusals import one_line
from tests.transcript import cases

DEFAULTS = {"phase": "train", "counted_from": "start", "missing": 0.0}


def validated(test):
    return Claim.model_validate({"id": "a", "source": "s", "claim": "c", "test": test}).test


READ = """\
- {kind: order, column: return, window: {from: 31, to: 100}, greater: [a, b]}
- {kind: order, column: return, window: {from: 31, to: 100}, since: {from: 31, to: 100}, less: [a, b]}
- {kind: ratio, column: r, label: a, to: b, expected: 2, tolerance: 1, window: {from: 31, to: 100}}
- {kind: similar, labels: [a, b], column: r, step: 3, margin: 1, spread_at: 4}
- {kind: similar, labels: [a, b], column: r, window: {from: 31, to: 100}, margin: 1, spread_at: {from: 31,
  to: 100}}
- {kind: similar, labels: [a, b], column: r, margin: 1}
- {kind: similar, labels: [a, b], column: r, factor: 1.1}
- {kind: share, label: a, column: success, window: {from: 31, to: 100}, below: 0.1}
- {kind: mean, label: a, column: r, above: 0, below: 1}
- {kind: mean, label: a, column: r, above: 0, window: {from: 31, to: 100, phase: test, counted_from:
  first-success, missing: 0.05}, statistic: sd}
- {kind: mean, label: a, column: r, above: 0, also: [s, t]}
- {kind: order, column: r, step: 50, since: 40, greater: [a, b]}
- {kind: latency, labels: [a, b]}
- {kind: latency, labels: [a], below: 5.0}
- {kind: trend, label: a, column: r, from: 1, to: 2, direction: rises}
- {kind: trend, label: a, column: r, from: {from: 31, to: 100}, to: {from: 31, to: 100}, direction: falls}
- {kind: agrees, label: a, column: r, mean: 2.95, sd: 0.38, runs: 20}
- {kind: agrees, label: a, column: r, share: 0.9, runs: 20}
- {kind: growth, label: a, column: r, over: env.length, expected: linear}
"""


def test_a_test_reads_as_it_was_written():
    for test in parse(READ, "read"):
        written = validated(test).model_dump(mode="json")
        given = {key: value for key, value in written.items() if value is not None}
        assert validated(given) == validated(test)
        for key, value in test.items():
            assert written[key] == ({**DEFAULTS, **value} if isinstance(value, dict) else value), key


REFUSED = """\
{kind: order, column: r, since: {from: 31, to: 100}, greater: [a, b]}
=> since: needs a step if since is a step, and a window if it is a window
{kind: order, column: r, step: 5, since: {from: 31, to: 100}, greater: [a, b]}
=> since: needs a step
{kind: mean, label: a, column: r, step: 5, since: 5, above: 0}
=> step must lie after since, which is 5
{kind: mean, label: a, column: r, also: [r], above: 0}
=> also: duplicate name
{kind: mean, label: a, column: r, also: [s], above: 0, below: 1}
=> also: needs a single threshold
{kind: mean, label: a, column: r, above: 0, statistic: sd}
=> statistic: needs a window
{kind: mean, label: a, column: r, above: 0, window: {from: 31, to: 100, missing: 0.1}}
=> missing: needs counted_from: first-success
{kind: mean, label: a, column: r}
=> mean: give above, below, or both
{kind: mean, label: a, column: r, above: 1, below: 1}
=> below must exceed above
{kind: mean, label: a, column: r, above: 1, window: {from: 9, to: 8}}
=> to must not lie before from, which is 9
{kind: similar, labels: [a, b], column: r, margin: 1, step: 1, window: {from: 31, to: 100}}
=> give either step or window
{kind: similar, labels: [a, b], column: r, margin: 1, window: {from: 31, to: 100}, spread_at: 3}
=> spread_at: needs a step if step is given
{kind: share, label: a, column: r, within: 1, window: {from: 31, to: 100}, above: 0.5}
=> give either within or window
{kind: trend, label: a, column: r, from: 1, to: {from: 31, to: 100}, direction: rises}
=> give two steps or two windows
{kind: similar, labels: [a, b], column: r}
=> give either margin or factor
{kind: similar, labels: [a, b], column: r, step: 1, factor: 2, spread_at: 3}
=> spread_at: needs a margin
{kind: ratio, label: a, to: b, column: r, expected: 1}
=> a ratio of 1 is tested by kind similar
{kind: agrees, label: a, column: r, runs: 20}
=> either mean and sd, or share
{kind: agrees, label: a, column: r, mean: 1, runs: 20}
=> mean and sd: give both or neither
{kind: agrees, label: a, column: r, mean: 1, sd: 0, runs: 20}
=> tolerance: required because sd is 0
"""


def test_what_makes_no_sense_is_refused():
    for test, reason in cases(REFUSED):
        with pytest.raises(pydantic.ValidationError, match=reason):
            validated(parse(test, "refused"))


def explained(*explanations, column="success"):
    """A sweep with the claim `a`, its report with explanations."""
    test = {"kind": "share", "label": "kcbts", "column": column, "above": 0.5}
    claim = {"id": "a", "source": "s", "claim": "c", "test": test}
    given = [{"text": "Because.", "cause": "slip", **each} for each in explanations]
    return load_sweep({"base": "parking", "claims": [claim], "report": {"explanations": given}})


def test_explanations_are_part_of_the_report():
    (written,) = explained({"claims": ["a"], "sweeps": ["study-ties"]}).report["explanations"]
    assert written == {"claims": ["a"], "cause": "slip", "text": "Because.", "sweeps": ["study-ties"]}


UNEXPLAINED = """\
[{claims: [b]}]
=> explanations.0.claims: got .b.; unknown id; allowed: a
[{claims: [a]}, {claims: [a]}]
=> explanations.1.claims: got .a.; allowed: one explanation
[{claims: [a], sweeps: [study-tie]}]
=> explanations.0.sweeps: got .study-tie.; .*study-ties
[{claims: [a], cause: luck}]
=> explanations.0.cause: got .luck.; allowed: .choice
[{claims: []}]
=> explanations.0.claims
[{claims: [a], text: "kCBTS returns {kcbt: steps}."}]
=> explanations.0.text: got .kcbt.; unknown point; allowed: kcbts
[{claims: [a], text: "{kcbts, depth 3: steps}"}]
=> explanations.0.text: got .kcbts, depth 3.; unknown point
[{claims: [a], text: "{study-tie / kcbts: steps}"}]
=> explanations.0.text: got .study-tie.; .*study-ties
[{claims: [a], text: "{claim b: verdict}"}]
=> explanations.0.text: got .b.; unknown id; allowed: a
[{claims: [a], text: "{claim a: colour}"}]
=> explanations.0.text: got {claim a: colour}; allowed after the colon: verdict, here, interval, share
[{claims: [a], text: "{kcbts}"}]
=> explanations.0.text: got {kcbts}; allowed: {POINT: COLUMN}
[{claims: [a], text: "{kcbts: steps"}]
=> explanations.0.text: got a brace without its counterpart
"""


def test_an_explanation_of_nothing_or_by_nothing_is_refused():
    for explanations, reason in cases(UNEXPLAINED):
        with one_line(ConfigError, reason):
            explained(*parse(explanations, "explanations"))
