"""A configuration error is one line: the place, the value, the values allowed, the nearest name."""

import re

import pytest

from bojax.config.errors import ConfigError, allowed_names, shown
from bojax.config.sweep import load_config, load_sweep


def check(error: ConfigError, expected: str) -> None:
    """The whole message is as expected; … matches any text."""
    pattern = ".*".join(re.escape(part) for part in expected.split("…"))
    assert re.fullmatch(pattern, str(error)), f"{error}\n{expected}"
    assert error.exit_code == 2


def grid(file: str, extent: str = "[0, 0, 1, 1]", kind: str = "grid") -> str:
    """An experiment on a field given by a file."""
    field = f"{{kind: {kind}, file: {file}, extent: {extent}}}"
    return f"{{problem: {{kind: monitoring, field: {field}}}, planner: sbo}}"


EXPERIMENTS = {
    "an unknown key": (
        "planner: {kind: sbo, iteratons: 3}",
        'x.yaml: planner.iteratons: unknown key; allowed: …; did you mean "iterations"?',
    ),
    "an unknown key at the top": (
        "plannr: sbo",
        'x.yaml: plannr: unknown key; allowed: …; did you mean "planner"?',
    ),
    "a setting of another kind": (
        "planner: {kind: random, depth: 3}",
        "x.yaml: planner.depth: unknown key (a setting of kind=…sbo…); allowed: …",
    ),
    "a setting of another experiment": (
        "{experiment: learning, planner: sbo}",
        "x.yaml: planner: unknown key (a setting of experiment=planning); allowed: …",
    ),
    "an unknown kind": (
        "planner: kcbt",
        'x.yaml: planner: got "kcbt"; unknown planner; allowed: …; did you mean "kcbts"?',
    ),
    "an unknown kind in a mapping": (
        "planner: {kind: sbo, motions: {kind: spline}}",
        'x.yaml: planner.motions: got "spline"; unknown motions; allowed: …; did you mean "splines"?',
    ),
    "an unknown experiment": (
        "experiment: plan",
        'x.yaml: experiment: got "plan"; unknown experiment; allowed: …; did you mean "planning"?',
    ),
    "a list in the place of a part": (
        "planner: [sbo]",
        'x.yaml: planner: got ["sbo"]; unknown planner; allowed: …random, sbo…',
    ),
    "text in the place of an integer": (
        'planner: {kind: sbo, depth: "3"}',
        'x.yaml: planner.depth: got "3"; allowed: an integer',
    ),
    "a fraction in the place of an integer": (
        "planner: {kind: sbo, depth: 3.7}",
        "x.yaml: planner.depth: got 3.7; allowed: an integer",
    ),
    "a truth value in the place of a number": (
        "problem: {half_width: true}",
        "x.yaml: problem.half_width: got true; allowed: a number",
    ),
    "a number in the place of a truth value": (
        "problem: {exit_terminates: 1}",
        "x.yaml: problem.exit_terminates: got 1; allowed: true or false",
    ),
    "out of range": ("problem: {half_width: 0}", "x.yaml: problem.half_width: got 0; allowed: > 0"),
    "out of range above": (
        "planner: {kind: sbo, discount: 1.5}",
        "x.yaml: planner.discount: got 1.5; allowed: <= 1",
    ),
    "a lengthscale that 32-bit numbers do not hold": (
        "planner: {kernel: {lengthscale: 1.0e-40}}",
        "x.yaml: planner.kernel.lengthscale: got 1e-40; allowed: a number from 1e-15 to 1e+15 or a list of "
        "them",
    ),
    "a prior variance out of range": (
        "{problem: {kind: monitoring, kernel: {variance: 1.0e+30}}, planner: sbo}",
        "x.yaml: problem.kernel.variance: got 1e+30; allowed: <= 1e+15",
    ),
    "relearning around no noise": (
        "{problem: {kind: diagonal, noise_variance: 0, relearn_every: 5}, planner: sbo}",
        "x.yaml: problem: got {…; noise_variance: got 0; allowed: > 0 where relearn_every is: it is the "
        "median of a prior",
    ),
    "NaN": ("problem: {half_width: .nan}", "x.yaml: problem.half_width: got NaN; allowed: a finite number"),
    "infinity": (
        "problem: {half_width: .inf}",
        "x.yaml: problem.half_width: got Infinity; allowed: a finite number",
    ),
    "none of the choices": (
        "dtype: float6",
        'x.yaml: dtype: got "float6"; allowed: "float64" or "float32"; did you mean "float64"?',
    ),
    "an impossible structural value": (
        "planner: {kind: sbo, motions: {actions: 7}}",
        "x.yaml: planner.motions.actions: got 7; allowed: 5, 9 or 17",
    ),
    "no runs": ("runs: 0", "x.yaml: runs: got 0; allowed: >= 1"),
    "a negative seed": ("seed: -1", "x.yaml: seed: got -1; allowed: >= 0"),
    "a seed that no key takes": ("seed: 4294967296", "x.yaml: seed: got 4294967296; allowed: <= 4294967295"),
    "a list in the place of settings": ("engine: []", "x.yaml: engine: got []; allowed: a mapping"),
    "an unknown device": (
        "engine: {device: gpus}",
        'x.yaml: engine.device: got "gpus"; allowed: "auto", "cpu" or "gpu"; did you mean "gpu"?',
    ),
    "several mistakes": (
        "{problem: {half_width: 0, max_steps: 0}, dtype: x}",
        'x.yaml: dtype: got "x"; allowed: "float64" or "float32" (and 2 more)',
    ),
    "a key twice": ("runs: 1\nruns: 2", 'x.yaml:2: duplicate key "runs" (first on line 1)'),
    "a sweep": (
        "base: parking",
        "x.yaml: is a sweep, not an experiment; start it with: bojax sweep x.yaml",
    ),
    "motions that a planner cannot use": (
        "planner: {kind: sbo, motions: kernel}",
        'x.yaml: planner.motions: got "kernel"; not allowed here; allowed: splines',
    ),
    "a start inside a wall": (
        "{problem: {kind: space-modelling, start: [3, 1, 0]}, planner: sbo}",
        'x.yaml: problem: got {"kind": "space-modelling", "start": [3, 1, 0]}; '
        "start: (3, 1) lies inside walls[0]",
    ),
    "a start outside the domain": (
        "{problem: {kind: diagonal, start: [3, -1, 0]}, planner: sbo}",
        "x.yaml: problem: got {…; start: (3, -1) lies outside the domain",
    ),
    "a box the wrong way round": (
        "{problem: {kind: monitoring, domain: [6, 0, 0, 6]}, planner: sbo}",
        "x.yaml: problem.domain: got [6, 0, 0, 6]; allowed: [x_min, y_min, x_max, y_max] with x_min < x_max "
        "and y_min < y_max",
    ),
    "a wall the wrong way round": (
        "{problem: {kind: monitoring, walls: [[1, 1, 2, 2], [1, 2, 2, 1]]}, planner: sbo}",
        "x.yaml: problem.walls: got [[1, 1, 2, 2], [1, 2, 2, 1]]; allowed: [x_min, y_min, x_max, y_max] …",
    ),
    "a wall of three numbers": (
        "{problem: {kind: monitoring, walls: [[1, 1, 2]]}, planner: sbo}",
        "x.yaml: problem.walls.0.3: missing; the list [1, 1, 2] is too short…",
    ),
    "no walls in a list": (
        "{problem: {kind: monitoring, walls: []}, planner: sbo}",
        "x.yaml: problem.walls: got []; allowed: >= 1 entries",
    ),
    "a pit without a width": (
        "{problem: {kind: monitoring, field: {kind: bumps, heights: [1, 2]}}, planner: sbo}",
        "x.yaml: problem.field: got {…; heights, centres, widths: got 2, 1 and 1 entries; allowed: "
        "the same number of each",
    ),
    "an unknown objective": (
        "{problem: diagonal, planner: {kind: sbo, objective: gradeint}}",
        'x.yaml: planner.objective: got "gradeint"; unknown objective; allowed: gradient, uncertainty, '
        'value; did you mean "gradient"?',
    ),
    "an objective that is another part": (
        "{problem: {kind: diagonal, objective: rbf}, planner: sbo}",
        'x.yaml: problem.objective: got "rbf"; this name has the role kernel, not objective; '
        "allowed: gradient, …",
    ),
    "a problem without a task": (
        "{problem: {kind: diagonal, objective: null}, planner: sbo}",
        "x.yaml: problem.objective: got null; unknown objective; allowed: gradient, uncertainty, value",
    ),
    "an objective where there is no field": (
        "{problem: parking, planner: bo-pomdp}",
        "x.yaml: experiment: got {…; planner.objective: bo-pomdp maximises an objective on a field, and "
        "parking has no field: set planner.objective to null, or choose another planner",
    ),
    "a field without a file": (
        "{problem: {kind: monitoring, field: {kind: grid, extent: [0, 0, 1, 1]}}, planner: sbo}",
        "x.yaml: problem.field.file: missing; this setting has no default",
    ),
    "a file that is not there": (
        grid("no.npy"),
        "x.yaml: problem.field: got {…; no.npy: No such file or directory",
    ),
    "a file of another format": (
        grid("x.yaml"),
        "x.yaml: problem.field: got {…; x.yaml: the name has to end in .npy or .csv",
    ),
    "an extent the wrong way round": (
        grid("good.csv", extent="[0, 1, 1, 0]"),
        "x.yaml: problem.field.extent: got [0, 1, 1, 0]; allowed: [x_min, y_min, x_max, y_max] with …",
    ),
    "a grid with NaN": (
        grid("nan.csv"),
        "x.yaml: problem.field: got {…; nan.csv: 1 of 4 numbers are not finite",
    ),
    "a grid of one row": (
        grid("row.csv"),
        "x.yaml: problem.field: got {…; row.csv: got a grid of 1 x 3; allowed: at least 2 x 2",
    ),
    "a grid of words": (
        grid("words.csv"),
        "x.yaml: problem.field: got {…; words.csv: could not convert string …",
    ),
    "an empty file": (
        grid("empty.csv"),
        "x.yaml: problem.field: got {…; empty.csv: …",
    ),
    "measurements without a value": (
        grid("good.csv", kind="scattered"),
        "x.yaml: problem.field: got {…; good.csv: got 2 columns; allowed: 3, which are x, y and value",
    ),
    "data that are not those of the results": (
        grid("good.csv, sha256: abc"),
        "x.yaml: problem.field: got {…; good.csv: the file has changed: its SHA-256 differs",
    ),
    "a malformed import path": (
        "problem: 'mine.fields:'",
        'x.yaml: problem: got "mine.fields:"; unknown problem; allowed: …parking…',
    ),
}


