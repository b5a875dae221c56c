"""Bad configs and command lines: refused in one line with exit code 2, and nothing is run or written."""

import copy
import functools
import io
import os
import pickle
import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import ChildResult, cli, run, scratch
from benchmarks.campaign.snippets import listed, odd, shown
from benchmarks.campaign.spoil import BYTES, NO_FILES
from benchmarks.campaign.trees import assign, at, paths
from benchmarks.campaign.workloads import ROOT

MAX_SECONDS = 10.0
"""Most processor time until an error."""

_MAX_WALL = 60.0
"""Most time until an error, on a machine that does something else as well."""

MAX_MEGABYTES = 1024

_HERE = "@here@"
"""Stands for an odd value until YAML has been written."""


@dataclass(frozen=True)
class CommandLine:
    """A command line, with its files written."""

    tried: str  # what is odd about it
    words: tuple[str, ...]  # the arguments of `bojax`
    is_bad: bool = False  # whether it has to be refused; otherwise it may be valid
    stops: bool = True  # whether a valid one stops short of running
    traces: bool = False  # whether a valid one is traced: parts that do not fit may only fail there


def check(seed: int) -> Outcome:
    """Start `bojax` on an input that follows from the seed."""
    draw = random.Random(f"configs {seed}")
    family = draw.choices(list(FAMILIES), weights=list(FAMILIES.values()))[0]
    with scratch() as place:
        given = family(draw, place)
        before = _listing(place)
        ended = run(lambda: _command(given), place, seconds=_MAX_WALL)
        return Outcome(given.tried, _fault(given, ended) or _written(given, ended, before, _listing(place)))


def _fault(given: CommandLine, ended: ChildResult) -> str:
    if ended.cpu > MAX_SECONDS:
        return f"{ended.cpu:.0f} s of processor time; {ended.err[-200:]}"
    if ended.megabytes > MAX_MEGABYTES:
        return f"{ended.megabytes:.0f} MB of memory; {ended.err[-200:]}"
    codes = (2,) if given.is_bad else (0, 2) if given.stops else (0, 1, 2)
    return fault_of(ended, codes, alone=given.stops)


def _written(given: CommandLine, ended: ChildResult, before: set[str], after: set[str]) -> str:
    if not given.stops and ended.code == 0:
        return ""
    left = sorted(after ^ before)
    return f"written or gone: {', '.join(left[:3])}" if left else ""


def _listing(place: Path) -> set[str]:
    return {f"{path.relative_to(place)}" for path in place.rglob("*")}


def _command(given: CommandLine) -> int:
    """`bojax` with these words; unless the case says otherwise it stops where the engine would start."""
    if given.stops:
        import bojax.engine.run
        import bojax.report.build

        run_sweeps = bojax.engine.run.run_sweeps

        def stop_before_they_run(requests: Any, *options: Any, **named: Any) -> int:
            code = run_sweeps(requests, *options, **named)
            return _trace(requests[0].sweep) if given.traces and code == 0 else code

        bojax.engine.run.run_sweeps = stop_before_they_run
        plan_unfinished = bojax.engine.run.plan_unfinished
        bojax.engine.run.plan_unfinished = lambda *given: plan_unfinished(*given)[:0]
        bojax.report.build.build_report = lambda folder, *_: folder
    return cli(*given.words)


def _trace(sweep: Any) -> int:
    """Trace a run of the first point; what goes wrong there is found after the folder was made."""
    import jax

    from bojax.engine.build import build

    config = sweep.points[0].config
    experiment: Any = build(config, getattr(config, "dtype", "float64"))
    if not experiment.is_hosted:
        jax.eval_shape(experiment.advance, jax.eval_shape(experiment.init, jax.random.key(0)))
    return 0


def _setting(draw: random.Random, place: Path) -> CommandLine:
    """One setting of a shipped config, any that its schema has, with an odd value in the file."""
    name, tree = _experiment(draw)
    path = draw.choice(paths(tree))
    snippet, is_bad = odd(draw)
    assign(tree, path, _HERE)
    _write(place, _dump(tree).replace(_HERE, snippet))
    dotted = ".".join(map(str, path))
    return CommandLine(f"{name} with {dotted}: {shown(snippet)}", ("run", "case.yaml"), is_bad)


