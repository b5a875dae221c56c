"""A configuration error is one line: the place, the value, the values allowed, the nearest name."""

import re
from collections.abc import Callable, Iterable
from typing import Any

import pytest

from bojax.config.errors import ConfigError, allowed_names, shown
from bojax.config.sweep import load_config, load_sweep
from tests.transcript import cases


def assert_messages(load: Callable[[str], Any], given: Iterable[tuple[str, str]]) -> None:
    """Each text is refused with the message beside it, as a whole; … matches any text."""
    for text, expected in given:
        with pytest.raises(ConfigError) as raised:
            load(text)
        pattern = ".*".join(re.escape(part) for part in expected.split("…"))
        assert re.fullmatch(pattern, str(raised.value)), f"{raised.value}\n{expected}"
        assert raised.value.exit_code == 2


EXPERIMENTS = """\
planner: {kind: sbo, iteratons: 3}
=> x.yaml: planner.iteratons: unknown key; allowed: …; did you mean "iterations"?
{problem: tiger, planner: sbo}
=> x.yaml: experiment: got {…; planner: got sbo; the actions of tiger are vectors; allowed: …pft-dpw…
planner: pomcpow
=> x.yaml: experiment: got {…; planner: got pomcpow; the actions of parking are paths; allowed: kcbts, …
plannr: sbo
=> x.yaml: plannr: unknown key; allowed: …; did you mean "planner"?
planner: {kind: random, depth: 3}
=> x.yaml: planner.depth: unknown key (a setting of kind=…sbo…); allowed: …
{experiment: learning, planner: sbo}
=> x.yaml: planner: unknown key (a setting of experiment=planning); allowed: …
planner: kcbt
=> x.yaml: planner: got "kcbt"; unknown planner; allowed: …; did you mean "kcbts"?
planner: KCBTS
=> x.yaml: planner: got "KCBTS"; unknown planner; allowed: …; did you mean "kcbts"?
planner: {kind: sbo, motions: {kind: spline}}
=> x.yaml: planner.motions: got "spline"; unknown motions; allowed: …; did you mean "splines"?
experiment: plan
=> x.yaml: experiment: got "plan"; unknown experiment; allowed: …; did you mean "planning"?
planner: [sbo]
=> x.yaml: planner: got ["sbo"]; unknown planner; allowed: sbo, …random…
planner: {kind: sbo, depth: "3"}
=> x.yaml: planner.depth: got "3"; allowed: an integer
planner: {kind: sbo, depth: 3.7}
=> x.yaml: planner.depth: got 3.7; allowed: an integer
problem: {half_width: true}
=> x.yaml: problem.half_width: got true; allowed: a number
problem: {exit_terminates: 1}
=> x.yaml: problem.exit_terminates: got 1; allowed: true or false
problem: {half_width: 0}
=> x.yaml: problem.half_width: got 0; allowed: > 0
planner: {kind: sbo, discount: 1.5}
=> x.yaml: planner.discount: got 1.5; allowed: <= 1
planner: {kernel: {lengthscale: 1.0e-40}}
=> x.yaml: planner.kernel.lengthscale: got 1e-40; allowed: a number from 1e-15 to 1e+15 or a list of them
{problem: {kind: monitoring, kernel: {variance: 1.0e+30}}, planner: sbo}
=> x.yaml: problem.kernel.variance: got 1e+30; allowed: <= 1e+15
{problem: {kind: diagonal, noise_variance: 0, relearn_every: 5}, planner: sbo}
=> x.yaml: problem: got {…; noise_variance: got 0; allowed: > 0 where relearn_every is: it is the median of a
   prior
problem: {half_width: .nan}
=> x.yaml: problem.half_width: got NaN; allowed: a finite number
dtype: float6
=> x.yaml: dtype: got "float6"; allowed: "float64" or "float32"; did you mean "float64"?
planner: {kind: sbo, motions: {actions: 7}}
=> x.yaml: planner.motions.actions: got 7; allowed: 5, 9 or 17
{experiment: learning, env: mountain-car, learner: {kind: emu-q, features: {num_features: 7}}}
=> x.yaml: learner.features.num_features: got 7; allowed: a multiple of 2
runs: 0
=> x.yaml: runs: got 0; allowed: >= 1
seed: 4294967296
=> x.yaml: seed: got 4294967296; allowed: <= 4294967295
engine: []
=> x.yaml: engine: got []; allowed: a mapping
{problem: {half_width: 0, max_steps: 0}, dtype: x}
=> x.yaml: dtype: got "x"; allowed: "float64" or "float32" (and 2 more errors)
base: parking
=> x.yaml: is a sweep, not an experiment; start it with: bojax sweep x.yaml
planner: {kind: sbo, motions: kernel}
=> x.yaml: planner.motions: got "kernel"; not allowed here; allowed: splines
{problem: {kind: space-modelling, start: [3, 1, 0]}, planner: sbo}
=> x.yaml: problem: got {"kind": "space-modelling", "start": [3, 1, 0]}; start: (3, 1) lies inside walls[0]
{problem: {kind: diagonal, start: [3, -1, 0]}, planner: sbo}
=> x.yaml: problem: got {…; start: (3, -1) lies outside the domain
{problem: {kind: monitoring, domain: [6, 0, 0, 6]}, planner: sbo}
=> x.yaml: problem.domain: got [6, 0, 0, 6]; allowed: [x_min, y_min, x_max, y_max] with x_min < x_max and
   y_min < y_max
{problem: {kind: monitoring, walls: [[1, 1, 2, 2], [1, 2, 2, 1]]}, planner: sbo}
=> x.yaml: problem.walls.1: got [1, 2, 2, 1]; allowed: [x_min, y_min, x_max, y_max] …
{problem: {kind: monitoring, walls: [[1, 1, 2]]}, planner: sbo}
=> x.yaml: problem.walls.0.3: missing; the list [1, 1, 2] is too short…
{problem: {kind: monitoring, walls: []}, planner: sbo}
=> x.yaml: problem.walls: got []; allowed: >= 1 entries
{problem: {kind: monitoring, field: {kind: bumps, heights: [1, 2]}}, planner: sbo}
=> x.yaml: problem.field: got {…; heights, centres, widths: got 2, 1 and 1 entries; allowed: the same number
   of each
{problem: diagonal, planner: {kind: sbo, objective: gradeint}}
=> x.yaml: planner.objective: got "gradeint"; unknown objective; allowed: entropy, gradient, information,
   uncertainty, value; did you mean "gradient"?
{problem: {kind: diagonal, objective: rbf}, planner: sbo}
=> x.yaml: problem.objective: got "rbf"; this name has the role kernel, not objective; allowed: entropy, …
{problem: {kind: diagonal, objective: null}, planner: sbo}
=> x.yaml: problem.objective: got null; unknown objective; allowed: entropy, gradient, information,
   uncertainty, value
{problem: parking, planner: bo-pomdp}
=> x.yaml: experiment: got {…; planner.objective: bo-pomdp maximises an objective on a field, and parking has
   no field: set planner.objective to null, or choose another planner
{problem: {kind: monitoring, domain: [0, 0, 500, 300]}, planner: sbo}
=> x.yaml: experiment: got {…; problem.field: got null; allowed: a true field, which a run samples, such as
   {kind: grid, file: depth.tif}; bojax survey and bojax.Mission plan without one
{problem: {kind: monitoring, field: null}, planner: sbo}
=> x.yaml: experiment: got {…; problem.field: got null; allowed: a true field, which a run samples, such as
   {kind: grid, file: depth.tif}; bojax survey and bojax.Mission plan without one
{problem: {kind: monitoring, field: {kind: grid, extent: [0, 0, 1, 1]}}, planner: sbo}
=> x.yaml: problem.field.file: missing; this setting has no default
{problem: {kind: monitoring, field: {kind: grid, file: good.csv, extent: [0, 1, 1, 0]}}, planner: sbo}
=> x.yaml: problem.field.extent: got [0, 1, 1, 0]; allowed: [x_min, y_min, x_max, y_max] with …
{problem: {kind: monitoring, field: {kind: grid, file: row.csv, extent: [0, 0, 1, 1]}}, planner: sbo}
=> x.yaml: problem.field: got {…; row.csv: got a grid of 1 x 3; allowed: at least 2 x 2
{problem: {kind: monitoring, field: {kind: scattered, file: good.csv, extent: [0, 0, 1, 1]}}, planner: sbo}
=> x.yaml: problem.field: got {…; good.csv: got 2 columns; allowed: 3, which are x, y and value
problem: 'mine.fields:'
=> x.yaml: problem: got "mine.fields:"; unknown problem; allowed: …parking…
"""


