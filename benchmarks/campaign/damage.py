"""Interrupted folders with one thing damaged: a resumed one ends in the right bytes, or in one line."""

import json
import os
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
from benchmarks.campaign.process import scratch
from benchmarks.campaign.workloads import contents, difference, finished, interrupted, merged, resume

_WORKLOADS = (("toy", 12), ("toy", 30), ("tabular", 12), ("learner", 3), ("monitoring", 6))
"""Workloads, with the number of parts at which they were interrupted."""


def check(seed: int) -> Outcome:
    """Damage one thing in a copy of an interrupted folder, then resume it."""
    draw = random.Random(f"damage {seed}")
    name, parts = draw.choice(_WORKLOADS)
    original, wanted = interrupted(name, parts), contents(finished(name))
    with scratch() as place:
        out = place / "out"
        shutil.copytree(original, out, symlinks=True)
        tried = f"{name}: {damage(draw, out)}"
        ended = resume(name, out, place)
        if ended.code == 0 or ended.is_late:
            return Outcome(tried, fault_of(ended, (0,)) or difference(contents(out), wanted))
        if fault := fault_of(ended, (1, 2)):
            return Outcome(tried, fault)
        if tables := merged(out):
            return Outcome(tried, f"refused, and yet there is {', '.join(tables)}")
        advice = re.search(r"delete the folder (\S+\.work/chunk-[^/\s]+) and resume", ended.err)
        if not advice or draw.random() < 0.5:
            return Outcome(tried)
        shutil.rmtree(place / advice[1])
        ended = resume(name, out, place)
        fault = fault_of(ended, (0,)) or difference(contents(out), wanted)
        return Outcome(tried, f"as advised, deleted {Path(advice[1]).name}: {fault}" if fault else "")


def damage(draw: random.Random, folder: Path) -> str:
    """Damage one file or folder below `folder`; says what was done."""
    victim = _victim(draw, folder)
    options = [*_ANY, *_DAMAGES.get(victim.suffix, ())]
    damage = draw.choice(options)
    shown = victim.relative_to(folder)
    done = damage(draw, victim)
    return f"{shown}: {done}"


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


def _truncate(draw: random.Random, path: Path) -> str:
    length = draw.choice([0, draw.randrange(path.stat().st_size + 1)])
    os.truncate(path, length)
    return f"truncated to {length} bytes"


def _flip(draw: random.Random, path: Path) -> str:
    content = bytearray(path.read_bytes() or b"\0")
    index = draw.randrange(len(content))
    content[index] ^= 1 << draw.randrange(8)
    path.write_bytes(content)
    return f"a bit of byte {index} flipped"


def _zero(draw: random.Random, path: Path) -> str:
    content = bytearray(path.read_bytes() or b"\0")
    start = draw.randrange(len(content))
    stop = min(len(content), start + draw.choice([1, 16, 512, 4096]))
    content[start:stop] = bytes(stop - start)
    path.write_bytes(content)
    return f"bytes {start} to {stop} zeroed"


def _garbage(draw: random.Random, path: Path) -> str:
    path.write_bytes(draw.randbytes(path.stat().st_size or 1))
    return "replaced by random bytes"


def _append(draw: random.Random, path: Path) -> str:
    with path.open("ab") as file:
        file.write(draw.randbytes(draw.choice([1, 100])))
    return "bytes appended"


def _overwrite(draw: random.Random, path: Path) -> str:
    others = [other for other in sorted(path.parent.iterdir()) if other.is_file() and other != path]
    if not others:
        return _delete(draw, path)
    alike = [other for other in others if other.suffix == path.suffix] or others
    other = draw.choice(alike if draw.random() < 0.8 else others)
    shutil.copyfile(other, path)
    return f"overwritten by {other.name}"


def _swap(draw: random.Random, path: Path) -> str:
    others = [p for p in sorted(path.parent.iterdir()) if p.suffix == path.suffix and p != path]
    others = [other for other in others if other.is_file()]
    if not others:
        return _flip(draw, path)
    other, spare = draw.choice(others), path.with_name("spare")
    path.rename(spare)
    other.rename(path)
    spare.rename(other)
    return f"swapped with {other.name}"


def _to_folder(draw: random.Random, path: Path) -> str:
    path.unlink()
    path.mkdir()
    return "replaced by a folder"


def _to_link(draw: random.Random, path: Path) -> str:
    path.unlink()
    target = draw.choice(["/nonexistent", path.name, "/dev/null", "/"])
    path.symlink_to(target)
    return f"replaced by a link to {target}"


def _to_fifo(draw: random.Random, path: Path) -> str:
    path.unlink()
    os.mkfifo(path)
    return "replaced by a FIFO"


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
    places = list(_places(tree))
    where, parent, key = draw.choice(places) if places else ("", [tree], 0)
    change = draw.choice(["value", "value", "value", "type", "delete", "add"])
    if change == "delete":
        del parent[key]
    elif change == "add" and isinstance(parent, dict):
        parent[draw.choice(["surprise", "", "parts "])] = draw.choice(ODD_JSON)
    elif change == "type":
        parent[key] = _other(parent[key])
    else:
        parent[key] = draw.choice(ODD_JSON)
    path.write_text(json.dumps(tree))
    shown = "" if change == "delete" or not where else f", now {json.dumps(_at(tree, where))[:40]}"
    return f"entry {'.'.join(map(str, where)) or 'all'}: {change}{shown}"


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


def _places(tree: Any, path: tuple = ()):
    """Every entry of a tree, as its path, what holds it, and its key there."""
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in entries:
        yield (*path, key), tree, key
        yield from _places(value, (*path, key))


def _at(tree: Any, path: tuple) -> Any:
    for key in path:
        tree = tree[key]
    return tree


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
    value = arrays[name]
    changes: dict[str, Callable[[], Any]] = {
        "dropped": lambda: None,
        "renamed": lambda: None,
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
    change = draw.choice(sorted(changes))
    if change in ("dropped", "renamed"):
        arrays[f"{name}_"] = arrays.pop(name)
        if change == "dropped":
            del arrays[f"{name}_"]
    else:
        arrays[name] = changes[change]()
    np.savez(path, **arrays)
    return f"array {name}: {change}"


_Damage = Callable[[random.Random, Path], str]

_ANY: tuple[_Damage, ...] = (
    *(_delete, _delete_folder, _truncate, _truncate, _flip, _flip, _flip, _zero, _garbage, _append),
    *(_overwrite, _overwrite, _swap, _to_folder, _to_link, _to_fifo, _stray),
)

_DAMAGES: dict[str, tuple[_Damage, ...]] = {
    ".json": (edit_json,) * 8 + (_nest, _whole),
    ".parquet": (edit_table,) * 4,
    ".npz": (edit_arrays,) * 4,
}
"""Damages by suffix, beside those that any file can have."""
