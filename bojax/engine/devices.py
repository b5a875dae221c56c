"""Devices: their selection, their number on a CPU, the lanes of each, and JAX's process-wide flags.

`prepare` sets the flags and must be called before JAX starts a backend.
"""

import os
from pathlib import Path
from typing import Any, Literal, TypeAlias

import jax
import numpy as np
from jax.sharding import AxisType, Mesh

from bojax.engine.errors import EngineError

Device: TypeAlias = Any
"""A JAX device; `Any`, since type checkers take `jax.Device` for a variable."""

DEVICES = "devices"
"""Name of the mesh axis over devices."""

LANES_ON_ACCELERATOR = 4096
"""Default maximum of lanes per device of an accelerator; on a CPU it is `Experiment.lanes_on_cpu`."""


def prepare(device: Literal["auto", "cpu", "gpu"]) -> None:
    """Set JAX's process-wide flags: platform, CPU devices, float64, persistent compilation cache.

    XLA runs a vmapped loop on a single core, so a CPU is split into one device per usable core. Flags that
    the user has set, in the environment or in JAX's configuration, are left alone.
    """
    jax.config.update("jax_enable_x64", True)
    if device == "cpu" and not setting("jax_platforms"):
        _update_before_start("jax_platforms", "cpu")
    is_cpu_count_given = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if not is_cpu_count_given and setting("jax_num_cpu_devices") < 1:
        _update_before_start("jax_num_cpu_devices", usable_cores())
    if setting("jax_compilation_cache_dir") is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_folder()))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def find_devices(device: Literal["auto", "cpu", "gpu"]) -> list[Device]:
    """All devices of the requested platform; `auto` prefers GPUs.

    Raises:
        EngineError: There is no device of this platform.
    """
    if device == "auto":
        return jax.devices()
    try:
        return jax.devices(device)
    except RuntimeError:
        raise EngineError(
            f"engine.device: got {device}; JAX finds only {jax.default_backend()} devices: "
            "use engine.device=auto, or run `bojax doctor`"
        ) from None


def make_mesh(devices: list[Device]) -> Mesh:
    """A one-dimensional mesh of the devices, across which no program of the engine communicates."""
    return Mesh(np.array(devices), (DEVICES,), axis_types=(AxisType.Auto,))


def choose_lanes(num_lanes: int, num_devices: int, limit: int, given: int | None) -> int:
    """Number of lanes per device for a group of `num_lanes`.

    Returns `given` unless it is None. Otherwise, of the numbers that lead to as few chunks as `limit` does,
    returns the smallest, which keeps padding small.
    """
    if given is not None:
        return given
    num_chunks = -(-num_lanes // (limit * num_devices))
    return -(-num_lanes // (num_chunks * num_devices))


def usable_cores() -> int:
    """CPU cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cache_folder() -> Path:
    """Folder of the persistent compilation cache: `BOJAX_CACHE`, or else in the user's cache folder."""
    if given := os.environ.get("BOJAX_CACHE"):
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "bojax" / "jax"


def setting(flag: str) -> Any:
    """The value of one of JAX's flags."""
    return getattr(jax.config, flag)


def _update_before_start(flag: str, value: object) -> None:
    """Set a flag that JAX refuses to change once a backend has started; in that case it stays as it is."""
    try:
        jax.config.update(flag, value)
    except RuntimeError:
        pass
