"""A multiverse analysis: its designs, its declaration, and the outcomes of claims in all configurations."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from bojax.claims.multiverse import designs, outcomes
from bojax.claims.multiverse.declaration import declared, names
from bojax.claims.multiverse.outcomes import ClaimOutcomes, Confirmed, Multiverse
from bojax.claims.multiverse.page import write_page
from bojax.cli import multiverse
from bojax.cli.main import main
from bojax.config.errors import ConfigError
from bojax.report import statistics, verdicts
from bojax.results.store import ResultsError
from tests.compiling import IS_CPU
from tests.report.synthetic import edit_manifest, write_results

SWEEP = """
title: A short chain
base: {experiment: learning, env: {kind: chain, length: 4}, learner: exploration-values, episodes: 3}
axes:
  learner:
    usual: {kind: exploration-values}
    greedy: {kind: epsilon-greedy}
    odd: {kind: epsilon-greedy, epsilon: 0.9}
runs: 20
claims:
  - id: own/finds
    source: Table 1
    claim: the goal is found
    test: {kind: share, by: variant, label: usual, column: success, above: 0.5}
  - id: own/above
    source: Table 1
    claim: the goal is found more often
    test: {kind: order, by: variant, greater: [usual, greedy], column: success}
  - id: own/steps
    source: Table 2
    claim: the goal is found always
    thesis: 1.0
    class: variant
    test: {kind: agrees, by: variant, label: odd, column: success, share: 1.0, runs: 20}
"""

FILE = """
title: An own paper
sweeps: [own.yaml]
choices:
  rate: {says: rate, source: not stated, of: [usual], setting: learner.learning_rate, values: [0.1, 0.5]}
  cap: {says: longest episode, source: not stated, values: {long: {}, short: {env.max_steps: 3}}}
