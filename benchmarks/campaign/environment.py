"""Environment variables of users: a run ends with the bytes of any other, or in one line before it begins."""

import functools
import os
import random
from pathlib import Path

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import Ended, run, scratch
from benchmarks.campaign.workloads import WORKLOADS, contents, difference

VARIABLES = (
    *(
        ("MPLBACKEND", value)
        for value in ("module://matplotlib_inline.backend_inline", "TkAgg", "nonsense", "")
    ),
    *(("MATPLOTLIBRC", value) for value in ("missing", "here", "/dev/null")),
    *(("PYTHONWARNINGS", value) for value in ("error", "error::DeprecationWarning", "ignore")),
    *(("PYTHONOPTIMIZE", value) for value in ("1", "2")),
    *(
        ("PYTHONHASHSEED", "7"),
        ("PYTHONDONTWRITEBYTECODE", "1"),
        ("PYTHONUTF8", "0"),
        ("PYTHONIOENCODING", "ascii"),
    ),
    *(("TERM", value) for value in ("dumb", "", "unknown")),
    *(("COLUMNS", value) for value in ("1", "0", "-3", "x", "100000")),
    *(("NO_COLOR", "1"), ("FORCE_COLOR", "1"), ("CLICOLOR_FORCE", "1"), ("TTY_COMPATIBLE", "1")),
    *((name, value) for name in ("LC_ALL", "LANG") for value in ("C", "POSIX", "tr_TR.UTF-8", "nonsense")),
    *(("TZ", value) for value in ("Pacific/Kiritimati", "nonsense", ":/dev/null")),
    *(("HOME", value) for value in ("/nonexistent", "", "/dev/null")),
    *(("XDG_CACHE_HOME", value) for value in ("/nonexistent/a", "/proc", "relative")),
    *(("TMPDIR", value) for value in ("/nonexistent", "/dev/null")),
    *(("JAX_ENABLE_X64", value) for value in ("0", "1")),
    *(("JAX_DISABLE_JIT", value) for value in ("0", "1")),
    *(("JAX_DEBUG_NANS", "1"), ("JAX_LOG_COMPILES", "1"), ("JAX_TRACEBACK_FILTERING", "off")),
    *(("JAX_PLATFORMS", value) for value in ("cpu", "nonsense", "cuda")),
    *(("JAX_DEFAULT_PRNG_IMPL", "rbg"), ("JAX_THREEFRY_PARTITIONABLE", "0"), ("JAX_RANDOM_SEED_OFFSET", "5")),
    *(
        ("JAX_NUMPY_DTYPE_PROMOTION", "strict"),
        ("JAX_NUMPY_RANK_PROMOTION", "raise"),
        ("JAX_ENABLE_CHECKS", "1"),
    ),
    *(("JAX_COMPILATION_CACHE_DIR", value) for value in ("cache", "/proc/nothing")),
    *(("JAX_ENABLE_COMPILATION_CACHE", "0"), ("JAX_TRANSFER_GUARD", "disallow")),
    *(("OMP_NUM_THREADS", value) for value in ("0", "x", "1000")),
    *(
        ("XLA_FLAGS", value)
        for value in ("--xla_force_host_platform_device_count=3", "--xla_cpu_enable_fast_math=false")
    ),
    *(
        ("NPY_DISABLE_CPU_FEATURES", "AVX512F"),
        ("ARROW_DEFAULT_MEMORY_POOL", "system"),
        ("PYTHONFAULTHANDLER", "1"),
    ),
)
"""Names and values; `here` is a file that is no style of Matplotlib."""

_UNSET = ("BOJAX_CACHE", "JAX_PLATFORMS", "MPLBACKEND")
_WORKLOAD = WORKLOADS["tabular"]


def check(seed: int) -> Outcome:
    """Run a workload in a new process with one or two variables set."""
    draw = random.Random(f"environment {seed}")
    chosen = dict(draw.sample(VARIABLES, draw.choice([1, 1, 1, 2])))
    with scratch() as place:
        (place / "here").write_bytes(b"\xff\xfe: broken\n")
        ended = _run(
            place, {name: str(place / value) if value == "here" else value for name, value in chosen.items()}
        )
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


def _run(place: Path, variables: dict[str, str]) -> Ended:
    def start() -> int:
        for name in _UNSET:
            os.environ.pop(name, None)
        os.environ.update({"JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(_cache()), **variables})
        return _WORKLOAD.start_afresh(place / "out")()

    return run(start, place, seconds=180.0)


def _cache() -> Path:
    """A cache of compiled programs that all cases share."""
    return Path(__file__).parents[2] / ".pytest_cache" / "campaign"
