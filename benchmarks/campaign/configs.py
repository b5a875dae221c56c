"""Bad configs and command lines: refused in one line with exit code 2, and nothing is run or written."""

import copy
import functools
import os
import random
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import Ended, run, scratch
from benchmarks.campaign.snippets import odd, shown

MAX_SECONDS = 10.0
"""Most processor time until an error."""

_MAX_WALL = 60.0
"""Most time until an error, on a machine that does something else as well."""

MAX_MEGABYTES = 1024

_HERE = "@here@"
"""Stands for an odd value until YAML has been written."""


@dataclass(frozen=True)
class Given:
    """A command line, with its files written.

    Attributes:
        tried: What is odd about it.
        words: The arguments of `bojax`.
        is_bad: Whether it has to be refused; otherwise it may be valid.
        stops: Whether a valid one stops short of running.
        traces: Whether the experiment of a valid one is traced: parts that do not fit may only fail there.
    """

    tried: str
    words: tuple[str, ...]
    is_bad: bool = False
    stops: bool = True
    traces: bool = False


def check(seed: int) -> Outcome:
    """Start `bojax` on an input that follows from the seed."""
    draw = random.Random(f"configs {seed}")
    family = draw.choices(list(FAMILIES), weights=list(FAMILIES.values()))[0]
    with scratch() as place:
        given = family(draw, place)
        before = _listing(place)
        ended = run(lambda: _command(given), place, seconds=_MAX_WALL)
        return Outcome(given.tried, _fault(given, ended) or _written(given, ended, before, _listing(place)))


def _fault(given: Given, ended: Ended) -> str:
    if ended.cpu > MAX_SECONDS:
        return f"{ended.cpu:.0f} s of processor time; {ended.err[-200:]}"
    if ended.megabytes > MAX_MEGABYTES:
        return f"{ended.megabytes:.0f} MB of memory; {ended.err[-200:]}"
    codes = (2,) if given.is_bad else (0, 2) if given.stops else (0, 1, 2)
    return fault_of(ended, codes, alone=given.stops)


def _written(given: Given, ended: Ended, before: set[str], after: set[str]) -> str:
    if not given.stops and ended.code == 0:
        return ""
    left = sorted(after ^ before)
    return f"written or gone: {', '.join(left[:3])}" if left else ""


def _listing(place: Path) -> set[str]:
    return {f"{path.relative_to(place)}" for path in place.rglob("*")}


def _command(given: Given) -> int:
    """`bojax` with these words; unless the case says otherwise it stops where the engine would start."""
    from bojax.cli.main import main

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
    return main(list(given.words))


def _trace(sweep: Any) -> int:
    """Trace a run of the first point; what goes wrong there is found after the folder was made."""
    import jax

    from bojax.engine.build import build

    config = sweep.points[0].config
    experiment: Any = build(config, getattr(config, "dtype", "float64"))
    if not experiment.is_hosted:
        jax.eval_shape(experiment.advance, jax.eval_shape(experiment.init, jax.random.key(0)))
    return 0


def _setting(draw: random.Random, place: Path) -> Given:
    """One setting of a shipped config, any that its schema has, with an odd value in the file."""
    name, tree = _experiment(draw)
    path = draw.choice(_paths(tree))
    snippet, is_bad = odd(draw)
    _assign(tree, path, _HERE)
    _write(place, _dump(tree).replace(_HERE, snippet))
    dotted = ".".join(map(str, path))
    return Given(f"{name} with {dotted}: {shown(snippet)}", ("run", "case.yaml"), is_bad)


def _override(draw: random.Random, place: Path) -> Given:
    """The same on the command line, and with a key that may be misspelt."""
    name, tree = _experiment(draw)
    path = draw.choice([path for path in _paths(tree) if all(isinstance(part, str) for part in path)])
    snippet, is_bad = odd(draw)
    snippet = snippet.replace("\0", "")
    key = ".".join(path)
    if draw.random() < 0.3:
        key, is_bad = _misspelt(draw, key), False
    return Given(f"{name} {key}={shown(snippet)}", ("run", name, f"{key}={snippet}"), is_bad)