def _override(draw: random.Random, place: Path) -> CommandLine:
    """The same on the command line, and with a key that may be misspelt."""
    name, tree = _experiment(draw)
    path = draw.choice([path for path in paths(tree) if all(isinstance(part, str) for part in path)])
    snippet, is_bad = odd(draw)
    snippet = snippet.replace("\0", "")
    key = ".".join(path)
    if draw.random() < 0.3:
        key, is_bad = _misspelt(draw, key), False
    return CommandLine(f"{name} {key}={shown(snippet)}", ("run", name, f"{key}={snippet}"), is_bad)


def _parts(draw: random.Random, place: Path) -> CommandLine:
    """A part in place of another one, which may not fit the others."""
    from bojax.config.component import registry

    name = draw.choice(_names("configs"))
    role = draw.choice([role for role in registry if role not in ("experiment", "test")])
    kind = draw.choice(sorted(registry[role]))
    slots = [role.replace("-", "_"), f"planner.{role}", f"problem.{role}", f"learner.{role}", "kernel"]
    slots += ["learner.features.state", "problem.kernel", "problem.objective", "env", "problem"]
    words = [f"{draw.choice(slots)}={kind}"]
    if draw.random() < 0.5:
        other = draw.choice(("env", "planner", "learner", "problem"))
        words.append(f"{other}={draw.choice(sorted(registry[other]))}")
    return CommandLine(f"{name} {' '.join(words)}", ("run", name, *words), traces=True)


def _fitting(draw: random.Random, place: Path) -> CommandLine:
    """A planner and a problem, or a learner and an environment, that may not fit."""
    from bojax.config.component import registry

    pairs, base = draw.choice([(("problem", "planner"), "two-pits"), (("env", "learner"), "chain")])
    words = [f"{role}={draw.choice(sorted(registry[role]))}" for role in pairs]
    extra = draw.choice(_EXTRAS)
    words += [extra] if extra else []
    return CommandLine(f"{base} {' '.join(words)}", ("run", base, *words), traces=True)


_EXTRAS = (
    "",
    *listed("""
    learner.features.state_lengthscale=[1,2,3,4,5,6,7]  learner.features.action_lengthscale=[1,2,3,4,5,6,7]
    planner.motions=kernel  planner.motions=splines  planner.motions=cubic  planner.acquisition=pi
    planner.objective=uncertainty  problem.vehicle=quadrotor  problem.sensor=range
    problem.walls=[[0,0,1,1]]  schedule=decay  dtype=float32  learner.features=indicators
    problem.kernel={kind: rbf, lengthscale: [1,2,3]}  problem.domain=[0,0,1e-3,1e-3]
    """),
)
"""Settings that fit some planners and learners."""


def _structure(draw: random.Random, place: Path) -> CommandLine:
    """Keys that are unknown, misspelt, missing, twice there, or no names."""
    name, tree = _experiment(draw)
    path = draw.choice([path for path in paths(tree) if isinstance(path[-1], str)])
    parent, key, count = at(tree, path[:-1]), path[-1], draw.choice([300, 10_000, 100_000])
    changes: dict[str, Callable[[], object]] = {
        "unknown": lambda: parent.update(surprise=1),
        "misspelt": lambda: parent.update({_misspelt(draw, key): parent.pop(key)}),
        "missing": lambda: parent.pop(key),
        "moved": lambda: tree.update({key: parent.pop(key)}),
        "many": lambda: parent.update({f"key{index}": index for index in range(count)}),
        "long": lambda: parent.update({"k" * count: 1}),
    }
    texts: dict[str, Callable[[str], str]] = {
        "twice": lambda text: text + text.splitlines()[0] + "\n",
        "odd": lambda text: text + "".join(draw.sample(_ODD_KEYS, draw.randint(1, 2))),
        "list": lambda text: re.sub("^(?! )", "- ", re.sub("^ ", "   ", text, flags=re.M), flags=re.M),
    }
    change = draw.choice([*changes, *texts])
    changes.get(change, lambda: None)()
    _write(place, texts.get(change, str)(_dump(tree)))
    is_bad = change in ("unknown", "many", *texts)
    return CommandLine(f"{name}: key {change} at {'.'.join(map(str, path))}", ("run", "case.yaml"), is_bad)


