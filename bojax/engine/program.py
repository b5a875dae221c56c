"""A program of the engine: how it is traced, saved, and compiled, with the options of XLA that suit it."""

import functools
import json
import os
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax.export import DisabledSafetyCheck, Exported
from jax.sharding import SingleDeviceSharding
from jax.stages import Compiled
from jaxtyping import PyTree

from bojax.engine.devices import Device

GAINS = GAINS_FROM_PASSES, GAINS_FROM_GRAPHS = "gains_from_passes", "gains_from_graphs"
"""Attributes of the parts of an experiment whose programs need other options than most.

With the first, a CPU gets XLA's full optimisation in place of a quicker compilation. With the second, a GPU
runs whole loops as CUDA graphs, but for programs with a loop that XLA would end too early or too late.
"""

_QUICK, _FULL = 1, 3
"""Levels of XLA's optimisation: with the first, a sixth less to compile, and most programs are not slower."""

_GRAPHS = "xla_gpu_enable_command_buffer"
_COMMANDS = "FUSION", "CUBLAS", "CUBLASLT", "CUSTOM_CALL", "CUDNN", "DYNAMIC_SLICE_FUSION"
"""What is recorded in a CUDA graph by default."""

_LOOPS = "WHILE", "CONDITIONAL"
"""What has to be recorded besides, so that a loop is one graph."""

_EARLY_STARTS = "xla_gpu_enable_pdl"
"""With this option, the default of JAX 0.11, a kernel may be put on a GPU before the one that it follows has
ended, for which it then waits (programmatic dependent launch). While four chunks ran at once on an H200, such
a kernel filled the GPU, and nothing went on: in six of six cold reproductions of the thesis. Four later ones
with the option ended, 5% earlier at most, but why the kernel stood is not known.
"""

_PALLAS = "__gpu$xla.gpu.triton", "triton_kernel_call", "mosaic_gpu_v2"
"""Custom calls without a promise across versions of JAX, which is not needed: `program_cache` tells versions
apart."""


@dataclass(frozen=True)
class Program:
    """A program of leaves, which can be compiled for any device of its platform."""

    function: Callable[..., PyTree]  # the program, a function of the leaves of its inputs
    inputs: Sequence[jax.ShapeDtypeStruct]  # shapes and dtypes of the leaves
    donated: tuple[int, ...]  # positions of the leaves whose buffers the program may overwrite
    # The traced program, which can be saved; None if it is traced when it is compiled
    exported: Exported | None = None
    gains: Collection[str] = ()  # which of `GAINS` make it faster

    @classmethod
    def of_trees(
        cls,
        function: Callable[..., PyTree],
        *inputs: PyTree,
        donated: int | None = None,
        gains: Collection[str] = (),
    ):
        """The program that applies a function of trees to leaves.

        The inputs are arrays, or their shapes and dtypes; the result consists of dictionaries, lists and
        tuples of arrays. The program may overwrite the buffers of the input of index `donated`.
        """
        leaves, structure = jax.tree.flatten(inputs)

        def of_leaves(*leaves):
            return function(*jax.tree.unflatten(structure, leaves))

        first = 0 if donated is None else len(jax.tree.leaves(inputs[:donated]))
        count = 0 if donated is None else len(jax.tree.leaves(inputs[donated]))
        at = tuple(range(first, first + count))
        return cls(of_leaves, [abstract(leaf) for leaf in leaves], at, None, tuple(gains))

    @classmethod
    def of_export(cls, exported: Exported, donated: Sequence[int], gains: Collection[str]):
        """The program that was exported."""
        inputs = [abstract(aval) for aval in exported.in_avals]
        return cls(exported.call, inputs, tuple(donated), exported, tuple(gains))

    @classmethod
    def deserialized(cls, content: bytes):
        """The program of `serialized`; runs no code."""
        header, _, exported = content.partition(b"\n")
        return cls.of_export(jax.export.deserialize(bytearray(exported)), *json.loads(header))

    def serialized(self) -> bytes:
        """The exported program as bytes."""
        assert self.exported is not None
        return json.dumps([self.donated, self.gains]).encode() + b"\n" + self.exported.serialize()

    def export(self, device: Device) -> "Program":
        """Trace the program for the platform of a device."""
        checks = [DisabledSafetyCheck.custom_call(name) for name in _PALLAS]
        make = jax.export.export(
            jax.jit(self.function), platforms=[_platform_of(device)], disabled_checks=checks
        )
        return Program.of_export(make(*self.inputs), self.donated, self.gains)

    def compile(self, name: str, device: Device, **options: Any) -> Compiled:
        """Compile the program for a device, or load it from JAX's cache, where `name` begins its file."""
        if device.platform == "cpu":
            initialize_lapack()
        options = _options(device, self.gains) | options

        def call(*leaves):
            return self.function(*leaves)

        call.__name__ = name  # `program_cache.compiled` finds the entry in JAX's cache by this name
        sharding = SingleDeviceSharding(device)
        inputs = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding) for leaf in self.inputs]
        lowered = jax.jit(call, donate_argnums=self.donated, out_shardings=sharding).lower(*inputs)
        compiled = lowered.compile(options or None)
        # An option of the user may record loops, too.
        records_loops = _LOOPS[0] in options.get(_GRAPHS, os.environ.get("XLA_FLAGS", ""))
        if records_loops and _has_bare_condition(compiled.as_text()):
            return lowered.compile({**options, _GRAPHS: ",".join(_COMMANDS)})
        return compiled