def test_experiment_files(write):
    write("good.csv", "1,2\n3,4\n5,6")
    write("row.csv", "1,2,3")
    assert_messages(lambda text: write("x.yaml", text) and load_config("x.yaml"), cases(EXPERIMENTS))


OVERRIDES = """\
planner.depht=3
=> command line: planner.depht: unknown key; allowed: …; did you mean "depth"?
planner.depth=deep
=> command line: planner.depth: got "deep"; allowed: an integer
engine.segment_seconds=0
=> command line: engine.segment_seconds: got 0; allowed: > 0
problem=park
=> command line: problem: got "park"; unknown problem; allowed: …; did you mean "parking"?
planner.depth
=> command line: planner.depth: is not an override; allowed: key=value, such as planner.iterations=100
planner..depth=3
=> command line: planner..depth=3: is not an override; allowed: key=value, such as planner.iterations=100
planner.depth=
=> command line: planner.depth: got null; allowed: an integer
planner={a
=> command line: planner: got {a; is not YAML: …; quote a value with braces or spaces: 'planner={a ...'
runs=1180591620717411303424
=> command line: runs: got 1180591620717411303424; allowed: an integer between -2^63 and 2^63 - 1
runs=1 runs=2
=> command line: runs: given twice
problem.half_width.x=1
=> command line: problem.half_width.x: half_width is 2, which has no settings
planner.depth.x=1
=> command line: planner.depth: got {"x": 1}; allowed: an integer
"""