def _parts(draw: random.Random, place: Path) -> Given:
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
    return Given(f"{name} {' '.join(words)}", ("run", name, *words), traces=True)


def _fitting(draw: random.Random, place: Path) -> Given:
    """A planner and a problem, or a learner and an environment, that may not fit."""
    from bojax.config.component import registry

    if draw.random() < 0.5:
        pairs, base = (("problem", "planner"), "two-pits")
    else:
        pairs, base = (("env", "learner"), "chain")
    words = [f"{role}={draw.choice(sorted(registry[role]))}" for role in pairs]
    extra = draw.choice(
        [
            "",
            "learner.features.state_lengthscale=[1,2,3,4,5,6,7]",
            "learner.features.action_lengthscale=[1,2,3,4,5,6,7]",
            "planner.motions=kernel",
            "planner.motions=splines",
            "planner.motions=cubic",
            "planner.acquisition=pi",
            "planner.objective=uncertainty",
            "problem.vehicle=quadrotor",
            "problem.sensor=range",
            "problem.walls=[[0,0,1,1]]",
            "schedule=decay",
            "dtype=float32",
            "learner.features=indicators",
            "problem.kernel={kind: rbf, lengthscale: [1,2,3]}",
            "problem.domain=[0,0,1e-3,1e-3]",
        ]
    )
    words += [extra] if extra else []
    return Given(f"{base} {' '.join(words)}", ("run", base, *words), traces=True)


def _structure(draw: random.Random, place: Path) -> Given:
    """Keys that are unknown, misspelt, missing, twice there, or no names."""
    name, tree = _experiment(draw)
    path = draw.choice([path for path in _paths(tree) if isinstance(path[-1], str)])
    parent, key = _at(tree, path[:-1]), path[-1]
    change = draw.choice(["unknown", "misspelt", "missing", "moved", "many", "twice", "odd", "list", "long"])
    is_bad = change in ("unknown", "twice", "many", "list")
    if change == "unknown":
        parent["surprise"] = 1
    elif change == "misspelt":
        parent[_misspelt(draw, key)] = parent.pop(key)
    elif change == "missing":
        del parent[key]
    elif change == "moved":
        tree[f"{key}"] = parent.pop(key) if parent is not tree else parent[key]
    elif change == "many":
        parent.update({f"key{index}": index for index in range(draw.choice([100, 10_000, 100_000]))})
    elif change == "long":
        parent["k" * draw.choice([300, 100_000])] = 1
    text = _dump(tree)
    if change == "twice":
        text += text.splitlines()[0] + "\n" if ":" in text.splitlines()[0] else "seed: 1\nseed: 2\n"
    elif change == "odd":
        text += draw.choice(
            ["1: 2\n", "? [a, b]\n: 1\n", "? {a: 1}\n: 2\n", "null: 1\n", "true: 1\n", "'': 1\n"]
        )
        text += draw.choice(["", '"\\x1b[31m": 1\n', '"\\ud800": 1\n', "a b: 1\n", "2024-01-01: 1\n"])
        is_bad = True
    elif change == "list":
        text = "".join(
            f"- {line}\n" if not line.startswith(" ") else f"  {line}\n" for line in text.splitlines()
        )
    _write(place, text)
    return Given(f"{name}: key {change} at {'.'.join(map(str, path))}", ("run", "case.yaml"), is_bad)


