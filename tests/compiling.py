"""How tests compile: quickly on a CPU, where programs run for milliseconds; with equal bits on a GPU."""

import jax

_IS_CPU = jax.default_backend() == "cpu"

REPEATABLY = {} if _IS_CPU else {"xla_gpu_deterministic_ops": True}
"""A GPU adds the forces of contacts in any order: the last bits of a wheeled robot differ every time."""

QUICKLY = dict(REPEATABLY)
if _IS_CPU:
    QUICKLY |= {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
    if jax.__version_info__ < (0, 11):  # which does not know it any more
        QUICKLY["xla_cpu_use_fusion_emitters"] = False