def test_overrides(write):
    write("x.yaml", "{planner: sbo, problem: {half_width: 2}}")
    assert_messages(lambda words: load_config("x.yaml", words.split()), cases(OVERRIDES))


SWEEPS = """\
axes: {}
=> s.yaml: base: missing; allowed: a name in configs/, a YAML file or a mapping
planner: sbo
=> s.yaml: base: missing; allowed: a name in configs/, a YAML file or a mapping; start an experiment with:
   bojax run s.yaml
base: prking
=> s.yaml: base: prking: no such file, and no such name in configs/; allowed: …; did you mean "parking"?
base: 3
=> s.yaml: base: got 3; allowed: a name in configs/, a YAML file or a mapping
{base: {}, axis: {}}
=> s.yaml: axis: unknown key; allowed: …; did you mean "axes"?
base: {planner: {depth: 0}}
=> s.yaml: base.planner.depth: got 0; allowed: >= 1
base: broken.yaml
=> broken.yaml: dtype: got 3; allowed: "float64" or "float32"
{base: {runs: 3}, runs: 0}
=> s.yaml: runs: got 0; allowed: >= 1
{base: {}, axes: {planner.depht: [1, 2]}}
=> s.yaml: axes.planner.depht (point 0): unknown key; allowed: …; did you mean "depth"?
{base: {}, axes: {planner.depth: [1, 2, 0]}}
=> s.yaml: axes.planner.depth (point 2): got 0; allowed: >= 1
{base: {}, axes: {planner: {kcbts: {}, sbo-0: {kind: sbo, depth: 0}}}}
=> s.yaml: axes.planner.sbo-0.depth (point 1): got 0; allowed: >= 1
{base: {}, axes: {planner: {sbo: {}, x: {kind: sb0}}}}
=> s.yaml: axes.planner.x (point 1): got "sb0"; unknown planner; allowed: …; did you mean "sbo"?
base: {}
axes:
  planner:
    a: {}
    a: {}
=> s.yaml:5: duplicate key "a" (first on line 4)
{base: {}, axes: {planner.depth: [1, 1]}}
=> s.yaml: axes.planner.depth: got 1 and 1, which are equal; allowed: distinct values
{base: {}, combine: zip, axes: {planner.depth: [1, 1, 1], planner.iterations: [5, 6, 5]}}
=> s.yaml: axes: points 0 and 2 are equal; allowed in a zip: distinct points
{base: {}, axes: {planner.depth: []}}
=> s.yaml: axes.planner.depth: is empty; allowed: one value or more
{base: {}, axes: {planner.depth: 3}}
=> s.yaml: axes.planner.depth: got 3; allowed: a list of values, or named subtrees
{base: {}, axes: {planner: [{kind: sbo}]}}
=> s.yaml: axes.planner: got {"kind": "sbo"}; allowed: named subtrees, `planner: {NAME: {...}}`
{base: {}, axes: {planner: {a/b: {}}}}
=> s.yaml: axes.planner: got the name "a/b"; allowed: a nonempty name without /
{base: {}, combine: zip, axes: {planner.depth: [1, 2], planner.iterations: [1, 2, 3]}}
=> s.yaml: axes: got axes of different lengths (planner.depth has 2, planner.iterations has 3); allowed in a
   zip: equal lengths
{base: {}, combine: zipp}
=> s.yaml: combine: got "zipp"; allowed: "grid" or "zip"; did you mean "zip"?
{base: {}, axes: {seed: [1, 2]}}
=> s.yaml: axes.seed: seed cannot be swept; allowed: settings of the experiment
{base: {}, axes: {planner.depth: [1, 2], planner: {sbo: {}}}}
=> s.yaml: axes.planner: overwrites axes.planner.depth; allowed: axes.planner before axes.planner.depth
{base: {problem: {half_width: 2}}, axes: {problem.half_width.x: [1]}}
=> s.yaml: axes.problem.half_width.x: half_width is 2, which has no settings
{alias: parking, runs: 3}
=> s.yaml: alias: got "parking"; allowed: the name of another sweep, as the only key
alias: s.yaml
=> s.yaml: alias: got "s.yaml"; aliases must not form a cycle
alias: prking
=> s.yaml: alias: prking: no such file, and no such name in sweeps/; allowed: …; did you mean "parking"?
{base: {planner: sbo}, claims: [&c {id: a, source: s, claim: c, test: {kind: share, label: sbo, column:
  success, above: 0.5}}, *c]}
=> s.yaml: claims.1.id: got "a"; allowed: a unique id
{base: {planner: sbo}, claims: [{id: a, source: s, claim: c, test: {kind: share, label: sb0, column:
  success, above: 0.5}}]}
=> s.yaml: claims.0.test: got "sb0"; unknown label; allowed: sbo; did you mean "sbo"?
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: share, label: a, column: b}}]}
=> s.yaml: claims.0.test: got {"kind": "share", "label": "a", "column": "b"}; share: give either above or
   below
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: orders}}]}
=> s.yaml: claims.0.test: got "orders"; unknown test; allowed: …; did you mean "order"?
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: order, greater: [a, b]}}]}
=> s.yaml: claims.0.test.column: missing; this setting has no default
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: order, column: x}}]}
=> s.yaml: claims.0.test: got {"kind": "order", "column": "x"}; order: give either greater or less
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: order, column: x, less: [a, [b, a]]}}]}
=> s.yaml: claims.0.test: got {"kind": "order", "column": "x", "less": ["a", ["b", "a"]]}; less: duplicate
   name
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: order, column: x, less: [a, b], margin: 2,
  baseline: c}}]}
=> s.yaml: claims.0.test: got {"kind": "order", "column": "x", "less": ["a", "b"], "mar...; margin: with a
   baseline it is a share of a lead, below 1 and not 0
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: ratio, column: x, label: a, to: a, expected:
  1.2, tolerance: 0.1}}]}
=> s.yaml: claims.0.test: got {"kind": "ratio", "column": "x", "label": "a", "to": "a",...; to: duplicate
   name
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: order, column: x, greater: [a]}}]}
=> s.yaml: claims.0.test.greater: got ["a"]; allowed: >= 2 entries
{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: trend, label: a, column: b, from: 6, to: 3,
  direction: falls}}]}
=> s.yaml: claims.0.test: got {"kind": "trend", "label": "a", "column": "b", "from": 6,...; to must lie after
   from, which is 6
"""


