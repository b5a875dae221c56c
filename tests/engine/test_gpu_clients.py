"""Several chunks at once on one GPU. A second client of the CPU stands for one of a GPU."""

import os
import signal
import threading
import time

import jax
import jax.numpy as jnp
import pytest
from jax.sharding import SingleDeviceSharding
from jaxlib import xla_client

from bojax import gpu_allocator
from bojax.engine import execute, gpu_clients
from bojax.engine.gpu_clients import DeviceMemory, clients_of, needed_memory, shared_memory
from bojax.numerics import checkpoint
from tests.engine.drive import NEEDS_CPU, contents, run_toy

CPU = jax.devices("cpu")[0]


@pytest.fixture
def of_cpu(monkeypatch):
    """The CPU may have further clients."""
    for name, value in gpu_allocator._CHOSEN.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(gpu_clients, "total_memory", lambda _: 2**34)
    monkeypatch.setattr(gpu_clients, "_clients", {})
    monkeypatch.setattr(xla_client, "make_c_api_client", lambda *_: xla_client.make_cpu_client())


def test_clients_are_made_once_and_are_devices_of_their_own(of_cpu):
    two, four = clients_of(CPU, 2), clients_of(CPU, 9)
    assert two[0] is CPU and four[:2] == two and len(set(four)) == gpu_clients.MOST_CLIENTS
    assert clients_of(CPU, 0) == [CPU]
    double = jax.jit(lambda x: 2 * x)
    for client in four:
        assert double(jax.device_put(3.0, client)).devices() == {client}
    memory = shared_memory(two)
    assert set(memory) == set(two) and len(set(memory.values())) == 1
    assert shared_memory([CPU]) == {}


def test_without_cudas_allocator_or_a_further_client_there_is_one(of_cpu, monkeypatch):
    def refuse(*_):
        raise RuntimeError("no such plugin")

    monkeypatch.setattr(xla_client, "make_c_api_client", refuse)
    assert clients_of(CPU, 4) == [CPU]
    monkeypatch.setattr(xla_client, "make_c_api_client", lambda *_: pytest.fail("made"))
    for name, other in (("PREALLOCATE", "true"), ("ALLOCATOR", "default")):
        with monkeypatch.context() as patch:
            patch.setenv(f"XLA_PYTHON_CLIENT_{name}", other)
            assert clients_of(CPU, 4) == [CPU]


def test_only_gpus_of_nvidia_have_a_known_memory():
    assert gpu_clients.total_memory(CPU) is None


def test_memory_of_programs_is_that_of_the_largest():
    def compiled(size):
        return jax.jit(lambda x: x + 1).lower(jnp.zeros(size, jnp.float32)).compile()

    small, large = needed_memory([compiled(10)]), needed_memory([compiled(10), compiled(10_000)])
    assert small is not None and large is not None
    assert 80 <= small < large and 80_000 <= large < 100_000


def test_chunks_hold_no_more_memory_than_there_is_and_a_large_one_is_not_overtaken():
    memory, began, free, goes_on = DeviceMemory(10), [], [], threading.Event()

    def hold(name, needed):
        with memory.held(needed):
            began.append(name)
            free.append(memory._free)
            assert goes_on.wait(60.0)

    threads = []
    for name, needed in (("half", 5), ("most", 8), ("little", 1), ("alone", None), ("too much", 99)):
        threads.append(threading.Thread(target=hold, args=(name, needed)))
        threads[-1].start()
        end = time.monotonic() + 60.0
        while not began or (name == "most" and not memory._turn.locked()):
            assert time.monotonic() < end
            time.sleep(0.001)
    assert began == ["half"]  # "little" would fit beside it
    goes_on.set()
    for thread in threads:
        thread.join(60.0)
    assert began[:2] == ["half", "most"] and set(began) == {"half", "most", "little", "alone", "too much"}
    assert min(free) == 0 and memory._free == 10