def _options(device: Device, gains: Collection[str]) -> dict[str, Any]:
    """Options of XLA's compiler for a program on a device, without those that the user has set."""
    options = {}
    if device.platform == "cpu":
        level = _FULL if GAINS_FROM_PASSES in gains else _QUICK
        options = {"xla_backend_optimization_level": level, "xla_llvm_disable_expensive_passes": True}
    elif _platform_of(device) == "cuda":
        options[_EARLY_STARTS] = False
        if GAINS_FROM_GRAPHS in gains:
            options[_GRAPHS] = ",".join((*_COMMANDS, *_LOOPS))
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}


def _platform_of(device: Device) -> str:
    """The platform of a device, as JAX's exporter names it."""
    if device.platform != "gpu":
        return device.platform
    return "rocm" if "rocm" in device.client.platform_version.lower() else "cuda"


def _has_bare_condition(text: str | None) -> bool:
    """Whether the condition of some loop only returns a flag of the loop's carry; True without a text.

    As a CUDA graph, such a loop ends too early or too late. A kernel of XLA (of JAX 0.11.2) reads the
    condition, and waits for the kernels of the condition only. If the body has computed it, as `any_lane` of
    a single lane, there are none, and the kernel reads what was there before.
    """
    if text is None:
        return True
    bodies = dict(_COMPUTATION.findall(text))
    conditions = set(_CONDITION.findall(text))
    return any(_KERNELS.isdisjoint(_OPERATION.findall(bodies.get(name, ""))) for name in conditions)


_COMPUTATION = re.compile(r"^%?([\w.-]+) \(.*\{\n((?:  .*\n)*)", re.MULTILINE)
_CONDITION = re.compile(r"\bcondition=%?([\w.-]+)")
_OPERATION = re.compile(r"^  (?:ROOT )?%?[\w.-]+ = \S+ ([a-z-]+)\(", re.MULTILINE)
_KERNELS = {"and", "compare", "copy", "custom-call", "fusion", "not", "or", "reduce"}
"""Operations in a condition that are kernels for certain."""


def abstract(leaf: Any) -> jax.ShapeDtypeStruct:
    """The shape and the dtype of an array."""
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype)


@functools.cache
def initialize_lapack() -> None:
    """Look up the functions of LAPACK, as lowering does: a loaded program would call a null pointer."""
    matrix = jax.ShapeDtypeStruct((1, 1), np.float32)
    jax.jit(jax.numpy.linalg.cholesky).trace(matrix).lower(lowering_platforms=("cpu",))