_ODD_KEYS = (
    *("1: 2\n", "? [a, b]\n: 1\n", "? {a: 1}\n: 2\n", "null: 1\n", "true: 1\n", "'': 1\n"),
    *('"\\x1b[31m": 1\n', '"\\ud800": 1\n', "a b: 1\n", "2024-01-01: 1\n"),
)
"""Lines with a key that is no name of a setting."""


def _sweep(draw: random.Random, place: Path) -> CommandLine:
    """A shipped sweep with an odd value in its axes, claims, report or base."""
    name = draw.choice(_names("sweeps"))
    tree = copy.deepcopy(_tree(name))
    if "base" not in tree:
        tree = copy.deepcopy(_tree("fig-4.6"))
    snippet, is_bad = odd(draw)
    counts = draw.choice([[10**6], [10**4, 10**4], [1000] * 4, [10] * 12, [300]])
    axes = {
        "axis": {draw.choice(_AXES): draw.choice([_HERE, [_HERE], [1, _HERE], {"a": {"b": _HERE}}])},
        "axes": _HERE,
        "large": {axis: list(range(1, count + 1)) for axis, count in zip(_LARGE_AXES, counts, strict=False)},
        "variants": {"planner": {draw.choice(_VARIANTS): {}, "b": {}}},
    }
    change = draw.choice(["setting", "setting", "setting", "combine", *axes])
    tried = f"{change} of {counts} values" if change == "large" else f"{change}: {shown(snippet)}"
    if change == "setting":
        path = draw.choice(paths(tree))
        assign(tree, path, _HERE)
        tried += f" at {'.'.join(map(str, path))}"
        if draw.random() < 0.2:
            tree["base"] = draw.choice(["no-such", "case.yaml", "", 3, [], {"kind": 1}, None])
            tried += f", base: {tree['base']}"
    elif change == "combine":
        tree["combine"] = _HERE
    else:
        tree = {"base": "parking"} if change == "large" else tree
        tree["axes"] = axes[change]
        tried += "" if change == "large" else f" in {shown(str(axes[change]))}"
    _write(place, _dump(tree).replace(_HERE, snippet))
    # Titles, notes and numbers of the thesis are free.
    return CommandLine(f"sweep {name}: {tried}", ("sweep", "case.yaml"), is_bad and change == "combine")


_AXES = ("planner.iterations", "problem", "runs", "", "a..b", "planner", "seed", "env.x")
_LARGE_AXES = (
    *("planner.iterations", "planner.depth", "planner.exploration", "planner.discount"),
    *("planner.motions.actions", "planner.motions.length", *(f"planner.x{index}" for index in range(6))),
)
_VARIANTS = ("a/b", "", " ", "\x1b[31m", "n" * 300, "é", "..", "$\\unknowncmd$", "a\nb", 1, None, True)


def _alias(draw: random.Random, place: Path) -> CommandLine:
    """A sweep that stands for another one, or for nothing."""
    value = draw.choice(["case", "case.yaml", "no-such", "3", "[a]", "{a: 1}", "''", "..", "/", "parking"])
    more = draw.choice(["", "runs: 3\n"])
    _write(place, f"alias: {value}\n{more}")
    words = draw.choice(["sweep", "run"]), "case.yaml"
    return CommandLine(f"alias: {value} {more.strip()}", words, value != "parking")


def _bytes(draw: random.Random, place: Path) -> CommandLine:
    """The text of a shipped file, damaged."""
    folder = draw.choice(["configs", "sweeps"])
    name = draw.choice(_names(folder))
    changes = BYTES | _TEXTS
    change = draw.choice([*changes, *_INSERTED])
    if change in changes:
        content = changes[change](draw, _path(folder, name).read_bytes())
    else:
        content = _path(folder, name).read_bytes()
        middle = draw.randrange(len(content))
        content = content[:middle] + draw.choice(_INSERTED[change]) + content[middle:]
    (place / "case.yaml").write_bytes(content)
    is_bad = change in ("utf-16", "utf-16 bare", "latin-1", "twice", "documents", "emptied", "blank")
    is_bad = is_bad or change.endswith("noise")
    return CommandLine(f"{name}: {change}", ("run" if folder == "configs" else "sweep", "case.yaml"), is_bad)


