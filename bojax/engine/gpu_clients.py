"""Several chunks at once on one NVIDIA GPU.

A chunk of a few hundred runs is a sequence of small kernels that leave most of a GPU idle, and JAX runs the
programs of a device one after another. A further client of the same GPU is a device of its own to JAX, with a
stream of its own: its kernels run beside those of the others. Numbers do not depend on it.
"""

import contextlib
import ctypes
import threading
from collections.abc import Collection, Iterable, Iterator

import jax
from jax.stages import Compiled

from bojax import gpu_allocator
from bojax.engine.devices import Device

MOST_CLIENTS = 4
"""Maximum number of clients of a GPU, and of chunks that it runs at once."""

SHARE_OF_MEMORY = 0.7
"""Share of a GPU's memory for the programs of all chunks; compilation and records need some, too."""

_clients: dict[Device, list[Device]] = {}


def clients_of(gpu: Device, number: int) -> list[Device]:
    """A GPU as a number of devices, `MOST_CLIENTS` at most, the given one first.

    It stays the only one if the GPU is not NVIDIA's, if there can be no further client, or if the allocator
    of `gpu_allocator` is not used: with others, each client would keep what its arrays have once taken.
    """
    if not gpu_allocator.is_chosen() or total_memory(gpu) is None:
        return [gpu]
    clients = _clients.setdefault(gpu, [gpu])
    with contextlib.suppress(Exception):  # functions of jaxlib may change; one client is enough
        from jaxlib import xla_client

        while len(clients) < min(number, MOST_CLIENTS):
            options = dict(xla_client.generate_pjrt_gpu_plugin_options())
            options["visible_devices"] = [gpu.local_hardware_id]
            clients += xla_client.make_c_api_client("cuda", options).devices()
    return clients[: max(number, 1)]


def total_memory(gpu: Device) -> int | None:
    """Bytes of memory of a GPU; None unless it is one of NVIDIA's."""
    if gpu.platform == "cpu" or "cuda" not in gpu.client.platform_version.lower():
        return None
    handle, size = ctypes.c_int(), ctypes.c_size_t()
    try:  # JAX does not say how much memory there is if CUDA's allocator is used
        driver = ctypes.CDLL("libcuda.so.1")
        failed = driver.cuDeviceGet(ctypes.byref(handle), gpu.local_hardware_id)
        failed = failed or driver.cuDeviceTotalMem_v2(ctypes.byref(size), handle)
    except (OSError, AttributeError):
        return None
    return None if failed else size.value


class DeviceMemory:
    """The memory of a GPU, a limited number of bytes, of which every running chunk holds a part."""

    def __init__(self, limit: int):
        self._limit, self._free = limit, limit
        self._turn, self._changed = threading.Lock(), threading.Condition()

    @contextlib.contextmanager
    def held(self, needed: int | None) -> Iterator[None]:
        """Hold memory while this context is open, once it is free.

        While a chunk waits, no other one is given memory: small ones do not keep a large one waiting. A chunk
        that needs None, or more bytes than there are, runs alone.
        """
        needed = self._limit if needed is None else min(needed, self._limit)
        with self._turn, self._changed:
            self._changed.wait_for(lambda: self._free >= needed)
            self._free -= needed
        try:
            yield
        finally:
            with self._changed:
                self._free += needed
                self._changed.notify_all()


def shared_memory(devices: Collection[Device]) -> dict[Device, DeviceMemory]:
    """For each device that is one of several clients of a GPU, the memory of that GPU."""
    found = {}
    for gpu, clients in _clients.items():
        if len(used := [client for client in clients if client in devices]) > 1:
            found |= dict.fromkeys(used, DeviceMemory(int(SHARE_OF_MEMORY * (total_memory(gpu) or 0))))
    return found


def needed_memory(programs: Iterable[Compiled]) -> int | None:
    """Bytes of a device that programs need if they run one after another; None if XLA does not say."""
    most = 0
    for program in programs:
        try:
            found = program.memory_analysis()
        except jax.errors.JaxRuntimeError:
            return None
        if found is None:
            return None
        held = found.argument_size_in_bytes + found.output_size_in_bytes - found.alias_size_in_bytes
        most = max(most, held + found.temp_size_in_bytes)
    return most
