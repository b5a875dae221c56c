"""Run a benchmark in a process of its own, whose threads find no cores but those meant for it."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]


def run_isolated(script: Path, argv: Sequence[str], device: str, cores: int) -> int:
    """Run `script` with `argv`; on a CPU it sees `cores` cores, set before JAX and BLAS start.

    Args:
        script: A Python file.
        argv: Its arguments.
        device: `auto`, `cpu` or `gpu`.
        cores: Cores on a CPU. On a GPU the host keeps all of them, for the compiler.

    Returns:
        The exit code; 2 if there is no such device or there are too few cores.
    """
    env = dict(os.environ)
    env["PYTHONPATH"] = os.pathsep.join(filter(None, [str(REPOSITORY), env.get("PYTHONPATH")]))
    for library in ("OPENBLAS", "OMP", "MKL"):
        env[f"{library}_NUM_THREADS"] = "1"  # the matrices here are small: more threads are slower
    if device == "cpu":
        env["JAX_PLATFORMS"] = "cpu"
    platform = "cpu" if device == "cpu" else _platform(env)
    if device == "gpu" and platform != "gpu":
        return _refuse(f"--device gpu: JAX finds no GPU here, only: {platform}")
    command = [sys.executable, str(script), *argv]
    if platform != "cpu" or not hasattr(os, "sched_setaffinity"):
        return subprocess.run(command, env=env, check=False).returncode
    usable = os.sched_getaffinity(0)
    if cores > len(usable):
        return _refuse(f"--cores {cores}: this process may use {len(usable)}")
    env["JAX_NUM_CPU_DEVICES"] = str(cores)
    os.sched_setaffinity(0, sorted(usable)[-cores:])  # a child inherits it
    try:
        return subprocess.run(command, env=env, check=False).returncode
    finally:
        os.sched_setaffinity(0, usable)


def describe_cores() -> str:
    """How many cores this process has, as the operating system says."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return f"{count} core{'' if count == 1 else 's'}"


def _platform(env: dict[str, str]) -> str:
    """JAX's platform, asked in a process that ends: whoever looks at a GPU takes its memory."""
    code = "import jax; print(jax.default_backend())"
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    return done.stdout.split()[-1]


def _refuse(message: str) -> int:
    print(f"error: {message}", file=sys.stderr)
    return 2
