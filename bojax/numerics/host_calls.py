"""Calls of NumPy functions from compiled programs on a CPU, by name: such programs can be cached.

A program with `jax.pure_callback` holds the address of a function of its process, so that JAX never caches
it. Here a program holds a name, which XLA looks up when the program is loaded (its foreign function
interface, `xla/ffi/api/c_api.h`). The structures below are the leading fields of those of that interface.
"""

import ctypes
import traceback
from collections.abc import Callable
from ctypes import POINTER, Structure, c_int, c_int64, c_size_t, c_void_p
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

_METADATA = 1  # kind of the extension by which XLA asks for a version in place of a call
_VERSION = 0, 3


class _Version(Structure):
    _fields_ = [("size", c_size_t), ("extension", c_void_p), ("major", c_int), ("minor", c_int)]


class _Metadata(Structure):
    _fields_ = [("size", c_size_t), ("version", _Version)]


class _Extension(Structure):
    _fields_ = [("size", c_size_t), ("kind", c_int), ("next", c_void_p), ("metadata", POINTER(_Metadata))]


class _Buffer(Structure):
    _fields_ = [
        ("size", c_size_t),
        ("extension", c_void_p),
        ("dtype", c_int),
        ("data", c_void_p),
        ("rank", c_int64),
        ("dims", POINTER(c_int64)),
    ]


class _Buffers(Structure):
    _fields_ = [
        ("size", c_size_t),
        ("extension", c_void_p),
        ("number", c_int64),
        ("kinds", c_void_p),
        ("buffers", POINTER(POINTER(_Buffer))),
    ]


class _Call(Structure):
    _fields_ = [
        ("size", c_size_t),
        ("extension", POINTER(_Extension)),
        ("api", c_void_p),
        ("context", c_void_p),
        ("stage", c_int),
        ("arguments", _Buffers),
        ("results", _Buffers),
    ]


_Handler = ctypes.CFUNCTYPE(c_void_p, POINTER(_Call))
_handlers: dict[str, Any] = {}
"""The handlers by name, which must outlive the programs that call them."""


def register(name: str, function: Callable[[np.ndarray], np.ndarray]) -> bool:
    """Let compiled programs call a function from rows `[L, A]` to rows `[L, B]`, both float32, by this name.

    A name stands for one function, in every process: programs that call it are cached. If the function raises
    an exception, Python prints it, and the result is NaN. Returns whether this version of XLA has the
    interface that is used here.
    """
    if name in _handlers:
        return True

    def handle(call: Any) -> None:
        frame = call.contents
        if frame.extension and frame.extension.contents.kind == _METADATA:
            version = frame.extension.contents.metadata.contents.version
            version.major, version.minor = _VERSION
            return
        result = _view(frame.results)
        try:
            result[:] = function(_view(frame.arguments))
        except BaseException:  # to XLA, whatever an exception leaves behind would be the address of an error
            traceback.print_exc()
            result[:] = np.nan

    handler = _Handler(handle)
    try:
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(handler), platform="cpu")
    except Exception:  # of XLA: a later version of the interface
        return False
    _handlers[name] = handler
    return True


def call(name: str, rows: Float[Array, "L A"], width: int) -> Float[Array, "L B"]:
    """The result of the function of a name, with rows of this width."""
    return jax.ffi.ffi_call(name, jax.ShapeDtypeStruct((rows.shape[0], width), rows.dtype))(rows)


def _view(buffers: _Buffers) -> np.ndarray:
    """The first of some matrices of float32, as an array on its memory."""
    buffer = buffers.buffers[0].contents
    shape = tuple(buffer.dims[: buffer.rank])
    if not np.prod(shape):
        return np.zeros(shape, np.float32)
    return np.ctypeslib.as_array(ctypes.cast(buffer.data, POINTER(ctypes.c_float)), shape)