def _indented(draw: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    index = draw.randrange(len(lines))
    lines[index] = b" " * draw.randint(1, 5) + lines[index]
    return b"\n".join(lines)


_TEXTS: dict[str, Callable[[random.Random, bytes], bytes]] = {
    "utf-16": lambda draw, content: content.decode().encode("utf-16"),
    "utf-16 bare": lambda draw, content: content.decode().encode("utf-16-le"),
    "tabs": lambda draw, content: content.replace(b"  ", b"\t"),
    "crlf": lambda draw, content: content.replace(b"\n", b"\r\n"),
    "twice": lambda draw, content: content + content,
    "documents": lambda draw, content: content + b"\n---\n" + content,
    "blank": lambda draw, content: draw.choice([b"  \n \n", b"# nothing\n"]),
    "long noise": lambda draw, content: draw.randbytes(100_000),
    "huge": lambda draw, content: content + b"# " + b"x" * 10_000_000,
    "shortened": lambda draw, content: content.replace(draw.choice(content.split()), b"", 1),
    "indented": _indented,
}
_INSERTED = {
    "latin-1": (b"\xe9\xff",),
    "bom": (b"\xef\xbb\xbf",),
    "null": (b"\0",),
    "control": (b"\x1b[31m", b"\x07", b"\x7f", b"\x85", b"\xe2\x80\xa8"),
    "syntax": (b"'", b'"', b"{", b"[", b"&a ", b"*a ", b"!!int ", b"<<: ", b"%"),
}


def _bomb(draw: random.Random, place: Path) -> CommandLine:
    """A short text that stands for a large value."""
    levels, width = draw.choice([(3, 9), (6, 9), (9, 9), (10, 10), (30, 2), (100, 2)])
    style = draw.choice([*_BOMBS, "deep", "deep mappings", "keys"])
    if style == "deep":
        lines = ["title: " + "[" * 10 ** draw.randint(2, 5)]
    elif style == "deep mappings":
        lines = [f"{' ' * level}a:" for level in range(10 ** draw.randint(2, 4))]
    elif style == "keys":
        lines = ["k0: &k0 1", *(f"k{index}: &k{index} [*k{index - 1}, 1]" for index in range(1, 2000))]
    else:
        first, entry, form = _BOMBS[style]
        lines = [f"k0: &a0 {first}"]
        for level in range(1, levels):
            below = ", ".join(entry.format(f"*a{level - 1}", index) for index in range(width))
            lines.append(f"k{level}: &a{level} " + form.format(below))
        if style == "merged lists":
            lines.append(f"z: {{<<: *a{levels - 1}}}")
    _write(place, "\n".join(lines) + "\n")
    return CommandLine(
        f"{style}, {levels} levels of {width}", (draw.choice(["run", "sweep"]), "case.yaml"), True
    )


_BOMBS = {
    "aliases": ("[1]", "{0}", "[{}]"),
    "merges": ("{c: 1}", "{0}", "{{<<: [{}], c: 1}}"),
    "merged lists": ("[{c: 1}]", "{0}", "[{}]"),
    "mappings": ("{b: 1}", "b{1}: {0}", "{{{}}}"),
}
"""The first level of a bomb, and an entry and the form of the next ones."""


def _no_file(draw: random.Random, place: Path) -> CommandLine:
    """Something that is no regular file, or a name of no file."""
    path = place / "case.yaml"
    if draw.random() < 0.3:
        word = draw.choice(_NO_NAMES)
        return CommandLine(f"file {shown(word)}", (draw.choice(["run", "sweep"]), word), word != "-")
    kind = draw.choice(list(NO_FILES))
    NO_FILES[kind](path)
    if draw.random() < 0.3:
        (place / "configs").mkdir()
        if os.path.lexists(path):
            path.rename(place / "configs" / "parking.yaml")
        return CommandLine(f"{kind} in configs/", draw.choice([("list",), ("run", "parking")]))
    return CommandLine(f"{kind} as a file", (draw.choice(["run", "sweep"]), "case.yaml"), True)


_NO_NAMES = (
    *("..", ".", "/", "", " ", "~", "-", "--", "\x1b[31m", "\ud800", "a\nb", "パーキング"),
    *("n" * 300, "n" * 300 + ".yaml", "d/" * 3000 + "x.yaml", "n" * 100_000),
)


def _data(draw: random.Random, place: Path) -> CommandLine:
    """A field from a file of numbers that is damaged, or not what its name says."""
    kind = draw.choice(["grid", "scattered"])
    name, tried, is_bad = draw.choice([_npy, _npy, _csv, _csv, _no_data])(draw, place)
    extent = draw.choice(["[0, 0, 6, 6]"] * 5 + ["[0, 0, 0, 0]", "[6, 6, 0, 0]", "[0, 0]", "[.nan, 0, 1, 1]"])
    is_bad = is_bad or extent != "[0, 0, 6, 6]"
    _write(place, f"problem: {{kind: monitoring, field: {{kind: {kind}, file: {name}, extent: {extent}}}}}\n")
    return CommandLine(f"{kind} field {name}: {tried}, extent {extent}", ("run", "case.yaml"), is_bad)


_GOOD = np.arange(12.0).reshape(4, 3)
_NO_FIELDS: dict[str, Any] = {
    "complex": _GOOD + 1j,
    "objects": np.array([[1, "a"], [None, 2.0]], object),
    **{f"of {kind}": _GOOD.astype(kind) for kind in ("U", "S4", "datetime64[s]", "timedelta64[s]")},
    "records": np.zeros((4, 3), [("a", "f8")]),
    "void": np.zeros((4, 3), "V8"),
    **{f"of shape {shape}": np.zeros(shape) for shape in ((0, 3), (4, 0), (), (3,), (2, 3, 4))},
    "NaN": _GOOD * np.nan,
    "infinite": _GOOD + np.inf,
    "wide": np.zeros((4, 3), np.longdouble) + np.finfo(np.longdouble).max,
}
_FIELDS: dict[str, Any] = {
    "huge": _GOOD * 1e307,
    "flags": _GOOD > 3,
    "columns first": np.asfortranarray(_GOOD),
    **{f"of {kind}": _GOOD.astype(kind) for kind in ("i1", ">f8", "f2")},
    "large integers": _GOOD.astype(np.uint64) + np.uint64(2**63),
}
_SHAPES = (
    *("(10000000000, 10000000000)", "(100000000000, 1000000000)", "(-1, 3)", "(4.5, 3)"),
    *("(" * 200, "{}", "__import__('os')", "None"),
)
"""Shapes in the header of a file of an array."""


def _npy(draw: random.Random, place: Path) -> tuple[str, str, bool]:
    arrays = _NO_FIELDS | _FIELDS
    change = draw.choice([*arrays, "npz", "pickle", "shape", "cut", "version", "noise", "text", "comma"])
    file = io.BytesIO()
    np.savez(file, a=_GOOD) if change == "npz" else np.save(file, arrays.get(change, _GOOD))
    content = file.getvalue()
    if change in ("shape", "comma"):
        shape = draw.choice(_SHAPES) if change == "shape" else "(4, 3, )"
        header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
        header += b" " * (-(len(header) + 11) % 64) + b"\n"
        content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + _GOOD.tobytes()
    changed = {
        "pickle": pickle.dumps(_GOOD),
        "cut": content[: draw.randrange(len(content))],
        "version": content[:6] + bytes([draw.randint(4, 255), 0]) + content[8:],
        "noise": draw.randbytes(200),
        "text": b"1,2,3\n4,5,6\n",
    }
    (place / "data.npy").write_bytes(changed.get(change, content))
    return "data.npy", change, change not in (*_FIELDS, "comma")


_ROWS = "".join(f"{index},{index + 1},{index * index}\n" for index in range(5))
_BAD_ROWS = (
    *("1,2", "a,b,c", "1,,3", "nan,1,2", "1,inf,2", "1,1e999,2", "1,2,1+2j", '"1","2","3"', "\0,1,2"),
    f"{'9' * 5000},1,2",
)
_NO_TABLES = {
    **{f"a row {shown(row)}": _ROWS + row + "\n" for row in _BAD_ROWS},
    **{"empty": "", "names alone": "x,y,value\n", "two lines of names": "x,y,value\nm,m,m\n" + _ROWS},
    **{"semicolons": _ROWS.replace(",", ";"), "one column": "1\n2\n3\n", "long": "1," * 10**6 + "1\n2\n"},
    **{"html": "<html><body>404</body></html>\n", "utf-16": _ROWS.encode("utf-16")},
}
_TABLES = {
    **{"comments": "# a\n" + _ROWS, "crlf": _ROWS.replace("\n", "\r\n"), "good": _ROWS, "end": _ROWS.strip()},
    **{"bom": _ROWS.encode("utf-8-sig"), "latin-1": b"x,y,h\xf6he\n" + _ROWS.encode()},
}


def _csv(draw: random.Random, place: Path) -> tuple[str, str, bool]:
    change = draw.choice([*_NO_TABLES, *_TABLES])
    content = (_NO_TABLES | _TABLES)[change]
    (place / "data.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    return "data.csv", change, change in _NO_TABLES


def _no_data(draw: random.Random, place: Path) -> tuple[str, str, bool]:
    suffix = draw.choice(["npy", "csv"])
    path = place / f"data.{suffix}"
    change = draw.choice([*NO_FILES, "long", "suffix", "nothing"])
    names = {
        "long": "n" * draw.choice([251, 10_000]) + f".{suffix}",
        "suffix": draw.choice(["data", "data.txt", "data.npz", ".npy", "''", "/"]),
    }
    NO_FILES.get(change, Path.touch)(path)
    return names.get(change, path.name), change, True


def _arguments(draw: random.Random, place: Path) -> CommandLine:
    """Options and words of the command line."""
    number = draw.choice(_NUMBERS)
    lines = [line.split() for line in listed(_COMMANDS)]
    lines += [["run", "chain", word] for word in _WORDS] + [[word] for word in _NO_COMMANDS]
    lines += [["run", "parking", "problem=" + "n" * 300], ["run", "two-pits", f"problem.walls={_WALLS}"]]
    lines += [[command, "n" * 300] for command in ("list", "report", "render")] + [["list", "\x1b[31m"]]
    words = [word.replace("@", number).replace("\0", "") for word in draw.choice(lines)]
    return CommandLine("bojax " + " ".join(map(shown, words)), tuple(words))


_NUMBERS = (
    *("0", "-1", "1", "1e3", "1.5", "", "abc", "nan", "10000000000", "1000000000", "1000000000000"),
    *("1" + "0" * 30, "9" * 5000, "٣", "0x10", "1_000", " 1", "+1", "--1", "true", "\x1b[31m1"),
)
_WALLS = str([[index, 0, index + 0.5, 1] for index in range(40)]).replace(" ", "")
_NO_COMMANDS = ("", "-", "--", "no-such", "--no-such", "-h5", "\x1b[31m", "run\n", "リスト")
_COMMANDS = """
    run chain --runs @  run chain --seed @  run chain --runs=@  sweep parking --runs @  run chain runs=@
    run chain episodes=@ --runs 2  run chain engine.lanes_per_device=@  run chain record.runs=@
    run two-pits problem.resolution=@  run parking planner.iterations=@  run parking planner.depth=@
    run mountain-car learner.features.num_features=@  render results --run @  render results --at @
    report @  run  sweep  report  render  run chain parking  run fig-4.6  sweep chain  sweep parking parking
    run parking problem=chain  run chain env=parking  run chain --resume  run chain --runs  run chain --out
    run chain --resume=yes  list no-such  report /dev/null  report /dev/zero  report .  render .
"""
"""Command lines, with @ for a number."""

_WORDS = (
    *listed(r"""
    =  =1  a=  episodes=  .=1  a..b=1  episodes.x=1  env.kind.x=1  episodes==3  kind=1  experiment=planning
    experiment=no-such  experiment=  env={kind: chain  env={kind: chain}  episodes 50  episodes: 50  env.no=1
    env.kind=taxi  base=1  axes=1  alias=x  claims=[]  episodes=1e12  episodes=1e3  title='\ud800'
    title=$\unknowncmd$  env.length=[1,2]  env={kind: chain, length: }  learner=&a [*a]  learner=!!bool maybe
    <<=1  engine=1  engine.device=tpu  seed=-1  engine.segment_seconds=1e400  engine.segment_seconds=0
    record=[]  stop=  schedule={}  --x=1
    """),
    *("env=" + "x" * 5000, "x" * 5000 + "=1", "a." * 5000 + "b=1", "env=\x1b[31m", "\x1b[31m=1"),
    *("\ud800=1", "title=\ud800", "title=\n", "title=" + "t" * 10_000, "episodes=3\nseed=4"),
)
"""Overrides of the chain that are odd as words."""


def _places(draw: random.Random, place: Path) -> CommandLine:
    """Results in an odd place; these run, since the place is only then made."""
    out = draw.choice(_OUTS)
    (place / "file").write_text("x")
    (place / "full").mkdir()
    (place / "full" / "mine").write_text("x")
    (place / "link").symlink_to("full")
    for name, kind in (("loop", "a link to itself"), ("broken", "a link to nothing"), ("fifo", "a pipe")):
        NO_FILES[kind](place / name)
    more = ("--resume",) if draw.random() < 0.3 else ()
    words = ("run", "chain", "--runs", "1", "episodes=1", f"--out={out}", *more)
    return CommandLine(f"--out={out[:40]} {' '.join(more)}", words, stops=False)


_OUTS = (
    *listed("/dev/null  /dev/null/x  /proc/x  /proc/self/x/y  /sys/x  file  file/x  full  loop/x  link"),
    *("broken", "fifo", "-x", "new/a/b", ".", "", " ", "é\u202e", "n" * 300, "n" * 300 + "/x", "d/" * 3000),
)


_MODULES = {
    "syntax": "def (",
    "raises": "raise RuntimeError('two\\nlines')",
    "exit 0": "import sys; sys.exit(0)",
    "exit 1": "import sys; sys.exit('bye')",
    "hard exit": "raise SystemExit",
    "missing import": "import no_such_module_at_all",
    "no class": "Thing = 3",
    "absent": "",
    "plain class": "class Thing:\n  pass",
    "raising constructor": "class Thing(Base):\n  def __init__(self):\n    raise RuntimeError('no\\nno')",
    "exiting constructor": "class Thing(Base):\n  def __init__(self):\n    raise SystemExit(0)",
    "odd annotation": "class Thing(Base):\n  x: 'no such type'\n",
    "odd default": "class Thing(Base):\n  x: int = object()\n",
    "odd config": "class Thing(Base):\n  Config = 3\n",
    "module getattr": "def __getattr__(name):\n  raise RuntimeError(name)",
    "deep": "def f(): f()\nf()",
    "memory": "x = 'a' * 10**13",
    "not text": "\udcff",
    "null": "x = '\0'",
    "control": "raise ValueError('\\x1b[31mred')",
    "long": "raise ValueError('x' * 10**6)",
    "prints": "print('hello')\nclass Thing:\n  pass",
    "group": "raise ExceptionGroup('a', [ValueError('b')])",
    "abstract": "class Thing(Base):\n  pass",
    "signature": "class Thing(Base):\n  def __init__(self, *args, **kwargs):\n    pass",
    "metaclass": "class M(type):\n  def __getattr__(c, n):\n    raise RuntimeError(n)\n"
    "class Thing(metaclass=M):\n  pass",
    "str": "class E(Exception):\n  def __str__(self):\n    raise RuntimeError('inner')\nraise E",
}
"""User's modules that go wrong when they are imported or used."""


def _module(draw: random.Random, place: Path) -> CommandLine:
    """A part of the user's own, from a module that goes wrong."""
    change, role = draw.choice(list(_MODULES)), draw.choice(sorted(_BASES))
    module, base, config = _BASES[role]
    text = f"from {module} import {base} as Base\n{_MODULES[change]}"
    text = text if "(Base)" in text else _MODULES[change]
    (place / "mine.py").write_bytes(text.encode("utf-8", errors="surrogateescape"))
    others = ["mine:", ":Thing", "mine.x:Thing", "mine:Thing.x", "mine:Thing:x"]
    path = draw.choice(["mine:Thing"] * 6 + others)
    params = draw.choice([(), (), (f"{role}.x=1",), (f"{role}.x=text",)])
    words = ("run", config, f"{role}={path}", *params)
    return CommandLine(f"{' '.join(words[1:])}, module: {change}", words, True)


_BASES = {
    "problem": ("bojax.problems.pose", "PoseProblem", "parking"),
    "env": ("bojax.envs.base", "Env", "mountain-car"),
    "planner": ("bojax.planning.base", "Planner", "parking"),
    "learner": ("bojax.learning.base", "Learner", "mountain-car"),
}


def _gymnasium(draw: random.Random, place: Path) -> CommandLine:
    """A Gymnasium environment that is not there, or goes wrong when it is made."""
    change = draw.choice([*_GYMS, "id"])
    (place / "gymmine.py").write_text(_GYMS.get(change, ""))
    name = "gymmine:Mine-v0" if change != "id" else draw.choice(_GYM_IDS)
    words = ("run", "mountain-car", f"env={{kind: gymnasium, id: '{name}', max_steps: 5}}")
    return CommandLine(f"gymnasium id {name[:40]!r}, {change}", words, True)


_GYM = """import gymnasium
class E(gymnasium.Env):
  def __init__(self, **k):
    {}
gymnasium.register('Mine-v0', E)"""
_GYMS = {
    **{"exit": "raise SystemExit(0)", "raises": "raise RuntimeError('a\\nb')", "nothing": ""},
    **{"constructor": _GYM.format("raise SystemExit(0)"), "no spaces": _GYM.format("pass")},
}
_GYM_IDS = listed("no-such  NoSuch-v0  gymmine:  no_such:X-v0  a:b:c  CartPole-v999")
_GYM_IDS += ("", "\x1b[31m", "x" * 5000)


FAMILIES: dict[Callable[[random.Random, Path], CommandLine], int] = {
    **{_setting: 20, _override: 14, _parts: 5, _fitting: 8, _structure: 9, _sweep: 12, _alias: 1, _bytes: 10},
    **{_bomb: 4, _no_file: 4, _data: 10, _arguments: 10, _places: 4, _module: 6, _gymnasium: 3},
}
"""Families of inputs with their weights."""


def _experiment(draw: random.Random) -> tuple[str, dict[str, Any]]:
    """A shipped config with every setting that its schema has, written out."""
    name = draw.choice(_names("configs"))
    return name, copy.deepcopy(_complete(name))


@functools.cache
def _complete(name: str) -> dict[str, Any]:
    from bojax.config.sweep import load_config

    sweep = load_config(name)
    tree = sweep.points[0].config.model_dump(mode="json")
    settings = {"title": sweep.title, "runs": sweep.runs, "seed": sweep.seed}
    settings |= {"record": sweep.record.model_dump(), "engine": sweep.engine.model_dump()}
    return {"experiment": tree.pop("kind"), **tree, **settings}


@functools.cache
def _names(folder: str) -> list[str]:
    return sorted(path.stem for path in (ROOT / folder).glob("*.yaml"))


@functools.cache
def _tree(name: str) -> dict[str, Any]:
    return yaml.safe_load(_path("sweeps", name).read_text())


def _path(folder: str, name: str) -> Path:
    return ROOT / folder / f"{name}.yaml"


def _misspelt(draw: random.Random, name: str) -> str:
    index = draw.randrange(len(name))
    return name[:index] + draw.choice(["", "x", name[index].upper(), ".", "-"]) + name[index + 1 :]


def _dump(tree: Any) -> str:
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, width=1000)
    return re.sub(rf"'{_HERE}'", _HERE, text)


def _write(place: Path, text: str) -> None:
    (place / "case.yaml").write_bytes(text.encode("utf-8", errors="surrogatepass"))
