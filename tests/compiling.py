"""How tests compile: their programs run for milliseconds and would be compiled for half a minute."""

import jax

QUICKLY = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}

if jax.__version_info__ < (0, 11):  # which does not know it any more
    QUICKLY["xla_cpu_use_fusion_emitters"] = False
