"""How JAX takes the memory of an NVIDIA GPU. JAX reads these variables when it starts a backend."""

import os

_CHOSEN = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false", "XLA_PYTHON_CLIENT_ALLOCATOR": "cuda_async"}


def choose() -> None:
    """Let JAX take memory as it is needed, by CUDA's allocator, unless the user has chosen an allocator.

    JAX's own allocator reserves three quarters of the memory for the first array, which takes 2 s on an H200.
    Without that, its free memory comes in pieces: a program that needs 38 GiB at once failed while a tenth of
    the memory was in use. The same program runs with CUDA's allocator.
    """
    if not any(name in os.environ for name in _CHOSEN):
        os.environ.update(_CHOSEN)


def is_chosen() -> bool:
    """Whether JAX reserves no memory, and gives back what is free."""
    return all(os.environ.get(name) == value for name, value in _CHOSEN.items())