def _sweep(draw: random.Random, place: Path) -> Given:
    """A shipped sweep with an odd value in its axes, claims, report or base."""
    name = draw.choice(_names("sweeps"))
    tree = copy.deepcopy(_tree("sweeps", name))
    if "base" not in tree:
        tree = copy.deepcopy(_tree("sweeps", "fig-4.6"))
    snippet, is_bad = odd(draw)
    change = draw.choice(["setting", "setting", "setting", "axis", "axes", "large", "names", "combine"])
    if change == "setting":
        path = draw.choice(_paths(tree))
        _assign(tree, path, _HERE)
        is_bad = False  # titles, notes and numbers of the thesis are free
        tried = f"{'.'.join(map(str, path))}: {shown(snippet)}"
    elif change == "axis":
        axis = draw.choice(["planner.iterations", "problem", "runs", "", "a..b", "planner", "seed", "env.x"])
        tree["axes"] = {axis: draw.choice([_HERE, [_HERE], [1, _HERE], {"a": _HERE}, {"a": {"b": _HERE}}])}
        is_bad = False
        tried = f"axes {tree['axes']} with {shown(snippet)}".replace(_HERE, "@")
    elif change == "axes":
        tree["axes"], is_bad = _HERE, False
        tried = f"axes: {shown(snippet)}"
    elif change == "large":
        counts = draw.choice([[10**6], [10**4, 10**4], [1000] * 4, [10] * 12, [300]])
        tree = {
            "base": "parking",
            "axes": {f"planner.{n}": list(range(1, c + 1)) for n, c in _numbers(counts)},
        }
        is_bad = False
        tried = f"axes of {counts} values"
    elif change == "names":
        odd_names = [
            "a/b",
            "",
            " ",
            "\x1b[31m",
            "n" * 300,
            "é",
            "..",
            "$\\unknowncmd$",
            "a\nb",
            1,
            None,
            True,
        ]
        tree["axes"] = {"planner": {draw.choice(odd_names): {}, "b": {}}}
        is_bad = False
        tried = f"a variant of the name {list(tree['axes']['planner'])[0]!r}"[:80]
    else:
        tree["combine"] = _HERE
        tried = f"combine: {shown(snippet)}"
    base = draw.choice(
        [tree.get("base"), tree.get("base"), "no-such", "case.yaml", "", 3, [], {"kind": 1}, None]
    )
    if change == "setting" and draw.random() < 0.2:
        tree["base"] = base
        tried += f", base: {str(base)[:40]}"
    text = _dump(tree).replace(_HERE, snippet)
    _write(place, text)
    return Given(f"sweep {name}: {tried}", ("sweep", "case.yaml"), is_bad)


def _alias(draw: random.Random, place: Path) -> Given:
    """A sweep that stands for another one, or for nothing."""
    value = draw.choice(["case", "case.yaml", "no-such", "3", "[a]", "{a: 1}", "''", "..", "/", "parking"])
    more = draw.choice(["", "runs: 3\n"])
    _write(place, f"alias: {value}\n{more}")
    return Given(
        f"alias: {value} {more.strip()}", (draw.choice(["sweep", "run"]), "case.yaml"), value != "parking"
    )


def _bytes(draw: random.Random, place: Path) -> Given:
    """The text of a shipped file, damaged."""
    folder = draw.choice(["configs", "sweeps"])
    name = draw.choice(_names(folder))
    content = bytearray(_path(folder, name).read_bytes())
    middle = draw.randrange(len(content))
    change = draw.choice(
        [
            "cut",
            "flip",
            "zero",
            "utf-16",
            "utf-16 bare",
            "latin-1",
            "bom",
            "garbage",
            "tab",
            "crlf",
            "control",
        ]
        + ["twice", "documents", "empty", "spaces", "comment", "huge", "delete", "indent", "quote"]
    )
    if change == "cut":
        content = content[:middle]
    elif change == "flip":
        content[middle] ^= 1 << draw.randrange(8)
    elif change == "zero":
        content[middle] = 0
    elif change == "utf-16":
        content = bytearray(content.decode().encode("utf-16"))
    elif change == "utf-16 bare":
        content = bytearray(content.decode().encode("utf-16-le"))
    elif change == "latin-1":
        content[middle:middle] = b"\xe9\xff"
    elif change == "bom":
        content[middle:middle] = b"\xef\xbb\xbf"
    elif change == "garbage":
        content = bytearray(draw.randbytes(draw.choice([10, 1000, 100_000])))
    elif change == "tab":
        content = content.replace(b"  ", b"\t")
    elif change == "crlf":
        content = content.replace(b"\n", b"\r\n")
    elif change == "control":
        content[middle:middle] = draw.choice([b"\x1b[31m", b"\x07", b"\x7f", b"\x85", b"\xe2\x80\xa8"])
    elif change == "twice":
        content = content + content
    elif change == "documents":
        content += b"\n---\n" + content
    elif change in ("empty", "spaces", "comment"):
        content = bytearray({"empty": b"", "spaces": b"  \n \n", "comment": b"# nothing\n"}[change])
    elif change == "huge":
        content += b"# " + b"x" * 10_000_000
    elif change == "delete":
        del content[middle : middle + draw.randint(1, 20)]
    elif change == "indent":
        lines: list[bytes] = list(bytes(content).split(b"\n"))
        index = draw.randrange(len(lines))
        lines[index] = b" " * draw.randint(1, 5) + lines[index]
        content = bytearray(b"\n".join(lines))
    else:
        content[middle:middle] = draw.choice(
            [b"'", b'"', b"{", b"[", b"&a ", b"*a ", b"!!int ", b"<<: ", b"%"]
        )
    (place / "case.yaml").write_bytes(content)
    bad = ("utf-16", "utf-16 bare", "latin-1", "garbage", "twice", "documents", "empty", "spaces", "comment")
    command = "run" if folder == "configs" else "sweep"
    return Given(f"{name}: {change} at byte {middle}", (command, "case.yaml"), change in bad)


