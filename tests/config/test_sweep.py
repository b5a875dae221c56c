"""Experiment and sweep files become points: overrides, axes, defaults, aliases."""

import re

import pytest

from bojax.config.component import Component
from bojax.config.errors import ConfigError
from bojax.config.files import available, shipped
from bojax.config.points import Sweep
from bojax.config.settings import EngineConfig, Record
from bojax.config.sweep import load_config, load_sweep
from bojax.motions.settings import KernelTrajectories, Splines
from bojax.planning.settings import KCBTS, SBO
from bojax.problems.settings import Parking


def planner(sweep: Sweep, index: int = 0) -> Component:
    """The planner of a point."""
    return sweep.points[index].config.planner


def test_every_config_and_every_sweep_loads():
    for name in available("configs"):
        sweep = load_config(name)
        assert sweep.name == name != sweep.title and len(sweep.points) == 1
    for name in available("sweeps"):
        sweep = load_sweep(name)
        assert sweep.name == name
        settings = [(point.variant, *map(str, point.swept.values())) for point in sweep.points]
        assert len(set(settings)) == len(settings), name
        for each in sweep.report.get("explanations", ()):
            assert each["cause"] != "choice" or "sweeps" in each, "the sweeps that show the choice"


def test_the_parking_sweep_is_figure_4_6():
    sweep = load_sweep("parking")
    assert {point.label for point in sweep.points} == {"kcbts", "sbo", "gps-abt", "random"}
    assert [point.variant for point in sweep.points[:4]] == ["kcbts", "sbo", "gps-abt", "random"]
    assert sweep.runs == 200
    assert sweep.points == load_sweep("fig-4.6").points
    assert {claim.test.kind for claim in sweep.claims} == {"order", "share", "trend"}


def test_a_file_in_the_working_directory_hides_a_shipped_one(write):
    assert load_sweep("parking").source == shipped("sweeps") / "fig-4.6.yaml"
    assert load_sweep("parking").is_published
    path = write("configs/parking.yaml", "planner: sbo")
    assert load_config("parking").source.resolve() == path
    write("sweeps/parking.yaml", "{base: {}, axes: {planner.depth: [1, 2]}}")
    assert not load_sweep("parking").is_published
    assert planner(load_config(str(path))) == SBO()


def test_an_experiment_needs_almost_nothing(write):
    write("x.yaml", "planner: sbo")
    sweep = load_config("x.yaml")
    (point,) = sweep.points
    assert (sweep.name, sweep.title, sweep.runs, sweep.seed) == ("x", "x", 1, 0)
    assert (sweep.record, sweep.engine, sweep.claims) == (Record(), EngineConfig(), ())
    assert (point.index, point.label, point.variant, point.swept) == (0, "sbo", "sbo", {})
    assert sweep.base == {"experiment": "planning", "planner": "sbo"}


def test_options_and_overrides_take_precedence_over_the_file(write):
    write("x.yaml", "{runs: 5, seed: 1, engine: {device: cpu, segment_seconds: 9}}")
    sweep = load_config("x.yaml", ["seed=2", "engine.device=gpu"], runs=7)
    assert (sweep.runs, sweep.seed) == (7, 2)
    assert sweep.engine == EngineConfig(device="gpu", segment_seconds=9)


def test_an_option_and_an_override_of_one_setting_are_refused():
    for name in ("runs", "seed"):
        given = f"^command line: {name}: given twice, as {name}=6 and as --{name} 7$"
        with pytest.raises(ConfigError, match=given):
            load_sweep("parking", [f"{name}=6"], **{name: 7})


