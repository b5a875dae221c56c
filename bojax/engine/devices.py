"""Every decision about devices: which ones, how many on a CPU, precision, compile cache, lanes.

`prepare` has to run before JAX starts a backend; it is where the process-wide flags of JAX are set.
"""

import os
from pathlib import Path
from typing import Any, Literal, TypeAlias

import jax
import numpy as np
from jax.sharding import AxisType, Mesh

from bojax.engine.errors import EngineError

Device: TypeAlias = Any
"""A JAX device: `jax.Device` is a variable to a type checker."""

DEVICES = "devices"
"""Name of the mesh axis over devices."""

LANES_ON_ACCELERATOR = 4096
"""Most lanes per device where the config says nothing. On a CPU the experiment says how many are fast."""


def prepare(device: Literal["auto", "cpu", "gpu"]) -> None:
    """Set JAX's process-wide flags: platform, CPU devices, float64, persistent compilation cache.

    XLA runs a vmapped loop on one core, so that a CPU counts as one device per usable core. A flag that
    the user has set, in the environment or in JAX's configuration, is left alone.
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
    """All devices of the platform asked for; `auto` takes GPUs where there are any.

    Raises:
        EngineError: no GPU where one was asked for.
    """
    if device == "auto":
        return jax.devices()
    try:
        return jax.devices(device)
    except RuntimeError:
        raise EngineError(
            f"engine.device: {device}: JAX finds no {device} here, only {jax.default_backend()}: "
            "use engine.device=auto, or run `bojax doctor`"
        ) from None


def make_mesh(devices: list[Device]) -> Mesh:
    """A one-dimensional mesh of devices; no program of the engine communicates across it."""
    return Mesh(np.array(devices), (DEVICES,), axis_types=(AxisType.Auto,))


def choose_lanes(num_lanes: int, num_devices: int, limit: int, given: int | None) -> int:
    """Lanes per device for a group of `num_lanes`.

    Where the config gives none: the fewest that need no more chunks than `limit` lanes do, which keeps
    padding small.
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
    """Folder of the persistent compilation cache: `BOJAX_CACHE`, else under the user's cache folder."""
    if given := os.environ.get("BOJAX_CACHE"):
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "bojax" / "jax"


def setting(flag: str) -> Any:
    """The value of one of JAX's flags."""
    return getattr(jax.config, flag)


def _update_before_start(flag: str, value: object) -> None:
    """Set a flag that JAX refuses once a backend runs: then whoever started it has made the choice."""
    try:
        jax.config.update(flag, value)
    except RuntimeError:
        pass