def _bomb(draw: random.Random, place: Path) -> Given:
    """A short text that stands for a large value."""
    levels, width = draw.choice([(3, 9), (6, 9), (9, 9), (10, 10), (30, 2), (100, 2)])
    style = draw.choice(["aliases", "merges", "merged lists", "mappings", "deep", "deep mappings", "keys"])
    lines = []
    if style == "deep":
        lines = ["title: " + "[" * 10 ** draw.randint(2, 5)]
    elif style == "deep mappings":
        depth = 10 ** draw.randint(2, 4)
        lines = [f"{' ' * level}a:" for level in range(depth)]
    elif style == "keys":
        lines = [f"k{index}: &k{index} [*k{index - 1}, 1]" if index else "k0: &k0 1" for index in range(2000)]
    else:
        for level in range(levels):
            below = ", ".join([f"*a{level - 1}"] * width) if level else "1"
            if style == "aliases":
                lines.append(f"k{level}: &a{level} [{below}]")
            elif style == "mappings":
                entries = ", ".join(f"b{i}: *a{level - 1}" for i in range(width)) if level else "b: 1"
                lines.append(f"k{level}: &a{level} {{{entries}}}")
            elif style == "merges":
                lines.append(
                    f"k{level}: &a{level} {{" + (f"<<: [{below}], c{level}: 1}}" if level else "c: 1}")
                )
            else:
                lines.append(f"k{level}: &a{level} [{below}]" if level else f"k{level}: &a{level} [{{c: 1}}]")
        if style == "merged lists":
            lines.append(f"z: {{<<: *a{levels - 1}}}")
    _write(place, "\n".join(lines) + "\n")
    return Given(f"{style}, {levels} levels of {width}", (draw.choice(["run", "sweep"]), "case.yaml"), True)


def _no_file(draw: random.Random, place: Path) -> Given:
    """Something that is no regular file, or a name of no file."""
    path = place / "case.yaml"
    kind = draw.choice(
        ["fifo", "folder", "socket", "device", "loop", "broken", "missing", "long", "zero", "dots"]
    )
    word = "case.yaml"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "socket":
        here = os.getcwd()
        os.chdir(place)
        with socket.socket(socket.AF_UNIX) as server:
            server.bind("case.yaml")
        os.chdir(here)
    elif kind in ("device", "zero"):
        path.symlink_to("/dev/null" if kind == "device" else "/dev/zero")
    elif kind == "loop":
        path.symlink_to("case.yaml")
    elif kind == "broken":
        path.symlink_to("nowhere.yaml")
    elif kind == "long":
        word = draw.choice(["n" * 300, "n" * 300 + ".yaml", "d/" * 3000 + "x.yaml", "n" * 100_000])
    elif kind == "dots":
        word = draw.choice(
            ["..", ".", "/", "", " ", "~", "-", "--", "\x1b[31m", "\ud800", "a\nb", "パーキング"]
        )
    command = draw.choice(["run", "sweep"])
    if draw.random() < 0.3 and kind not in ("long", "dots"):
        (place / "configs").mkdir()
        path.rename(place / "configs" / "parking.yaml") if os.path.lexists(path) else None
        return Given(f"{kind} in configs/", ("list",) if draw.random() < 0.5 else ("run", "parking"))
    return Given(f"{command} of {kind} {word[:30]!r}", (command, word), word != "-" or kind != "dots")


