"""Damaged, foreign and unwritable caches of programs: the bytes of any other run, and no entry runs code."""

import functools
import os
import pickle
import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from typing_extensions import override

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import ChildResult, run, scratch
from benchmarks.campaign.spoil import spoil
from benchmarks.campaign.workloads import ROOT, WORKLOADS, fault_in, finished

_WORKLOADS = ("tabular", "planning", "learner")
_OTHER_USER = 12345
_IS_OF_ENGINE = re.compile(r"_[0-9a-f]{16}-")
"""In the name of an entry: the tag of a group of runs."""


class _Planted:
    """A pickle that leaves a file where it is loaded."""

    @override
    def __reduce__(self):
        return os.mkdir, ("planted",)


def check(seed: int) -> Outcome:
    """Damage entries of a warm cache, or the right to use it, then run with it."""
    draw = random.Random(f"caches {seed}")
    name = draw.choice(_WORKLOADS)
    with scratch() as place:
        cache, kept = _warm(name)
        if cache.is_file():  # an earlier case has put it there
            cache.unlink()
        shutil.rmtree(cache, ignore_errors=True)
        shutil.copytree(kept, cache)  # at its own place: JAX's keys contain the path
        tried = f"{name}: {_spoil(draw, cache)}"
        ended = _run(name, cache, place)
        fault = fault_of(ended, (0,)) or fault_in(place / "out", name)
        if (place / "planted").exists() or (place / "out" / "planted").exists():
            fault = "an entry has run code"
        return Outcome(tried, fault)


@functools.cache
def _warm(name: str) -> tuple[Path, Path]:
    """The cache of a workload, and a copy of it."""
    finished(name)
    cache = ROOT / ".pytest_cache" / f"campaign-{os.getpid()}" / name
    with scratch() as place:
        ended = _run(name, cache, place)
        assert ended.code == 0, ended.err
    kept = cache.with_name(f"{name}-kept")
    shutil.copytree(cache, kept)
    return cache, kept


def _run(name: str, cache: Path, place: Path) -> ChildResult:
    def start() -> int:
        os.environ["BOJAX_CACHE"] = str(cache)
        return WORKLOADS[name].start(place / "out")()

    return run(start, place, seconds=180.0)


def _spoil(draw: random.Random, cache: Path) -> str:
    if draw.random() < 0.3:
        how = draw.choice(sorted(_FOLDERS))
        _FOLDERS[how](cache)
        return f"the folder {how}"
    done = []
    for _ in range(draw.choice([1, 1, 3, 20])):
        entries = sorted(path for path in cache.rglob("*") if path.is_file() and not path.is_symlink())
        if entries:
            path = draw.choice(entries)
            done.append(f"{path.name[:24]} {_spoil_entry(draw, path, draw.choice(entries))}")
    return "; ".join(done[:3])


def _spoil_entry(draw: random.Random, path: Path, other: Path) -> str:
    how = draw.choice(["a pickle", "another entry", *["spoilt"] * 8])
    if how == "a pickle":
        path.write_bytes(pickle.dumps(_Planted()))
    elif how == "another entry" and _IS_OF_ENGINE.search(path.name):
        path.write_bytes(other.read_bytes())
    else:  # of its small programs JAX itself does not verify the name
        return spoil(draw, path)
    return how


def _of_another_user(cache: Path) -> None:
    if os.geteuid() == 0:
        os.chown(cache, _OTHER_USER, _OTHER_USER)


def _to_file(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.write_text("a file")


_FOLDERS: dict[str, Callable[[Path], object]] = {
    "deleted": lambda cache: shutil.rmtree(cache),
    "a file": lambda cache: _to_file(cache),
    "open to all": lambda cache: cache.chmod(0o777),
    "read only": lambda cache: cache.chmod(0o555),
    "of another user": _of_another_user,
    "without programs": lambda cache: shutil.rmtree(cache / "programs"),
    "with programs a file": lambda cache: _to_file(cache / "programs"),
}