TABLES = {
    "good.csv": "1,2\n3,4\n5,6",
    "nan.csv": "1,2\nnan,4",
    "row.csv": "1,2,3",
    "words.csv": "a,b\nhigh,low",
    "empty.csv": "",
}
"""Files in the folder of the experiment."""


@pytest.mark.parametrize("case", EXPERIMENTS)
def test_experiment_files(write, case):
    text, message = EXPERIMENTS[case]
    for name, table in TABLES.items():
        write(name, table)
    write("x.yaml", text)
    with pytest.raises(ConfigError) as raised:
        load_config("x.yaml")
    check(raised.value, message)


OVERRIDES = {
    "an unknown key": (
        ["planner.depht=3"],
        'command line: planner.depht: unknown key; allowed: …; did you mean "depth"?',
    ),
    "an unknown key at the top": (
        ["runz=3"],
        'command line: runz: unknown key; allowed: …; did you mean "runs"?',
    ),
    "a wrong type": (["planner.depth=deep"], 'command line: planner.depth: got "deep"; allowed: an integer'),
    "out of range": (
        ["engine.segment_seconds=0"],
        "command line: engine.segment_seconds: got 0; allowed: > 0",
    ),
    "an unknown kind": (
        ["problem=park"],
        'command line: problem: got "park"; unknown problem; allowed: …; did you mean "parking"?',
    ),
    "no value": (
        ["planner.depth"],
        "command line: planner.depth: is not an override; allowed: key=value, such as planner.iterations=100",
    ),
    "no key": (
        ["=3"],
        "command line: =3: is not an override; allowed: key=value, such as planner.iterations=100",
    ),
    "an empty part of a path": (
        ["planner..depth=3"],
        "command line: planner..depth=3: is not an override; allowed: key=value, such as "
        "planner.iterations=100",
    ),
    "an empty value": (["planner.depth="], "command line: planner.depth: got null; allowed: an integer"),
    "no YAML": (
        ["planner={a"],
        "command line: planner: got {a; is not YAML: …; quote a value with braces or spaces: "
        "'planner={a ...'",
    ),
    "too large": (
        [f"runs={2**70}"],
        f"command line: runs: got {2**70}; allowed: an integer between -2^63 and 2^63 - 1",
    ),
    "twice": (["runs=1", "runs=2"], "command line: runs: given twice"),
    "below a number": (
        ["problem.half_width.x=1"],
        "command line: problem.half_width.x: half_width is 2, which has no settings",
    ),
    "below a default number": (
        ["planner.depth.x=1"],
        'command line: planner.depth: got {"x": 1}; allowed: an integer',
    ),
}


