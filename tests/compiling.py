"""How tests compile: quickly on a CPU, where programs run for milliseconds; with equal bits on a GPU.

With `BOJAX_TESTS=release`, XLA's own defaults are used, as by a sweep.
"""

import importlib.metadata
import os

IS_CPU = os.environ.get("JAX_PLATFORMS", "cpu") == "cpu"

REPEATABLY = {} if IS_CPU else {"xla_gpu_deterministic_ops": True}
"""A GPU adds the forces of contacts in any order: the last bits of a wheeled robot differ every time."""


def quick_flags() -> list[str]:
    """Flags for `XLA_FLAGS` with which programs compile in a third of the time and run slower."""
    if os.environ.get("BOJAX_TESTS") == "release" or not IS_CPU:
        return []
    flags = [
        "--xla_backend_optimization_level=0",
        "--xla_llvm_disable_expensive_passes=true",
        "--xla_cpu_parallel_codegen_split_count=1",
    ]
    if tuple(map(int, importlib.metadata.version("jax").split(".")[:2])) < (0, 11):  # later ones refuse it
        flags.append("--xla_cpu_use_fusion_emitters=false")
    return flags