def _data(draw: random.Random, place: Path) -> Given:
    """A field from a file of numbers that is damaged, or not what its name says."""
    kind = draw.choice(["grid", "scattered"])
    name, tried, is_bad = draw.choice([_npy, _npy, _csv, _csv, _no_data])(draw, place)
    extent = draw.choice(["[0, 0, 6, 6]"] * 5 + ["[0, 0, 0, 0]", "[6, 6, 0, 0]", "[0, 0]", "[.nan, 0, 1, 1]"])
    is_bad = is_bad or extent != "[0, 0, 6, 6]"
    field = f"{{kind: {kind}, file: {name}, extent: {extent}}}"
    _write(place, f"base_title: 1\nproblem: {{kind: monitoring, field: {field}}}\n".partition("\n")[2])
    return Given(f"{kind} field {name}: {tried}, extent {extent}", ("run", "case.yaml"), is_bad)


def _npy(draw: random.Random, place: Path) -> tuple[str, str, bool]:
    path = place / "data.npy"
    good = np.arange(12.0).reshape(4, 3)
    arrays: dict[str, Any] = {
        "complex": good + 1j,
        "objects": np.array([[1, "a"], [None, 2.0]], object),
        "text": good.astype(str),
        "bytes": good.astype("S4"),
        "dates": good.astype("datetime64[s]"),
        "durations": good.astype("timedelta64[s]"),
        "records": np.zeros((4, 3), [("a", "f8")]),
        "void": np.zeros((4, 3), "V8"),
        "empty": np.zeros((0, 3)),
        "no columns": np.zeros((4, 0)),
        "a number": np.float64(1),
        "one axis": np.zeros(3),
        "three axes": np.zeros((2, 3, 4)),
        "NaN": good * np.nan,
        "infinite": good + np.inf,
        "wide": np.zeros((4, 3), np.longdouble) + np.finfo(np.longdouble).max,
    }
    fine: dict[str, Any] = {
        "huge": good * 1e307,
        "integers": good.astype(np.int8),
        "flags": good > 3,
        "big-endian": good.astype(">f8"),
        "columns first": np.asfortranarray(good),
        "half": good.astype(np.float16),
        "large integers": good.astype(np.uint64) + np.uint64(2**63),
    }
    change = draw.choice(
        [*arrays, *fine, "npz", "pickle", "shape", "header", "cut", "version", "garbage", "text file"]
    )
    if change in arrays or change in fine:
        np.save(path, (arrays | fine)[change], allow_pickle=True)
        return path.name, change, change in arrays
    if change == "npz":
        with path.open("wb") as file:
            np.savez(file, a=good)
    elif change == "pickle":
        import pickle

        path.write_bytes(pickle.dumps(good))
    elif change in ("shape", "header"):
        shape = draw.choice(
            ["(10**10, 10**10)", "(100000000000, 1000000000)", "(-1, 3)", "(4.5, 3)", "(4, 3, )"]
        )
        shape = shape if change == "shape" else draw.choice(["(" * 200, "{}", "__import__('os')", "None"])
        shape = shape.replace("10**10", "10000000000")
        header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
        header += b" " * (-(len(header) + 11) % 64) + b"\n"
        path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + good.tobytes())
        if shape == "(4, 3, )":
            return path.name, "a header with a comma", False
    else:
        np.save(path, good)
        content = bytearray(path.read_bytes())
        content = {
            "cut": content[: draw.randrange(len(content))],
            "version": content[:6] + bytes([draw.randint(4, 255), 0]) + content[8:],
            "garbage": bytearray(draw.randbytes(200)),
            "text file": bytearray(b"1,2,3\n4,5,6\n"),
        }[change]
        path.write_bytes(content)
    return path.name, change, True


