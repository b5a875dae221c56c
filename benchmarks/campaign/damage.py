"""Interrupted folders with one thing damaged: a resumed one ends in the right bytes, or in one line."""

import json
import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import run, scratch
from benchmarks.campaign.spoil import BYTES, spoil
from benchmarks.campaign.trees import assign, at, paths
from benchmarks.campaign.workloads import WORKLOADS, fault_in, interrupted, resumed

_INTERRUPTED = (("toy", 12), ("toy", 30), ("tabular", 12), ("learner", 3), ("monitoring", 6))
"""Workloads, with the number of pieces at which they were interrupted."""


def check(seed: int) -> Outcome:
    """Damage one thing in a copy of an interrupted folder, then resume it."""
    draw = random.Random(f"damage {seed}")
    name, pieces = draw.choice(_INTERRUPTED)
    original = interrupted(name, pieces)
    with scratch() as place:
        out = place / "out"
        shutil.copytree(original, out, symlinks=True)
        tried = f"{name}: {damage(draw, out)}"
        ended = run(WORKLOADS[name].start(out, resume=True), place)
        if ended.code == 0 or ended.is_late:
            return Outcome(tried, fault_of(ended, (0,)) or fault_in(out, name))
        if fault := fault_of(ended, (1, 2)):
            return Outcome(tried, fault)
        if tables := sorted(path.name for path in out.glob("*.parquet")):
            return Outcome(tried, f"refused, and yet there is {', '.join(tables)}")
        advice = re.search(r"delete the folder (\S+\.work/chunk-[^/\s]+) and resume", ended.err)
        if not advice or draw.random() < 0.5:
            return Outcome(tried)
        shutil.rmtree(place / advice[1])
        fault = resumed(name, out, place)
        return Outcome(tried, f"as advised, deleted {Path(advice[1]).name}: {fault}" if fault else "")


def damage(draw: random.Random, folder: Path) -> str:
    """Damage one file or folder below `folder`; says what was done."""
    victim = _victim(draw, folder)
    done = draw.choice([*_ANY, *_DAMAGES.get(victim.suffix, ())])(draw, victim)
    return f"{victim.relative_to(folder)}: {done}"


def _victim(draw: random.Random, folder: Path) -> Path:
    """A file: first its sort is drawn, so that the many files of checkpoints are not nearly all cases."""
    sorts: dict[str, list[Path]] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink():
            name = path.relative_to(folder)
            sort = "checkpoint" if any(part.startswith("checkpoint-") for part in name.parts) else path.name
            sort = re.sub(r"piece-\d+", "piece", sort) if path.suffix == ".parquet" else sort
            sorts.setdefault(".npz" if path.suffix == ".npz" else sort, []).append(path)
    return draw.choice(sorts[draw.choice(sorted(sorts))])


def _delete(draw: random.Random, path: Path) -> str:
    path.unlink()
    return "deleted"


def _delete_folder(draw: random.Random, path: Path) -> str:
    shutil.rmtree(path.parent)
    return "deleted with its folder"


def _flip(draw: random.Random, path: Path) -> str:
    path.write_bytes(BYTES["flipped"](draw, path.read_bytes()))
    return "flipped"


def _overwrite(draw: random.Random, path: Path) -> str:
    """Copy another file over it, or let the two change places."""
    others = [other for other in sorted(path.parent.iterdir()) if other.is_file() and other != path]
    if not others:
        return _delete(draw, path)
    alike = [other for other in others if other.suffix == path.suffix] or others
    other = draw.choice(alike if draw.random() < 0.8 else others)
    content, is_swap = path.read_bytes(), draw.random() < 0.3
    shutil.copyfile(other, path)
    if is_swap:
        other.write_bytes(content)
    return f"{'swapped with' if is_swap else 'overwritten by'} {other.name}"


def _stray(draw: random.Random, path: Path) -> str:
    number = path.name.replace("-000", "-999", 1)
    name = draw.choice([f"piece-foo{path.suffix}", number, f".{path.name}.tmp", f"piece-{path.name}"])
    stray = path.with_name(name)
    if draw.random() < 0.3 and not stray.exists():
        stray.mkdir()
        return f"a folder {stray.name} beside it"
    shutil.copyfile(path, stray) if stray != path else None
    return f"a copy {stray.name} beside it"


ODD_JSON: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 10**30, 2**63, 0.5, 1e308, float("nan"), float("inf"), "", "text"),
    *("\x1b[31m", "\ud800", "../../..", "a" * 10_000, [], {}, [[]], [None], {"": None}, [1, 2, 3], ["a", {}]),
)
"""Values that a JSON file may hold in place of what was written."""