OVERRIDDEN = [
    # Values are typed by YAML.
    ("planner: kcbts", "planner.noise_variance=1e-3", KCBTS(noise_variance=1e-3)),
    # A name replaces the part.
    ("planner: {kind: kcbts, iterations: 10}", "planner=sbo", SBO()),
    ("planner: {kind: kcbts, iterations: 10}", "planner=kcbts", KCBTS()),
    # A new kind discards the settings of the old one.
    ("planner: {kind: kcbts, max_actions: 10}", "planner.kind=sbo", SBO()),
    ("planner: {kind: kcbts, max_actions: 10}", "planner.kind=kcbts", KCBTS(max_actions=10)),
    # A mapping without a kind changes settings of the part that is there, not of the default part.
    ("planner: {kind: sbo, iterations: 10}", "planner={depth:\u00a02}", SBO(iterations=10, depth=2)),
    ("planner: sbo", "planner={depth:\u00a02}", SBO(depth=2)),
    # The order does not matter.
    (
        "planner: kcbts",
        "planner.motions.length=2 planner.motions.kind=splines planner=sbo planner.depth=2",
        SBO(depth=2, motions=Splines(length=2.0)),
    ),
    # Settings of a default part, and a part as a mapping.
    ("planner: kcbts", "planner.motions.length=2", KCBTS(motions=KernelTrajectories(length=2.0))),
    ("planner: kcbts", "planner={kind:\u00a0sbo,depth:\u00a02}", SBO(depth=2)),
]


def test_overrides_change_parts(write):
    for text, words, expected in OVERRIDDEN:
        write("x.yaml", text)
        changes = [word.replace("\u00a0", " ") for word in words.split(" ")]
        assert planner(load_config("x.yaml", changes)) == expected
        assert planner(load_config("x.yaml", changes[::-1])) == expected
    assert load_config("x.yaml", ["dtype=float32"]).points[0].config.dtype == "float32"


class TestAxes:
    """Sweeps expand into points."""

    def test_a_grid_of_values(self, write):
        write("x.yaml", "{base: {}, axes: {planner.depth: [1, 2], problem.position_noise: [0, 0.1]}}")
        sweep = load_sweep("x.yaml")
        expected = [(1, 0.0), (1, 0.1), (2, 0.0), (2, 0.1)]
        assert [tuple(point.swept.values()) for point in sweep.points] == expected
        assert list(sweep.points[0].swept) == ["planner.depth", "problem.position_noise"]
        assert isinstance(sweep.points[0].swept["problem.position_noise"], float)
        assert planner(sweep, 2) == KCBTS(depth=2)
        assert {point.variant for point in sweep.points} == {"kcbts"}
        assert sweep.runs == 200

    def test_a_zip_of_values(self, write):
        axes = "{planner.depth: [1, 2], planner.iterations: [10, 20]}"
        write("x.yaml", f"{{base: {{}}, combine: zip, axes: {axes}}}")
        assert [tuple(point.swept.values()) for point in load_sweep("x.yaml").points] == [(1, 10), (2, 20)]

    def test_no_axes_make_one_point(self, write):
        for combine in ("grid", "zip"):
            write("x.yaml", f"{{base: {{planner: sbo}}, combine: {combine}}}")
            (point,) = load_sweep("x.yaml").points
            assert (point.label, point.variant, point.swept) == ("sbo", "sbo", {})

    def test_a_named_subtree_of_the_same_kind_is_merged_into_the_base(self, write):
        write(
            "x.yaml",
            """
            base: {planner: {kind: kcbts, iterations: 50}}
            axes:
              planner:
                kcbts: {}
                deep: {depth: 5}
                deep-kcbts: {kind: kcbts, depth: 5}
                sbo: {}
                sbo-9: {kind: sbo, motions: {actions: 9}}
                short: {motions: {length: 0.5}}
                plain: sbo
            """,
        )
        sweep = load_sweep("x.yaml")
        assert [planner(sweep, index) for index in range(7)] == [
            KCBTS(iterations=50),
            KCBTS(iterations=50, depth=5),
            KCBTS(iterations=50, depth=5),
            SBO(),
            SBO(motions=Splines(actions=9)),
            KCBTS(iterations=50, motions=KernelTrajectories(length=0.5)),
            SBO(),
        ]
        assert [point.variant for point in sweep.points][:3] == ["kcbts", "deep", "deep-kcbts"]
        assert sweep.points[4].label == "sbo" and sweep.points[4].swept == {"planner": "sbo-9"}

        # Over a default.
        write("x.yaml", "{base: {planner: {iterations: 50}}, axes: {planner: {kcbts: {}, more: {depth: 4}}}}")
        sweep = load_sweep("x.yaml")
        assert [planner(sweep, 0), planner(sweep, 1)] == [KCBTS(iterations=50), KCBTS(iterations=50, depth=4)]

    def test_two_named_axes(self, write):
        axes = "{planner: {kcbts: {}, sbo: {}}, problem: {calm: {half_width: 3}, usual: {}}}"
        write("x.yaml", f"{{base: {{}}, axes: {axes}}}")
        sweep = load_sweep("x.yaml")
        variants = ["kcbts/calm", "kcbts/usual", "sbo/calm", "sbo/usual"]
        assert [point.variant for point in sweep.points] == variants
        config = sweep.points[2].config
        assert config.problem == Parking(half_width=3.0)

    def test_names_of_plain_values_and_kinds_as_values(self, write):
        write("x.yaml", "{base: {}, axes: {planner.depth: {shallow: 1, deep: 9}}}")
        sweep = load_sweep("x.yaml")
        assert planner(sweep, 1) == KCBTS(depth=9)
        assert sweep.points[1].swept == {"planner.depth": "deep"}
        write("x.yaml", "{base: {}, axes: {planner: [kcbts, sbo]}}")
        sweep = load_sweep("x.yaml")
        assert [point.variant for point in sweep.points] == ["kcbts", "sbo"]
        assert sweep.points[1].swept == {"planner": "sbo"}

    def test_an_override_below_an_axis_goes_to_every_point_that_has_it(self, write):
        write("x.yaml", "{base: {}, axes: {planner: {kcbts: {}, sbo-2: {kind: sbo, depth: 2}, random: {}}}}")
        sweep = load_sweep("x.yaml", ["planner.iterations=7", "problem.half_width=2"])
        assert [planner(sweep, 0), planner(sweep, 1)] == [KCBTS(iterations=7), SBO(iterations=7, depth=2)]
        assert sweep.points[2].label == "random"
        assert sweep.points[2].config.problem == Parking(half_width=2.0)


