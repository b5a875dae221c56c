"""JAX's strict settings for tests, and for processes that tests start; these inherit the environment."""

import os

import jax

from tests.compiling import share_lowering_contexts

STRICT = {
    "jax_enable_x64": True,
    "jax_numpy_dtype_promotion": "strict",
    "jax_numpy_rank_promotion": "raise",
    "jax_debug_key_reuse": True,
    "jax_num_cpu_devices": 2,
    "jax_compilation_cache_dir": os.environ["BOJAX_CACHE"],
    "jax_persistent_cache_min_compile_time_secs": 0.3,  # to write others takes longer than to compile them
}

for _flag, _value in STRICT.items():
    jax.config.update(_flag, _value)

share_lowering_contexts()