def _csv(draw: random.Random, place: Path) -> tuple[str, str, bool]:
    path = place / "data.csv"
    rows = "".join(f"{i},{i + 1},{i * i}\n" for i in range(5))
    bad = {
        "ragged": rows + "1,2\n",
        "text": rows + "a,b,c\n",
        "empty": "",
        "names alone": "x,y,value\n",
        "two lines of names": "x,y,value\nm,m,m\n" + rows,
        "holes": rows + "1,,3\n",
        "NaN": rows + "nan,1,2\n",
        "infinite": rows + "1,inf,2\n",
        "too large": rows + "1,1e999,2\n",
        "semicolons": rows.replace(",", ";"),
        "complex": rows + "1,2,1+2j\n",
        "one column": "1\n2\n3\n",
        "html": "<html><body>404</body></html>\n",
        "quoted": rows + '"1","2","3"\n',
        "zero bytes": rows + "\0,1,2\n",
        "long line": "1," * 10**6 + "1\n2\n",
        "many digits": rows + f"{'9' * 5000},1,2\n",
    }
    fine = {"comments": "# a\n" + rows, "crlf": rows.replace("\n", "\r\n"), "good": rows, "end": rows.strip()}
    change = draw.choice([*bad, *fine, "utf-16", "bom", "latin-1"])
    if change in bad or change in fine:
        path.write_text((bad | fine)[change])
    else:
        content = {"utf-16": rows.encode("utf-16"), "bom": rows.encode("utf-8-sig")}
        path.write_bytes(content.get(change, b"x,y,h\xf6he\n" + rows.encode()))
    return path.name, change, change in bad or change == "utf-16"


def _no_data(draw: random.Random, place: Path) -> tuple[str, str, bool]:
    suffix = draw.choice(["npy", "csv"])
    path = place / f"data.{suffix}"
    change = draw.choice(["fifo", "folder", "missing", "loop", "zero", "tty", "long", "suffix", "nothing"])
    name = path.name
    if change == "fifo":
        os.mkfifo(path)
    elif change == "folder":
        path.mkdir()
    elif change == "loop":
        path.symlink_to(path.name)
    elif change in ("zero", "tty"):
        path.symlink_to(f"/dev/{change}")
    elif change == "long":
        name = "n" * draw.choice([251, 10_000]) + f".{suffix}"
    elif change == "suffix":
        name = draw.choice(["data", "data.txt", "data.npz", ".npy", "''", "/"])
    elif change == "nothing":
        path.touch()
    return name, change, True


def _arguments(draw: random.Random, place: Path) -> Given:
    """Options and words of the command line."""
    numbers = ["0", "-1", "1", "1e3", "1.5", "", "abc", "nan", "10000000000", "1000000000", "1000000000000"]
    numbers += ["1" + "0" * 30, "9" * 5000, "٣", "0x10", "1_000", " 1", "+1", "--1", "true", "\x1b[31m1"]
    number = draw.choice(numbers)
    words = draw.choice(
        [
            ("run", "chain", "--runs", number),
            ("run", "chain", "--seed", number),
            ("run", "chain", f"--runs={number}"),
            ("sweep", "parking", "--runs", number),
            ("run", "chain", f"runs={number}"),
            ("run", "chain", f"episodes={number}", "--runs", "2"),
            ("run", "chain", f"engine.lanes_per_device={number}"),
            ("run", "chain", f"record.runs={number}"),
            ("run", "two-pits", f"problem.resolution={number}"),
            ("run", "parking", f"planner.iterations={number}"),
            ("run", "parking", f"planner.depth={number}"),
            ("run", "mountain-car", f"learner.features.num_features={number}"),
            ("render", "results", "--run", number),
            ("render", "results", "--at", number),
            ("report", number),
            *(("run", "chain", word) for word in _WORDS),
            *(
                (word,)
                for word in ("", "-", "--", "no-such", "--no-such", "-h5", "\x1b[31m", "run\n", "リスト")
            ),
            *((command,) for command in ("run", "sweep", "report", "render")),
            ("run", "chain", "parking"),
            ("run", "fig-4.6"),
            ("sweep", "chain"),
            ("sweep", "parking", "parking"),
            ("run", "parking", "problem=chain"),
            ("run", "chain", "env=parking"),
            ("run", "parking", "problem=" + "n" * 300),
            (
                "run",
                "two-pits",
                "problem.walls=" + str([[i, 0, i + 0.5, 1] for i in range(40)]).replace(" ", ""),
            ),
            ("run", "chain", "--resume"),
            ("run", "chain", "--runs"),
            ("run", "chain", "--out"),
            ("run", "chain", "--resume=yes"),
            ("list", "no-such"),
            ("list", "n" * 300),
            ("list", "\x1b[31m"),
            ("report", "n" * 300),
            ("report", "/dev/null"),
            ("report", "/dev/zero"),
            ("report", "."),
            ("render", "n" * 300),
            ("render", "."),
        ]
    )
    return Given("bojax " + " ".join(map(shown, words)), tuple(word.replace("\0", "") for word in words))


