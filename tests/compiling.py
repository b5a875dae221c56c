"""How tests compile: quickly on a CPU, where programs run for milliseconds; with equal bits on a GPU.

With `BOJAX_TESTS=release`, XLA's own defaults are used, as by a sweep.
"""

import contextlib
import importlib.metadata
import itertools
import os
import threading

IS_CPU = os.environ.get("JAX_PLATFORMS", "cpu") == "cpu"

REPEATABLY = {} if IS_CPU else {"xla_gpu_deterministic_ops": True}
"""A GPU adds the forces of contacts in any order: the last bits of a wheeled robot differ every time."""

COMPILATION = "/jax/core/compile/backend_compile_duration"
"""What JAX calls the time of a compilation."""

OPTIMISED = {"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}
"""For programs that run for seconds: `quick_flags` make a search of 1,000 iterations ten times slower."""
if not IS_CPU:
    OPTIMISED = {}


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


@contextlib.contextmanager
def as_for_a_gpu(monkeypatch):
    """Context in which programs are traced and lowered for a GPU: Triton asks for its kind."""
    import jax

    rules = importlib.import_module("jax._src.pallas.triton.lowering").triton_lowering_rules
    select = rules[jax.lax.select_n_p]

    def checked(context, which, *cases):
        # JAX gives weakly typed constants, as in `jnp.where(x > 0.0, 0.1, 0.2)`, the type of the condition
        typed = zip(cases, context.avals_in[1:], strict=True)
        assert not any(aval.weak_type and not hasattr(case, "type") for case, aval in typed)
        return select(context, which, *cases)

    monkeypatch.setitem(rules, jax.lax.select_n_p, checked)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    gpu = jax.sharding.AbstractDevice(device_kind="NVIDIA H200", num_cores=132, platform="gpu")
    with jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), (), abstract_device=gpu)):
        yield


_PROGRAMS_PER_CONTEXT = 200
"""A context keeps every constant and type that its programs name, until it is dropped."""


@contextlib.contextmanager
def events_of_jax():
    """Context that lists the names of what JAX times, such as each compilation."""
    # Imported here: the flags must be set before JAX is imported.
    import jax.monitoring

    events = []

    def note(name, *_, **__):
        events.append(name)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        yield events
    finally:
        jax.monitoring.unregister_event_duration_listener(note)  # there are others


def share_lowering_contexts() -> None:
    """Lower consecutive programs of a thread in one MLIR context.

    JAX makes a context for each program, which takes longer than to trace, lower and compile a small one. The
    programs are the same. What JAX calls for a context is private: where a version has another name for it,
    nothing is shared.
    """
    from jax._src.interpreters import mlir

    make = getattr(mlir, "make_ir_context", None)
    if make is None:
        return
    own = threading.local()

    def context():
        if not hasattr(own, "count"):
            own.count = itertools.count()
        if next(own.count) % _PROGRAMS_PER_CONTEXT == 0:
            own.context = make()
        return own.context

    mlir.make_ir_context = context