def edit_json(draw: random.Random, path: Path) -> str:
    """Give one entry of a JSON file another value, another name, or take it away."""
    try:
        tree = json.loads(path.read_text())
    except (ValueError, RecursionError):  # damaged before
        return _flip(draw, path)
    tree = [tree]
    where = draw.choice(paths(tree)[1:] or [(0,)])
    change = draw.choice(["value", "value", "value", "type", "delete", "add"])
    parent = at(tree, where[:-1])
    if change == "delete":
        del parent[where[-1]]
    elif change == "add" and isinstance(parent, dict):
        parent[draw.choice(["surprise", "", "pieces "])] = draw.choice(ODD_JSON)
    else:
        value = _other(at(tree, where)) if change == "type" else draw.choice(ODD_JSON)
        assign(tree, where, value)
        change += f", now {json.dumps(value)[:40]}"
    path.write_text(json.dumps(*tree) if tree else "")
    return f"entry {'.'.join(map(str, where[1:])) or 'all'}: {change}"


def _nest(draw: random.Random, path: Path) -> str:
    depth = draw.choice([1_000, 100_000])
    path.write_text("[" * depth + "]" * depth if draw.random() < 0.5 else '{"a":' * depth + "1" + "}" * depth)
    return f"nested {depth} deep"


def _whole(draw: random.Random, path: Path) -> str:
    value = draw.choice(ODD_JSON)
    path.write_text(json.dumps(value))
    return f"replaced by {json.dumps(value)[:40]}"


def _other(value: Any) -> Any:
    """A value much like this one, of another type."""
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, int | float):
        return str(value)
    if isinstance(value, str):
        return [value]
    if isinstance(value, list):
        return dict(enumerate(value)) if value else ""
    return list(value) if isinstance(value, dict) else 0


def edit_table(draw: random.Random, path: Path) -> str:
    """Change what a parquet file holds, and leave it well-formed."""
    table = pq.read_table(path)
    column = draw.choice(table.column_names)
    index = table.column_names.index(column)
    kind = table.schema.field(column).type
    change = draw.choice(["value", "rows", "drop", "rename", "text", "nulls", "order", "twice"])
    if change == "value" and table.num_rows and (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
        values = table[column].to_numpy(zero_copy_only=False).copy()
        values[draw.randrange(len(values))] += 1
        table = table.set_column(index, table.schema.field(column), pa.array(values, kind))
    elif change == "rows":
        table = table.slice(0, draw.randrange(max(1, table.num_rows)))
    elif change == "drop":
        table = table.drop_columns([column])
    elif change == "rename":
        table = table.rename_columns([f"{n}_" if n == column else n for n in table.column_names])
    elif change == "nulls":
        table = table.set_column(index, column, pa.nulls(table.num_rows, kind))
    elif change == "order":
        table = table.take(pa.array(np.arange(table.num_rows)[::-1]))
    elif change == "twice":
        table = pa.concat_tables([table, table])
    else:
        change = "text"
        table = table.set_column(index, column, pa.array([str(v) for v in table[column].to_pylist()]))
    pq.write_table(table, path)
    return f"column {column}: {change}"


def edit_arrays(draw: random.Random, path: Path) -> str:
    """Change the arrays of an npz file, and leave it well-formed."""
    arrays = dict(np.load(path))
    name = draw.choice(sorted(arrays))
    value = arrays.pop(name)
    changes: dict[str, Callable[[], Any]] = {
        "text": lambda: value.astype(str),
        "complex": lambda: value.astype(complex) + 1j,
        "integers": lambda: np.nan_to_num(value).astype(np.int64),
        "a number": lambda: np.float64(1.0),
        "empty": lambda: np.zeros(0),
        "one axis more": lambda: value[None],
        "flat": lambda: value.ravel(),
        "transposed": lambda: value.T,
        "one row": lambda: value[:1] if value.ndim else value,
        "NaN": lambda: np.full(value.shape, np.nan),
        "infinite": lambda: np.full(value.shape, np.inf),
        "huge": lambda: np.full(value.shape, 1e308),
        "records": lambda: np.zeros(3, [("a", "f8"), ("b", "i4")]),
    }
    change = draw.choice(["dropped", "renamed", *changes])
    if change == "renamed":
        arrays[f"{name}_"] = value
    elif change != "dropped":
        arrays[name] = changes[change]()
    np.savez(path, **arrays)
    return f"array {name}: {change}"


_Damage = Callable[[random.Random, Path], str]

_ANY: tuple[_Damage, ...] = (
    *(_delete, _delete_folder, _overwrite, _overwrite, _overwrite, _stray, *(spoil,) * 8, *(_flip,) * 3),
)

_DAMAGES: dict[str, tuple[_Damage, ...]] = {
    ".json": (edit_json,) * 8 + (_nest, _whole),
    ".parquet": (edit_table,) * 4,
    ".npz": (edit_arrays,) * 4,
}
"""Damages by suffix, beside those that any file can have."""
