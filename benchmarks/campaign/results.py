"""Finished folders, damaged, and given to `report` and `render`: one line, or a page; never a traceback."""

import json
import random
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.campaign.case import Outcome, fault_of, is_whole
from benchmarks.campaign.damage import damage, edit_arrays, edit_json, edit_table
from benchmarks.campaign.process import cli, run, scratch
from benchmarks.campaign.workloads import finished

_WORKLOADS = ("tabular", "planning", "monitoring", "learner", "variants")

_REFUSED = re.compile(r"(\w+\.parquet): (column|flipped|emptied|noise|lengthened|overwritten|swapped)")
"""Damage of a table, of which no page may be built: its checksum is in the manifest."""


def check(seed: int) -> Outcome:
    """Damage a copy of a finished folder, then ask for its report or a picture of a run."""
    draw = random.Random(f"results {seed}")
    name = draw.choice(_WORKLOADS)
    with scratch() as place:
        folder = place / "out"
        shutil.copytree(finished(name), folder, symlinks=True)
        (folder / "report.html").unlink()
        done = [_edit(draw, folder) for _ in range(draw.choice([1, 1, 1, 2]))]
        is_report = draw.random() < 0.7 or not list(folder.glob("arrays/*"))
        words = ["report", "out"] if is_report else ["render", "out", "--still", "still.png"]
        ended = run(lambda: cli(*words), place)
        tried = f"{words[0]} of {name}: {'; '.join(done)}"
        # A second edit may have deleted the table.
        is_damaged = any((folder / found[1]).exists() for found in _REFUSED.finditer(tried))
        if ended.code == 0 and is_report and is_damaged:
            return Outcome(tried, "a page is built of it")
        fault = fault_of(ended, (0, 1, 2))
        return Outcome(tried, fault or (_page(folder) if is_report and not ended.code else ""))


def _edit(draw: random.Random, folder: Path) -> str:
    kind = draw.choice(["table", "table", "table", "manifest", "manifest", "manifest", "arrays", "any"])
    if kind == "any":
        return damage(draw, folder)
    if kind == "manifest":
        path = folder / "manifest.json"
        return f"{path.name}: {edit_json(draw, path) if path.is_file() else 'gone'}"
    files = sorted(folder.glob("*.parquet" if kind == "table" else "arrays/*.npz"))
    files = [path for path in files if path.is_file()]
    if not files:
        return damage(draw, folder)
    path = draw.choice(files)
    if kind == "arrays":
        return f"{path.name}: {edit_arrays(draw, path)}"
    return f"{path.name}: {(edit_table if draw.random() < 0.6 else _edit_numbers)(draw, path)}"


def _edit_numbers(draw: random.Random, path: Path) -> str:
    """Fill a column of numbers with ones that are hard to draw or to average."""
    table = pq.read_table(path)
    names = [field.name for field in table.schema if _is_number(field.type)]
    name = draw.choice(names)
    field = table.schema.field(name)
    is_float = pa.types.is_floating(field.type)
    changes = {"negative": -1, "zero": 0, "large": 2**30}
    if is_float:
        changes |= {"NaN": np.nan, "infinite": np.inf, "minus infinite": -np.inf}
        changes |= {"huge": 1e308, "tiny": 5e-324}
    change = draw.choice(sorted(changes))
    values = np.full(table.num_rows, changes[change], dtype=field.type.to_pandas_dtype())
    if draw.random() < 0.3 and is_float:
        values[::2] *= -1
        change += " of both signs"
    table = table.set_column(table.column_names.index(name), field, pa.array(values, field.type))
    pq.write_table(table, path)
    return f"column {name}: {change}"


def _is_number(kind: pa.DataType) -> bool:
    return pa.types.is_floating(kind) or pa.types.is_integer(kind)


def _page(folder: Path) -> str:
    """What is wrong with the page that was built; empty if nothing is."""
    if not is_whole(folder / "report.html"):
        return "exit code 0, and no whole page"
    claims = json.loads((folder / "claims.json").read_text())
    return "" if isinstance(claims, list) else "claims.json is no list"