runs: 20
confirm: {runs: 20, seed: 7}
"""


@pytest.fixture
def paper(tmp_path) -> Path:
    (tmp_path / "own.yaml").write_text(SWEEP)
    (tmp_path / "universe.yaml").write_text(FILE)
    return tmp_path / "universe.yaml"


def test_a_grid_has_all_combinations_and_a_random_design_distinct_ones():
    assert designs.grid([2, 3]) == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]
    found = designs.random([4, 3, 5], 40, seed=1)
    assert len(set(found)) == 40 and found[0] == (0, 0, 0)
    assert found == designs.random([4, 3, 5], 40, seed=1) != designs.random([4, 3, 5], 40, seed=2)
    many = np.array(designs.random([2, 3, 5, 7, 11], 2000, seed=0))
    for column, size in enumerate([2, 3, 5, 7, 11]):
        counts = np.bincount(many[:, column], minlength=size)
        assert np.abs(counts - 2000 / size).max() < 4 * np.sqrt(2000 / size)
    assert designs.random([2, 2], 4, seed=0) == designs.grid([2, 2])
    with pytest.raises(ValueError, match="at most 4"):
        designs.random([2, 2], 5, seed=0)


@pytest.mark.parametrize(("sizes", "count"), [([2] * 6, 64), ([2, 4, 2, 4, 2, 2, 2], 64), ([8, 2, 2], 32)])
def test_the_values_of_two_choices_meet_equally_often_in_a_fraction(sizes, count):
    runs = np.array(designs.fractional(sizes, count))
    assert len(set(map(tuple, runs.tolist()))) == count == len(runs) and not runs[0].any()
    for one, other in itertools.combinations(range(len(sizes)), 2):
        table = np.zeros((sizes[one], sizes[other]), int)
        np.add.at(table, (runs[:, one], runs[:, other]), 1)
        assert np.ptp(table) == 0


def test_main_effects_are_not_confounded_with_interactions_of_two_choices():
    runs = 1 - 2 * np.array(designs.fractional([2] * 8, 16))  # 2^(8-4), which has resolution IV
    for effect, pair in itertools.product(range(8), itertools.combinations(range(8), 2)):
        assert effect in pair or runs[:, [effect, *pair]].prod(axis=1).sum() == 0


@pytest.mark.parametrize(("sizes", "count"), [([2, 3], 16), ([2, 2], 12), ([2] * 9, 8), ([4, 4], 8)])
def test_a_fraction_that_does_not_exist_is_refused(sizes, count):
    with pytest.raises(ValueError, match="allowed"):
        designs.fractional(sizes, count)


def test_shipped_analyses_fit_their_sweeps():
    for name in names():
        assert declared(name).configurations[0] == (0,) * len(declared(name).file.choices)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "values: [0.1, 0.5]",
            "values: [0.2, 0.5]",
            "choices.rate.values: the first changes usual of own.yaml",
        ),
        ("values: [0.1, 0.5]", "values: [0.1, 5.0]", "choices.rate.5.0: learner.learning_rate of usual"),
        ("values: [0.1, 0.5]", "values: [0.1]", "values: got one; allowed: at least two"),
        ("values: [0.1, 0.5]", "values: [0.1, 0.1]", "a value twice"),
        ("of: [usual]", "of: [nobody]", 'choices.rate: got "0.5", which changes no point'),
        ("learner.learning_rate", "learner.rate", 'choices.rate: got "0.5", which changes no point'),
        ("setting: learner.learning_rate, ", "", "setting: missing"),
        ("of: [usual]", "sweeps: [other.yaml]", 'choices.rate.sweeps: got "other.yaml"; allowed: own.yaml'),
        ("short: {env.max_steps: 3}", "short: {}", 'choices.cap: got "short", which changes no point'),
        (
            "short: {env.max_steps: 3}",
            "short: {env.max_steps: 3}, brief: {env.max_steps: 3}",
            'choices.cap: got "short" and "brief", which are equal; allowed: distinct values',
        ),
        ("long: {}", "long: {env.max_steps: 9}", "choices.cap.values: the first changes usual"),
        ("sweeps: [own.yaml]", "sweeps: [other.yaml]", "other.yaml: no such file"),
        ("sweeps: [own.yaml]", "sweeps: []", "sweeps"),
        ("seed: 7", "seed: 0", "confirm.seed: got 0, the seed of the analysis"),
        ("runs: 20\nconfirm", "design: {kind: random}\nconfirm", "configurations: needed"),
        ("runs: 20\nconfirm", "design: {kind: random, configurations: 9}\nconfirm", "at most 4"),
        ("runs: 20\nconfirm", "design: {kind: fractional, configurations: 3}\nconfirm", "powers of 2"),
        ("runs: 20\nconfirm", "runs: 2\nconfirm", "runs"),
        ("title: An", "titel: An", "titel: unknown key"),
    ],
)
def test_a_wrong_declaration_is_an_error_in_one_line(paper, old, new, message):
    text = paper.read_text()
    assert text.count(old) >= 1
    paper.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError) as error:
        declared(str(paper))
    assert message in str(error.value) and "\n" not in str(error.value)


def test_two_choices_of_one_setting_are_refused(paper):
    paper.write_text(paper.read_text().replace("short: {env", "short: {learner.learning_rate: 0.2, env"))
    declaration = declared(str(paper))
    with pytest.raises(
        ConfigError, match=r"choices\.cap\.short: sets learner\.learning_rate of usual, which .*rate"
    ):
        declaration.sweep("own.yaml", range(4), None, None)


def test_settings_replace_those_of_the_axes_where_they_are_meant(paper):
    sweep = declared(str(paper)).sweep("own.yaml", [0, 3], None, 5)
    assert [point.swept["configuration"] for point in sweep.points] == ["0", "0", "3", "3"]
    usual, greedy = sweep.points[2:]
    assert (usual.variant, usual.config.learner.learning_rate, usual.config.env.max_steps) == (
        "usual",
        0.5,
        3,
    )
    assert greedy.config.learner.learning_rate == sweep.points[1].config.learner.learning_rate
    assert (sweep.runs, sweep.seed, sweep.record.runs, sweep.published) == (20, 5, 0, None)


def test_variants_and_points_that_no_claim_compares_are_left_out(paper):
    sweep = declared(str(paper)).sweep("own.yaml", range(4), None, None)
    assert [claim.id for claim in sweep.claims] == ["own/finds", "own/above"]
    assert {point.variant for point in sweep.points} == {"usual", "greedy"}
    assert [point.index for point in sweep.points] == list(range(len(sweep.points)))
    own = paper.parent / "own.yaml"
    own.write_text(
        own.read_text()
        .replace("    test:", "    class: check\n    test:")
        .replace("class: variant\n    ", "")
    )
    with pytest.raises(ConfigError, match=r"own.yaml: claims: none is of class claim"):
        declared(str(paper))


def test_configurations_share_the_points_that_no_choice_changes(paper):
    points = declared(str(paper)).sweep("own.yaml", range(4), None, None).points
    shared = [(point.variant, point.swept["configuration"]) for point in points]
    assert shared[:2] == [("usual", "0"), ("greedy", "0 2")]
    assert [numbers for variant, numbers in shared if variant == "greedy"] == ["0 2", "1 3"]
    assert [numbers for variant, numbers in shared if variant == "usual"] == ["0", "1", "2", "3"]


def test_a_choice_leaves_out_sweeps_and_variants_that_it_is_not_about(paper):
    (paper.parent / "second.yaml").write_text(SWEEP.replace("own/", "second/"))
    text = FILE.replace("sweeps: [own.yaml]", "sweeps: [own.yaml, second.yaml]")
    paper.write_text(text.replace("of: [usual]", "not_of: [greedy], sweeps: [second.yaml]"))
    declaration = declared(str(paper))
    last = len(declaration.configurations) - 1  # the other value of both choices
    rates, caps = {}, {}
    for source in declaration.file.sweeps:
        points = declaration.sweep(source, [0, last], None, None).points
        rates[source] = [point.config.learner.learning_rate for point in points]
        caps[source] = {point.config.env.max_steps for point in points[2:]}
    assert rates == {"own.yaml": [0.1] * 4, "second.yaml": [0.1, 0.1, 0.5, 0.1]}
    assert caps == {"own.yaml": {3}, "second.yaml": {3}}


def test_a_setting_of_a_later_configuration_is_located(paper):
    declaration = declared(str(paper))
    sweep = declaration.sweep("own.yaml", [0, 3], None, None)
    where = ("learner", "learning_rate")
    assert "own.yaml: axes.learner.greedy" in sweep.locate(1, where)  # no choice is about this point
    assert "choices.rate.0.5: learner.learning_rate of usual" in sweep.locate(2, where)


def claim(name: str, verdicts: str, thesis=None, ours=None, **others) -> ClaimOutcomes:
    numbers = [1.0] * len(verdicts)
    ours = ours or [None] * len(verdicts)
    lists = {"estimates": numbers, "low": numbers, "high": numbers, "ours": ours}
    return ClaimOutcomes(
        id=name, sweep="own", claim=name, verdicts=verdicts, thesis=thesis, **lists, **others
    )


def entry_with(verdict: verdicts.Verdict) -> verdicts.TestedClaim:
    test = verdicts.TestEntry()
    return verdicts.TestedClaim.model_construct(test=test, interval=None, ours=None, verdict=verdict)


def universe(*claims: ClaimOutcomes) -> Multiverse:
    choices = {
        "rate": {"says": "", "source": "", "values": [1, 2]},
        "cap": {"says": "", "source": "", "values": {"a": {}, "b": {}}},
    }
    return Multiverse(
        name="own",
        declaration={"choices": choices, "runs": 20, "seed": 0, "design": {"kind": "grid"}},
        configurations=[[0, 0], [0, 1], [1, 0], [1, 1]],
        done=[0, 1, 2, 3],
        claims=list(claims),
    )


def test_the_best_configuration_has_most_claims_and_is_then_nearest_to_the_printed_numbers():
    first, second = claim("a", "rrrn"), claim("b", "nrrr", thesis=10.0, ours=[10.0, 30.0, 12.0, 10.0])
    assert outcomes.best_of(universe(first, second)) == 2
    assert outcomes.distance([second], 2) == pytest.approx(0.2) and outcomes.distance([second], 1) == 1.0


def test_variants_in_a_file_of_an_earlier_version_are_left_out(paper, tmp_path):
    made = universe(claim("a", "rrr"), claim("b", "nnn", entry_class="variant"))
    outcomes.write(tmp_path, made.model_copy(update={"done": [0, 1, 2]}))
    begun, entry = outcomes.read(tmp_path), entry_with("not reproduced")
    found = outcomes.extended(begun, declared(str(paper)), {3: [(claim("a", "r"), "own", entry)]})
    assert [(each.id, each.verdicts) for each in found.claims] == [("a", "rrrn")]


def test_strength_and_the_effect_of_each_choice():
    claims = [claim("a", "rrrr"), claim("b", "nnnr"), claim("c", "nnnn"), claim("d", "iiix")]
    assert [each.strength for each in claims] == ["robust", "fragile", "contrary", "undecided"]
    found = outcomes.effects(universe(*claims), claims[1])
    assert [each.estimate for each in found["rate"]] == [0.0, 0.5]
    assert claims[1].share().estimate == 0.25 and claims[1].share().low > 0
    assert list(outcomes.effects(universe(*claims), claim("b", "nnnr", choices=["cap"]))) == ["cap"]


def test_choices_concern_the_claims_whose_points_they_change():
    choices_of_claims = declared("5.7").choices_of_claims
    assert choices_of_claims["fig-5.6b/emu-q-linear"] == ["chain-features", "chain-alpha"]
    assert choices_of_claims["table-5.3-mountain-car/emu-q-success"] == [
        "refit",
        "terminal-u",
        "starts",
        "mountain-car-actions",
        "mountain-car-goal",
    ]
    assert "rff-rate" in choices_of_claims["table-5.3-mountain-car/similar"]


def test_the_page_of_every_kind(tmp_path):
    claims = [
        claim("a", "rrrn"),
        claim("b", "nnix"),
        claim("c", "xxxx"),
        claim("d", "rnni"),
    ]
    confirmed = Confirmed(runs=20, seed=1, own={"a": "n"}, best={"a": "r"})
    told = {"title": "A <title>", "reading": "Plausible."}
    made = universe(*claims).model_copy(update={"best": 1, "confirmed": confirmed, **told})
    for suffix in ("html", "md"):
        text = write_page(made, tmp_path / f"page.{suffix}").read_text()
        assert "Plausible." in text and "rate" in text
        assert "other configurations (2)" in text and "1 undecided" in text and "100%" in text
    assert (tmp_path / "figures" / "own-together.svg").is_file()


def test_a_claim_that_several_sweeps_make_is_told_with_its_sweep(tmp_path):
    of = {"claim": "it learns", "source": "Fig. 1"}
    claims = [claim(name, "rrrn").model_copy(update=of | {"sweep": name}) for name in ("cliff", "taxi")]
    text = write_page(universe(*claims, claim("alone", "rrrr")), tmp_path / "page.md").read_text()
    assert "it learns (Fig. 1; cliff)" in text and "it learns (Fig. 1; taxi)" in text and "; own" not in text


def run(paper: Path, out: Path, *words: str) -> int:
    return main(["reproduce", "--multiverse", str(paper), "--out", str(out), *words])


@pytest.mark.skipif(not IS_CPU, reason="compares blocks of different widths")
def test_an_analysis_in_pieces_ends_in_the_bytes_of_one_in_a_piece(paper, tmp_path, capsys):
    epsilon = "of: [greedy], setting: learner.epsilon, values: [0.1, 0.5]"  # one program for all values
    paper.write_text(FILE.replace("values: {long: {}, short: {env.max_steps: 3}}", epsilon))
    assert run(paper, tmp_path / "whole") == 0
    assert run(paper, tmp_path / "pieces", "--configurations", "1") == 0
    begun = json.loads((tmp_path / "pieces" / outcomes.FILE).read_text())
    assert begun["done"] == [0] and begun["best"] is None
    carried = tmp_path / "elsewhere" / outcomes.FILE  # another machine gets nothing but this file
    carried.parent.mkdir()
    carried.write_bytes((tmp_path / "pieces" / outcomes.FILE).read_bytes())
    assert run(paper, tmp_path / "elsewhere", "--resume") == 0
    whole, other = ((tmp_path / name / outcomes.FILE).read_bytes() for name in ("whole", "elsewhere"))
    assert whole == other
    made = outcomes.read(tmp_path / "whole")
    assert made.done == [0, 1, 2, 3] and made.best is not None and made.confirmed is not None
    outcomes.write(tmp_path / "elsewhere", made.model_copy(update={"confirmed": None}))
    assert run(paper, tmp_path / "elsewhere", "--resume", "--configurations", "0") == 0  # runs nothing
    assert outcomes.read(tmp_path / "elsewhere").confirmed is None
    assert next(each for each in made.claims if each.id == "own/finds").verdicts[0] == "r"
    printed = capsys.readouterr().err
    assert "configurations are left" in printed
    assert "in 4 configurations of 2 choices: " in printed and " robust" in printed


def test_claims_that_cannot_be_tested_and_runs_that_fail_are_told(paper, tmp_path, capsys, monkeypatch):
    own = paper.with_name("own.yaml")
    own.write_text(
        own.read_text().replace("label: usual, column: success", "label: usual, column: success, within: 3")
    )
    ran = multiverse._run
    monkeypatch.setattr(multiverse, "_run", lambda *given: (1, ran(*given)[1]))  # as after a failed chunk
    assert run(paper, tmp_path / "out", "--configurations", "1") == 1
    reason = "own/finds is not tested in 1 of 1 configurations: a run of usual continues after its success"
    printed = capsys.readouterr().err
    assert reason in printed and "undecided" in printed


def test_results_of_another_declaration_are_refused(paper, tmp_path, capsys):
    made = outcomes.begin(declared(str(paper)))
    outcomes.write(tmp_path / "out", made)
    paper.write_text(paper.read_text().replace("[0.1, 0.5]", "[0.1, 0.4]"))
    assert run(paper, tmp_path / "out", "--resume") == 2
    assert "was made by another version of universe" in capsys.readouterr().err
    (tmp_path / "out" / outcomes.FILE).write_text("{")
    with pytest.raises(ResultsError, match="truncated"):
        outcomes.read(tmp_path / "out")


def test_wrong_words(refusal):
    for words, message in (
        ("--multiverse nope", "no such name in sweeps/multiverse/"),
        ("--multiverse nope.yaml", "nope.yaml: no such file"),
        ("--configurations 3 fig-4.6", "--configurations: needs --multiverse"),
        ("--multiverse 4.4 fig-4.6", "--multiverse: not allowed with ID"),
    ):
        assert message in refusal(f"reproduce {words}")


def test_fresh_seeds_are_judged_with_holm_s_correction(paper, monkeypatch):
    # Of p values .001, .012, .02 and .04, the levels are .0125, .0167, .025 and .05: all hold.
    p_values = {"a": 0.012, "b": 0.04, "c": 0.001, "d": 0.02}
    looked = []

    def evaluated(declaration, folders, numbers):
        tail = statistics.tail_in_use()
        looked.append(round(2 * tail, 6))
        found = {name: "reproduced" if p < 2 * tail else "inconclusive" for name, p in p_values.items()}
        made = {name: claim(name, "r") for name in p_values}
        return {numbers[0]: [(made[name], "own", entry_with(found[name])) for name in p_values]}

    monkeypatch.setattr(outcomes, "evaluated", evaluated)
    declaration = declared(str(paper))
    found = outcomes.confirmed(declaration, {}, [3])
    assert found == {3: {"a": "r", "b": "r", "c": "r", "d": "r"}} and looked == [0.05, 0.0125, 0.025, 0.05]
    p_values["a"] = 0.03
    assert outcomes.confirmed(declaration, {}, [3])[3] == {"a": "i", "b": "i", "c": "r", "d": "i"}
    assert statistics.tail_in_use() == statistics.TAIL


def test_the_page_of_a_reproduction_has_the_shares_of_a_multiverse(tmp_path, capsys):
    results, found = tmp_path / "results", tmp_path / "found"
    write_results(results / "fig-4.6", recorded=0)
    known = {"name": "fig-4.6", "written": "2026-01-02T10:00:00+0000", "command": "bojax reproduce fig-4.6"}
    edit_manifest(results / "fig-4.6", lambda manifest: manifest.update(known))
    claims = [claim("fig-4.6/random-leaves", "rrin"), claim("fig-4.6/other", "nnnn")]
    made = universe(*(each.model_copy(update={"sweep": "fig-4.6"}) for each in claims))
    outcomes.write(found, made.model_copy(update={"title": "Parking"}))
    page = tmp_path / "page.md"
    assert main(["reproduce", "--page", str(results), str(found), "--out", str(page)]) == 0
    text = page.read_text()
    assert "[Parking](page/multiverse-own.md)" in text
    (row,) = [line for line in text.splitlines() if "random incurs penalties" in line]
    assert row.endswith("| 50.0% of 4 |")
    assert "fig-4.6/other" in (tmp_path / "page" / "multiverse-own.md").read_text()
    assert (tmp_path / "page" / "figures" / "own-shares.svg").is_file()