@pytest.mark.parametrize("case", OVERRIDES)
def test_overrides(write, case):
    texts, message = OVERRIDES[case]
    write("x.yaml", "{planner: sbo, problem: {half_width: 2}}")
    with pytest.raises(ConfigError) as raised:
        load_config("x.yaml", texts)
    check(raised.value, message)


SWEEPS = {
    "no base": ("axes: {}", "s.yaml: base: missing; allowed: a name in configs/, a YAML file or a mapping"),
    "an experiment": (
        "planner: sbo",
        "s.yaml: base: missing; allowed: a name in configs/, a YAML file or a mapping; "
        "start an experiment with: bojax run s.yaml",
    ),
    "an unknown base": (
        "base: prking",
        "s.yaml: base: prking: no such file, and no such name in configs/; allowed: …; "
        'did you mean "parking"?',
    ),
    "a base of the wrong type": (
        "base: 3",
        "s.yaml: base: got 3; allowed: a name in configs/, a YAML file or a mapping",
    ),
    "an unknown key": (
        "{base: {}, axis: {}}",
        's.yaml: axis: unknown key; allowed: …; did you mean "axes"?',
    ),
    "a mistake in an inline base": (
        "base: {planner: {depth: 0}}",
        "s.yaml: base.planner.depth: got 0; allowed: >= 1",
    ),
    "a mistake in the base's file": (
        "base: broken.yaml",
        'broken.yaml: dtype: got 3; allowed: "float64" or "float32"',
    ),
    "an own setting": ("{base: {runs: 3}, runs: 0}", "s.yaml: runs: got 0; allowed: >= 1"),
    "an unknown path": (
        "{base: {}, axes: {planner.depht: [1, 2]}}",
        's.yaml: axes.planner.depht (point 0): unknown key; allowed: …; did you mean "depth"?',
    ),
    "a swept value out of range": (
        "{base: {}, axes: {planner.depth: [1, 2, 0]}}",
        "s.yaml: axes.planner.depth (point 2): got 0; allowed: >= 1",
    ),
    "an impossible structural value": (
        "{base: {planner: sbo}, axes: {planner.motions.actions: [5, 7]}}",
        "s.yaml: axes.planner.motions.actions (point 1): got 7; allowed: 5, 9 or 17",
    ),
    "a mistake in a named subtree": (
        "{base: {}, axes: {planner: {kcbts: {}, sbo-0: {kind: sbo, depth: 0}}}}",
        "s.yaml: axes.planner.sbo-0.depth (point 1): got 0; allowed: >= 1",
    ),
    "an unknown kind in a named subtree": (
        "{base: {}, axes: {planner: {sbo: {}, x: {kind: sb0}}}}",
        's.yaml: axes.planner.x (point 1): got "sb0"; unknown planner; allowed: …; did you mean "sbo"?',
    ),
    "a name twice": (
        "base: {}\naxes:\n  planner:\n    a: {}\n    a: {}",
        's.yaml:5: duplicate key "a" (first on line 4)',
    ),
    "a value twice": (
        "{base: {}, axes: {planner.depth: [1, 1]}}",
        "s.yaml: axes.planner.depth: got 1 and 1, which are equal; allowed: distinct values",
    ),
    "a point twice in a zip": (
        "{base: {}, combine: zip, axes: {planner.depth: [1, 1, 1], planner.iterations: [5, 6, 5]}}",
        "s.yaml: axes: points 0 and 2 are equal; allowed in a zip: distinct points",
    ),
    "an empty list": (
        "{base: {}, axes: {planner.depth: []}}",
        "s.yaml: axes.planner.depth: is empty; allowed: one value or more",
    ),
    "no subtrees": (
        "{base: {}, axes: {planner: {}}}",
        "s.yaml: axes.planner: is empty; allowed: one value or more",
    ),
    "a single value": (
        "{base: {}, axes: {planner.depth: 3}}",
        "s.yaml: axes.planner.depth: got 3; allowed: a list of values, or named subtrees",
    ),
    "a subtree without a name": (
        "{base: {}, axes: {planner: [{kind: sbo}]}}",
        's.yaml: axes.planner: got {"kind": "sbo"}; allowed: named subtrees, `planner: {NAME: {...}}`',
    ),
    "a name with a slash": (
        "{base: {}, axes: {planner: {a/b: {}}}}",
        's.yaml: axes.planner: got the name "a/b"; allowed: a nonempty name without /',
    ),
    "a zip of unequal lengths": (
        "{base: {}, combine: zip, axes: {planner.depth: [1, 2], planner.iterations: [1, 2, 3]}}",
        "s.yaml: axes: got axes of different lengths (planner.depth has 2, planner.iterations has 3); "
        "allowed in a zip: equal lengths",
    ),
    "an unknown combination": (
        "{base: {}, combine: zipp}",
        's.yaml: combine: got "zipp"; allowed: "grid" or "zip"; did you mean "zip"?',
    ),
    "a reserved key": (
        "{base: {}, axes: {seed: [1, 2]}}",
        "s.yaml: axes.seed: seed cannot be swept; allowed: settings of the experiment",
    ),
    "an axis that overwrites another": (
        "{base: {}, axes: {planner.depth: [1, 2], planner: {sbo: {}}}}",
        "s.yaml: axes.planner: overwrites axes.planner.depth; "
        "allowed: axes.planner before axes.planner.depth",
    ),
    "an axis below a number": (
        "{base: {problem: {half_width: 2}}, axes: {problem.half_width.x: [1]}}",
        "s.yaml: axes.problem.half_width.x: half_width is 2, which has no settings",
    ),
    "an alias beside other keys": (
        "{alias: parking, runs: 3}",
        's.yaml: alias: got "parking"; allowed: the name of another sweep, as the only key',
    ),
    "an alias of itself": ("alias: s.yaml", 's.yaml: alias: got "s.yaml"; aliases must not form a cycle'),
    "an alias of an unknown sweep": (
        "alias: prking",
        "s.yaml: alias: prking: no such file, and no such name in sweeps/; allowed: …; "
        'did you mean "parking"?',
    ),
    "two claims of one id": (
        "{base: {planner: sbo}, claims: [&c {id: a, source: s, claim: c, test: "
        "{kind: share, label: sbo, column: success, above: 0.5}}, *c]}",
        's.yaml: claims.1.id: got "a"; allowed: a unique id',
    ),
    "a claim about an unknown label": (
        "{base: {planner: sbo}, claims: [{id: a, source: s, claim: c, test: "
        "{kind: share, label: sb0, column: success, above: 0.5}}]}",
        's.yaml: claims.0.test: got "sb0"; unknown label; allowed: sbo; did you mean "sbo"?',
    ),
    "a claim without a threshold": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: share, label: a, column: b}}]}",
        's.yaml: claims.0.test: got {"kind": "share", "label": "a", "column": "b"}; '
        "share: give either above or below",
    ),
    "an unknown test": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: orders}}]}",
        's.yaml: claims.0.test: got "orders"; unknown test; allowed: …; did you mean "order"?',
    ),
    "a test without its settings": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: order, greater: [a, b]}}]}",
        "s.yaml: claims.0.test.column: missing; this setting has no default",
    ),
    "an order without a direction": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: order, column: x}}]}",
        's.yaml: claims.0.test: got {"kind": "order", "column": "x"}; order: give either greater or less',
    ),
    "an order with a name twice": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: "
        "{kind: order, column: x, less: [a, [b, a]]}}]}",
        's.yaml: claims.0.test: got {"kind": "order", "column": "x", "less": ["a", ["b", "a"]]}; '
        "less: duplicate name",
    ),
    "an order with a margin that is no share": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: "
        "{kind: order, column: x, less: [a, b], margin: 2, baseline: c}}]}",
        's.yaml: claims.0.test: got {"kind": "order", "column": "x", "less": ["a", "b"], "mar...; '
        "margin: with a baseline it is a share of a lead, below 1 and not 0",
    ),
    "a ratio to oneself": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: "
        "{kind: ratio, column: x, label: a, to: a, expected: 1.2, tolerance: 0.1}}]}",
        's.yaml: claims.0.test: got {"kind": "ratio", "column": "x", "label": "a", "to": "a",...; '
        "to: duplicate name",
    ),
    "an order of one": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: {kind: order, column: x, greater: [a]}}]}",
        's.yaml: claims.0.test.greater: got ["a"]; allowed: >= 2 entries',
    ),
    "a trend backwards": (
        "{base: {}, claims: [{id: a, source: s, claim: c, test: "
        "{kind: trend, label: a, column: b, from: 6, to: 3, direction: falls}}]}",
        's.yaml: claims.0.test: got {"kind": "trend", "label": "a", "column": "b", "from": 6,...; '
        "to must lie after from, which is 6",
    ),
}