def test_checkpoints_are_restored_on_any_client(of_cpu, tmp_path):
    first, second = (SingleDeviceSharding(device) for device in clients_of(CPU, 2))
    carry = [jax.device_put(jnp.arange(5.0), second), jax.device_put(jax.random.key(3), second)]
    checkpoint.save(tmp_path / "saved", checkpoint.arrays(carry))()
    for sharding in (first, second):
        structure = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding) for leaf in carry]
        numbers, key = checkpoint.restore(tmp_path / "saved", structure)
        assert numbers.sharding == key.sharding == sharding
        assert numbers.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert jax.random.key_data(key).tolist() == [0, 3]


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The content of a sweep that ran on one client."""
    out = tmp_path_factory.mktemp("alone") / "one"
    assert run_toy(out, runs=10, devices=[0]) == 0
    return contents(out)


@NEEDS_CPU
@pytest.mark.parametrize("bytes_of_gpu", [2**34, 100])
def test_a_sweep_on_several_clients_has_the_same_bytes(tmp_path, alone, of_cpu, monkeypatch, bytes_of_gpu):
    used, running, most = set(), [], []
    runner, finish = execute._Executor._runner, execute.ChunkRunner.advance

    def notes(executor, task, chunk, sink, device):
        used.add(device)
        return runner(executor, task, chunk, sink, device)

    def advance(chunk):
        running.append(chunk)
        most.append(len(running))
        try:
            finish(chunk)
        finally:
            running.remove(chunk)

    monkeypatch.setattr(gpu_clients, "total_memory", lambda _: bytes_of_gpu)
    monkeypatch.setattr(execute, "new_lock", lambda _: threading.Lock())  # as for a GPU
    monkeypatch.setattr(execute._Executor, "_runner", notes)
    monkeypatch.setattr(execute.ChunkRunner, "advance", advance)
    with monkeypatch.context() as patch:
        patch.setattr("bojax.engine.run.choose", lambda *_: [CPU])
        assert run_toy(tmp_path / "two", runs=10) == 0
    assert len(used) > 1 and contents(tmp_path / "two") == alone
    if bytes_of_gpu == 100:  # no two chunks fit
        assert max(most) == 1


@NEEDS_CPU
def test_a_sweep_stops_while_chunks_wait_for_memory_and_resumes(tmp_path, of_cpu, monkeypatch):
    points = {"scale": 1.0, "max_length": 40}, {"max_length": 30}, {"max_length": 20}
    given = {"runs": 6, "segment_seconds": 1e-6}
    assert run_toy(tmp_path / "one", *points, devices=[0], **given) == 0
    monkeypatch.setattr(gpu_clients, "total_memory", lambda _: 100)  # no two chunks fit
    monkeypatch.setattr(execute, "new_lock", lambda _: threading.Lock())
    monkeypatch.setattr("bojax.engine.run.choose", lambda *_: [CPU])
    segment = execute.ChunkRunner._segment

    def stopping(chunk):
        found = segment(chunk)
        os.kill(os.getpid(), signal.SIGINT)
        while not chunk._limits.stop():
            time.sleep(0.001)
        return found

    with monkeypatch.context() as patch:
        patch.setattr(execute.ChunkRunner, "_segment", stopping)
        assert run_toy(tmp_path / "two", *points, **given) == 130
    assert run_toy(tmp_path / "two", *points, resume=True, **given) == 0
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


@NEEDS_CPU
@pytest.mark.parametrize("fits_alone", [True, False])
def test_a_chunk_that_runs_out_of_memory_beside_others_goes_on_alone(
    tmp_path, alone, of_cpu, monkeypatch, fits_alone
):
    monkeypatch.setattr(execute, "new_lock", lambda _: threading.Lock())
    monkeypatch.setattr("bojax.engine.run.choose", lambda *_: [CPU])
    advance, held, tried = execute.ChunkRunner.advance, DeviceMemory.held, []

    def notes(memory, needed):
        tried.append(needed)
        return held(memory, needed)

    def fails(chunk):
        if not (fits_alone and None in tried):
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory")
        advance(chunk)

    monkeypatch.setattr(DeviceMemory, "held", notes)
    monkeypatch.setattr(gpu_clients, "MOST_CLIENTS", 2)
    monkeypatch.setattr(execute.ChunkRunner, "advance", fails)
    assert run_toy(tmp_path / "two", runs=10) == (0 if fits_alone else 1)
    assert None in tried and len(tried) > tried.count(None)
    if fits_alone:
        assert contents(tmp_path / "two") == alone