_WORDS = (
    *("=", "=1", "a=", "episodes=", ".=1", "a..b=1", "episodes.x=1", "env.kind.x=1", "episodes==3", "kind=1"),
    *("experiment=planning", "experiment=no-such", "experiment=", "env={kind: chain", "env={kind: chain}"),
    *("episodes 50", "episodes: 50", "env.no=1", "env.kind=taxi", "base=1", "axes=1", "alias=x", "claims=[]"),
    *("episodes=1e12", "episodes=1e3", "env=" + "x" * 5000, "x" * 5000 + "=1", "a." * 5000 + "b=1"),
    *("env=\x1b[31m", "\x1b[31m=1", "\ud800=1", "title=\ud800", "title='\\ud800'", "title=$\\unknowncmd$"),
    *("env.length=[1,2]", "env={kind: chain, length: }", "learner=&a [*a]", "learner=!!bool maybe", "<<=1"),
    *("title=\n", "title=" + "t" * 10_000, "episodes=3\nseed=4", "engine=1", "engine.device=tpu", "seed=-1"),
    *(
        "engine.segment_seconds=1e400",
        "engine.segment_seconds=0",
        "record=[]",
        "stop=",
        "schedule={}",
        "--x=1",
    ),
)
"""Overrides of the chain that are odd as words."""


def _places(draw: random.Random, place: Path) -> Given:
    """Results in an odd place; these run, since the place is only then made."""
    out = draw.choice(
        [
            "/dev/null",
            "/dev/null/x",
            "/proc/x",
            "/proc/self/x/y",
            "/sys/x",
            "file",
            "file/x",
            "full",
            "loop/x",
        ]
        + [
            "n" * 300,
            "n" * 300 + "/x",
            "d/" * 3000,
            "link",
            "broken",
            "fifo",
            "",
            ".",
            " ",
            "é\u202e",
            "-x",
            "new/a/b",
        ]
    )
    (place / "file").write_text("x")
    (place / "full").mkdir()
    (place / "full" / "mine").write_text("x")
    (place / "loop").symlink_to("loop")
    (place / "broken").symlink_to("nowhere")
    (place / "link").symlink_to("full")
    os.mkfifo(place / "fifo")
    more = ("--resume",) if draw.random() < 0.3 else ()
    words = ("run", "chain", "--runs", "1", "episodes=1", f"--out={out}", *more)
    return Given(f"--out={out[:40]} {' '.join(more)}", words, stops=False)


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