class TestFiles:
    """Bases and aliases."""

    def test_a_base_by_name_and_by_path(self, write):
        engine = "engine: {device: cpu, segment_seconds: 3}"
        write("configs/mine.yaml", f"{{planner: sbo, runs: 3, seed: 4, {engine}}}")
        write("sweeps/a.yaml", "{base: mine}")
        write("sweeps/b.yaml", "{base: ../configs/mine.yaml, runs: 5, engine: {device: auto}}")
        first, second = load_sweep("a"), load_sweep("b")
        assert first.points == second.points and first.points[0].label == "sbo"
        assert (first.runs, first.seed, second.runs, second.seed) == (3, 4, 5, 4)
        assert second.engine == EngineConfig(device="auto", segment_seconds=3.0)

    def test_a_base_is_not_the_sweep_of_the_same_name(self, write):
        write("configs/same.yaml", "planner: sbo")
        write("sweeps/same.yaml", "base: same")
        assert load_sweep("same").points[0].label == "sbo"

    def test_a_saved_learner_is_relative_to_the_config_that_a_run_or_a_sweep_starts_from(self, write):
        parts = "env: chain, learner: additive, schedule: exploit"
        file = write("hill/experiment.yaml", f"{{experiment: learning, {parts}, saved: learner}}")
        (file.parent / "learner").mkdir()
        write("a.yaml", "{base: hill, axes: {saved_run: [0, 3]}}")
        found = [*load_config("hill").points, *load_sweep("a.yaml").points]
        assert [point.config.saved for point in found] == ["hill/learner"] * 3

    def test_an_alias_keeps_its_own_name(self, write):
        write("sweeps/fig-1.yaml", "{title: Figure 1, base: {planner: sbo}}")
        write("sweeps/plain.yaml", "alias: fig-1")
        sweep = load_sweep("sweeps/plain.yaml")
        assert (sweep.name, sweep.title, sweep.source.name) == ("plain", "Figure 1", "fig-1.yaml")

    def test_claims_and_report(self, write):
        write(
            "x.yaml",
            """
            base: {}
            axes: {planner: {kcbts: {}, sbo: {}}}
            report: {figures: [returns]}
            claims:
              - {id: a, source: p. 1, claim: better, thesis: 3,
                 test: {kind: order, column: return, greater: [kcbts, sbo]}}
              - {id: b, source: p. 1, claim: falls,
                 test: {kind: trend, label: sbo, column: reward, from: 1, to: 5, direction: falls}}
            """,
        )
        sweep = load_sweep("x.yaml")
        assert sweep.report == {"figures": ["returns"]}
        assert [claim.thesis for claim in sweep.claims] == [3, None]
        test = {"kind": "trend", "by": "label", "label": "sbo", "column": "reward", "ended": "kept"}
        dumped = sweep.claims[1].model_dump(mode="json")
        assert dumped["test"] == test | {"from": 1, "to": 5, "direction": "falls"}

    def test_the_return_of_a_learning_run_is_named_by_its_last_episode(self, write):
        """One return of many is not the return; a window of episodes, and planning, have it."""
        window = "window: {from: 1, to: 2}"
        label = "axes: {learner: {emu-q: {}}}\nbase: {experiment: learning, env: chain}"

        def load(head, test="", report=""):
            claim = f"claims: [{{id: a, source: p. 1, claim: high, test: {{{test}}}}}]" if test else ""
            write("x.yaml", f"{head}\n{claim}\n{report}")
            return load_sweep("x.yaml")

        mean = "kind: mean, label: emu-q, column: return, above: 0"
        refused = [
            ("x.yaml: claims.0.test.column", "last_return", {"test": mean}),
            ("x.yaml: report.rank_by", "-last_return", {"report": "report: {rank_by: -return}"}),
            ("x.yaml: report.column", "last_return", {"report": "report: {column: return}"}),
        ]
        for where, name, words in refused:
            old = name.replace("last_", "")
            with pytest.raises(ConfigError, match=f'^{where}: got "{old}"; did you mean "{name}"'):
                load(label, **words)
        load(label, f"{mean}, {window}")
        load("base: {}\naxes: {planner: {kcbts: {}}}", mean.replace("emu-q", "kcbts"))

    def test_the_setting_over_which_a_claim_grows_is_swept(self, write):
        test = "{kind: growth, label: kcbts, column: return, over: planner.depth, expected: linear}"
        claim = f"[{{id: a, source: b, claim: c, test: {test}}}]"
        write("x.yaml", f"{{base: parking, axes: {{planner.iterations: [1, 2]}}, claims: {claim}}}")
        message = r'claims.0.test.over: got "planner.depth"; no swept setting; allowed: planner.iterations'
        with pytest.raises(ConfigError, match=message):
            load_sweep("x.yaml")

    @pytest.mark.parametrize(
        ("report", "message"),
        [
            ("over: iterations", 'over: got "iterations"; no swept setting; allowed: planner.iterations'),
            ("heat_map: [planner.iterations, b]", 'heat_map: got "b"; no swept setting; allowed: planner.'),
        ],
    )
    def test_the_axes_of_a_figure_are_settings(self, write, report, message):
        write("x.yaml", f"{{base: parking, axes: {{planner.iterations: [1, 2]}}, report: {{{report}}}}}")
        with pytest.raises(ConfigError, match=rf"^x.yaml: report.{re.escape(message)}"):
            load_sweep("x.yaml")

    def test_the_base_of_a_sweep_is_no_sweep(self, write):
        write("x.yaml", "{base: x.yaml, axes: {planner.iterations: [1, 2]}}")
        with pytest.raises(ConfigError, match="^x.yaml: base: x.yaml is a sweep; allowed: an experiment$"):
            load_sweep("x.yaml")