@pytest.mark.parametrize("case", SWEEPS)
def test_sweep_files(write, case):
    text, message = SWEEPS[case]
    write("broken.yaml", "dtype: 3")
    write("s.yaml", text)
    with pytest.raises(ConfigError) as raised:
        load_sweep("s.yaml")
    check(raised.value, message)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "planner.depth=3",
            "command line: planner.depth: got 3; a swept key cannot be overridden "
            "(axes.planner.two in s.yaml)",
        ),
        (
            "planner=sbo",
            'command line: planner: got "sbo"; a swept key cannot be overridden …kcbts in s.yaml)',
        ),
        (
            "problem.half_width=3",
            "command line: problem.half_width: got 3; a swept key cannot be overridden "
            "(axes.problem.half_width in s.yaml)",
        ),
        (
            "planner.depht=3",
            'command line: planner.depht: unknown key; allowed: …; did you mean "depth"?',
        ),
    ],
)
def test_overrides_of_swept_keys(write, override, message):
    write(
        "s.yaml",
        "{base: {}, axes: {planner: {kcbts: {}, two: {depth: 2}}, problem.half_width: [1, 2]}}",
    )
    with pytest.raises(ConfigError) as raised:
        load_sweep("s.yaml", [override])
    check(raised.value, message)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("", "got an empty name; allowed: a YAML file, or a name in configs/"),
        (
            "prking",
            'prking: no such file, and no such name in configs/; allowed: …; did you mean "parking"?',
        ),
        (
            "configs/min.yaml",
            'configs/min.yaml: no such file, and no such name in configs/; allowed: …; did you mean "mine"?',
        ),
        ("configs", "configs: is a folder; allowed: a YAML file, or a name in configs/"),
        (
            "configs/notes.txt",
            "configs/notes.txt: is not a YAML file; allowed: a file name that ends in .yaml or .yml",
        ),
    ],
)
def test_missing_files(write, source, message):
    write("configs/mine.yaml", "planner: sbo")
    write("configs/notes.txt", "planner: sbo")
    with pytest.raises(ConfigError) as raised:
        load_config(source)
    check(raised.value, message)


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
