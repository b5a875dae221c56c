"""Run a benchmark in a process of its own, restricted to a number of cores."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]


def run_isolated(script: Path, argv: Sequence[str], device: str, cores: int) -> int:
    """Run `script` with `argv`; on a CPU, restrict it to `cores` cores before JAX and BLAS start.

    Args:
        script: A Python file.
        argv: Arguments of the script.
        device: `auto`, `cpu` or `gpu`.
        cores: Number of cores on a CPU. With a GPU the host keeps all cores, for the compiler.

    Returns:
        The exit code; 2 if there is no such device or there are too few cores.
    """
    env = dict(os.environ)
    env["PYTHONPATH"] = os.pathsep.join(filter(None, [str(REPOSITORY), env.get("PYTHONPATH")]))
    for library in ("OPENBLAS", "OMP", "MKL"):
        env[f"{library}_NUM_THREADS"] = "1"  # more threads are slower for small matrices
    if device == "cpu":
        env["JAX_PLATFORMS"] = "cpu"
    platform = "cpu" if device == "cpu" else _platform(env)
    if device == "gpu" and platform != "gpu":
        return _refuse(f"--device: got gpu; JAX finds only {platform} devices")
    command = [sys.executable, str(script), *argv]
    if platform != "cpu" or not hasattr(os, "sched_setaffinity"):
        return subprocess.run(command, env=env, check=False).returncode
    usable = os.sched_getaffinity(0)
    if cores > len(usable):
        return _refuse(f"--cores: got {cores}; allowed: <= {len(usable)}, the cores of this process")
    env["JAX_NUM_CPU_DEVICES"] = str(cores)
    os.sched_setaffinity(0, sorted(usable)[-cores:])  # inherited by the child process
    try:
        return subprocess.run(command, env=env, check=False).returncode
    finally:
        os.sched_setaffinity(0, usable)


def describe_cores() -> str:
    """The number of cores that this process may use."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return f"{count} core{'' if count == 1 else 's'}"


def _platform(env: dict[str, str]) -> str:
    """JAX's platform, found in another process, since JAX reserves the memory of a GPU that it finds."""
    code = "import jax; print(jax.default_backend())"
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    return done.stdout.split()[-1]


def _refuse(message: str) -> int:
    print(f"error: {message}", file=sys.stderr)
    return 2
