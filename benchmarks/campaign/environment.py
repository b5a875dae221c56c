"""Environment variables of users: a run ends with the bytes of any other, or in one line before it begins."""

import functools
import os
import random
from pathlib import Path

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import ChildResult, run, scratch
from benchmarks.campaign.workloads import ROOT, WORKLOADS, contents, difference

_VARIABLES = """
    MPLBACKEND=module://matplotlib_inline.backend_inline,TkAgg,nonsense, MATPLOTLIBRC=missing,here,/dev/null
    PYTHONWARNINGS=error,error::DeprecationWarning,ignore PYTHONOPTIMIZE=1,2 PYTHONHASHSEED=7
    PYTHONDONTWRITEBYTECODE=1 PYTHONUTF8=0 PYTHONIOENCODING=ascii PYTHONFAULTHANDLER=1
    TERM=dumb,,unknown COLUMNS=1,0,-3,x,100000 NO_COLOR=1 FORCE_COLOR=1 CLICOLOR_FORCE=1 TTY_COMPATIBLE=1
    LC_ALL=C,POSIX,tr_TR.UTF-8,nonsense LANG=C,POSIX,tr_TR.UTF-8,nonsense
    TZ=Pacific/Kiritimati,nonsense,:/dev/null HOME=/nonexistent,,/dev/null TMPDIR=/nonexistent,/dev/null
    XDG_CACHE_HOME=/nonexistent/a,/proc,relative
    JAX_ENABLE_X64=0,1 JAX_DISABLE_JIT=0,1 JAX_DEBUG_NANS=1 JAX_LOG_COMPILES=1 JAX_TRACEBACK_FILTERING=off
    JAX_PLATFORMS=cpu,nonsense,cuda JAX_DEFAULT_PRNG_IMPL=rbg JAX_THREEFRY_PARTITIONABLE=0
    JAX_RANDOM_SEED_OFFSET=5 JAX_NUMPY_DTYPE_PROMOTION=strict JAX_NUMPY_RANK_PROMOTION=raise
    JAX_ENABLE_CHECKS=1 JAX_COMPILATION_CACHE_DIR=cache,/proc/nothing JAX_ENABLE_COMPILATION_CACHE=0
    JAX_TRANSFER_GUARD=disallow OMP_NUM_THREADS=0,x,1000 NPY_DISABLE_CPU_FEATURES=AVX512F
    XLA_FLAGS=--xla_force_host_platform_device_count=3,--xla_cpu_enable_fast_math=false
    ARROW_DEFAULT_MEMORY_POOL=system
"""
"""Names, each with its values; `here` is a file that is no style of Matplotlib."""

_SETTINGS = tuple(
    (name, value)
    for name, _, values in (word.partition("=") for word in _VARIABLES.split())
    for value in values.split(",")
)

_UNSET = ("BOJAX_CACHE", "JAX_PLATFORMS", "MPLBACKEND")
_WORKLOAD = WORKLOADS["tabular"]
_CACHE = ROOT / ".pytest_cache" / "campaign"
"""A cache of compiled programs that all cases share."""


def check(seed: int) -> Outcome:
    """Run a workload in a new process with one or two variables set."""
    draw = random.Random(f"environment {seed}")
    chosen = dict(draw.sample(_SETTINGS, draw.choice([1, 1, 1, 2])))
    with scratch() as place:
        (place / "here").write_bytes(b"\xff\xfe: broken\n")
        here = {"here": str(place / "here")}
        ended = _run(place, {name: here.get(value, value) for name, value in chosen.items()})
        tried = " ".join(f"{name}={value!r}" for name, value in chosen.items())
        if fault := fault_of(ended, (0, 1, 2)):
            return Outcome(tried, fault)
        if ended.code:
            written = sorted(path.name for path in place.rglob("*.parquet"))
            return Outcome(tried, f"exit code {ended.code}, and {written} written" if written else "")
        if not (place / "out" / "report.html").is_file():
            return Outcome(tried, "no report")
        return Outcome(tried, difference(contents(place / "out"), _wanted()))


@functools.cache
def _wanted() -> dict[str, bytes]:
    with scratch() as place:
        ended = _run(place, {})
        assert ended.code == 0, ended.err
        return contents(place / "out")


def _run(place: Path, variables: dict[str, str]) -> ChildResult:
    def start() -> int:
        for name in _UNSET:
            os.environ.pop(name, None)
        os.environ.update({"JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(_CACHE), **variables})
        return _WORKLOAD.start_afresh(place / "out")()

    return run(start, place, seconds=180.0)