def test_sweep_files(write):
    write("broken.yaml", "dtype: 3")
    assert_messages(lambda text: write("s.yaml", text) and load_sweep("s.yaml"), cases(SWEEPS))


SWEPT = """\
planner.depth=3
=> command line: planner.depth: got 3; a swept key cannot be overridden (axes.planner.two in s.yaml)
planner=sbo
=> command line: planner: got "sbo"; a swept key cannot be overridden …kcbts in s.yaml)
problem.half_width=3
=> command line: problem.half_width: got 3; a swept key cannot be overridden (axes.problem.half_width in
   s.yaml)
planner.depht=3
=> command line: planner.depht: unknown key; allowed: …; did you mean "depth"?
"""


def test_overrides_of_swept_keys(write):
    axes = "{planner: {kcbts: {}, two: {depth: 2}}, problem.half_width: [1, 2]}"
    write("s.yaml", f"{{base: {{}}, axes: {axes}}}")
    assert_messages(lambda override: load_sweep("s.yaml", [override]), cases(SWEPT))


MISSING = """\
prking
=> prking: no such file, and no such name in configs/; allowed: …; did you mean "parking"?
configs/min.yaml
=> configs/min.yaml: no such file, and no such name in configs/; allowed: …; did you mean "mine"?
configs
=> configs: is a folder; allowed: a YAML file, or a name in configs/
configs/notes.txt
=> configs/notes.txt: is not a YAML file; allowed: a file name that ends in .yaml or .yml
"""


def test_missing_files(write):
    write("configs/mine.yaml", "planner: sbo")
    write("configs/notes.txt", "planner: sbo")
    empty = "", "got an empty name; allowed: a YAML file, or a name in configs/"
    assert_messages(load_config, [empty, *cases(MISSING)])


def test_an_unreadable_file(write, monkeypatch):
    path = write("x.yaml", "planner: sbo")

    def refuse(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(path), "open", refuse)
    with pytest.raises(ConfigError) as raised:
        load_config("x.yaml")
    assert str(raised.value) == "x.yaml: cannot be read: Permission denied"


def test_a_long_value_is_cut_and_stays_on_one_line():
    assert shown("a\nb") == '"a\\nb"'
    assert len(shown(list(range(1000)))) == 60


def test_a_name_that_continues_the_given_one_comes_first():
    names = [f"fig-5.{number}" for number in range(10, 30)] + ["fig-5.3-taxi", "fig-5.3-cliff", "fig-5.7"]
    told = allowed_names("fig-5.3", names)
    assert told.startswith("; allowed: fig-5.3-cliff, fig-5.3-taxi, ")
    assert told.endswith('; did you mean "fig-5.3-cliff"?')