def _module(draw: random.Random, place: Path) -> Given:
    """A part of the user's own, from a module that goes wrong."""
    change = draw.choice(list(_MODULES))
    roles = {
        "problem": ("bojax.problems.pose:PoseProblem", "parking"),
        "env": ("bojax.envs.base:Env", "mountain-car"),
        "planner": ("bojax.planning.base:Planner", "parking"),
        "learner": ("bojax.learning.base:Learner", "mountain-car"),
    }
    role = draw.choice(sorted(roles))
    base, config = roles[role]
    module, _, name = base.partition(":")
    text = _MODULES[change]
    if "(Base)" in text:
        text = f"from {module} import {name} as Base\n{text}"
    (place / "mine.py").write_bytes(text.encode("utf-8", errors="surrogateescape"))
    path = draw.choice(
        ["mine:Thing"] * 6 + ["mine:", ":Thing", "mine.x:Thing", "mine:Thing.x", "mine:Thing:x"]
    )
    params = draw.choice(["", "", f"{role}.x=1", f"{role}.x=text"])
    words = ("run", config, f"{role}={path}", *([params] if params else []))
    return Given(f"{' '.join(words[1:])}, module: {change}", words, True)


def _gymnasium(draw: random.Random, place: Path) -> Given:
    """A Gymnasium environment that is not there, or goes wrong when it is made."""
    texts = {
        "exit": "raise SystemExit(0)",
        "raises": "raise RuntimeError('a\\nb')",
        "nothing": "",
        "constructor": "import gymnasium\nclass E(gymnasium.Env):\n  def __init__(self, **k):\n"
        "    raise SystemExit(0)\ngymnasium.register('Mine-v0', E)",
        "no spaces": "import gymnasium\nclass E(gymnasium.Env):\n  def __init__(self, **k):\n    pass\n"
        "gymnasium.register('Mine-v0', E)",
    }
    change = draw.choice([*texts, "id"])
    (place / "gymmine.py").write_text(texts.get(change, ""))
    ids = [
        "",
        "no-such",
        "NoSuch-v0",
        "gymmine:",
        "no_such:X-v0",
        "a:b:c",
        "CartPole-v999",
        "\x1b[31m",
        "x" * 5000,
    ]
    name = "gymmine:Mine-v0" if change != "id" else draw.choice(ids)
    words = ("run", "mountain-car", f"env={{kind: gymnasium, id: '{name}', max_steps: 5}}")
    return Given(f"gymnasium id {name[:40]!r}, {change}", words, True)


FAMILIES: dict[Callable[[random.Random, Path], Given], int] = {
    _setting: 20,
    _override: 14,
    _parts: 5,
    _fitting: 8,
    _structure: 9,
    _sweep: 12,
    _alias: 1,
    _bytes: 10,
    _bomb: 4,
    _no_file: 4,
    _data: 10,
    _arguments: 10,
    _places: 4,
    _module: 6,
    _gymnasium: 3,
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
    return sorted(path.stem for path in _path(folder, "").parent.glob("*.yaml"))


@functools.cache
def _tree(folder: str, name: str) -> dict[str, Any]:
    return yaml.safe_load(_path(folder, name).read_text())


def _path(folder: str, name: str) -> Path:
    return Path(__file__).parents[2] / folder / f"{name}.yaml"


def _paths(tree: Any, path: tuple = ()) -> list[tuple]:
    """Paths of all settings of a tree, those of mappings and lists among them."""
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    found = []
    for key, value in entries:
        found += [(*path, key), *_paths(value, (*path, key))]
    return found


def _at(tree: Any, path: tuple) -> Any:
    for key in path:
        tree = tree[key]
    return tree


def _assign(tree: Any, path: tuple, value: Any) -> None:
    _at(tree, path[:-1])[path[-1]] = value


def _misspelt(draw: random.Random, name: str) -> str:
    index = draw.randrange(len(name))
    return name[:index] + draw.choice(["", "x", name[index].upper(), ".", "-"]) + name[index + 1 :]


def _numbers(counts: list[int]) -> list[tuple[str, int]]:
    names = ["iterations", "depth", "exploration", "discount", "motions.actions", "motions.length"]
    names += [f"x{index}" for index in range(len(counts))]
    return list(zip(names, counts, strict=False))


def _dump(tree: Any) -> str:
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, width=1000)
    return re.sub(rf"'{_HERE}'", _HERE, text)


def _write(place: Path, text: str) -> None:
    (place / "case.yaml").write_bytes(text.encode("utf-8", errors="surrogatepass"))
