"""Child processes compile what the parent then loads; without them, the parent compiles by itself."""

import threading
from concurrent.futures import ThreadPoolExecutor

import jax
import pytest

from bojax.config.sweep import load_sweep
from bojax.engine import batch, compile_processes
from bojax.engine.compile_processes import CompileProcesses, number_of_processes
from bojax.engine.run import run_sweeps
from bojax.engine.targets import Request
from tests.engine.drive import contents, run_sweep
from tests.engine.test_program_cache import caching_in
from tests.tiers import by_tier

GIBIBYTE = 1 << 30


class Gpu:
    """A GPU of which JAX takes three quarters."""

    platform = "gpu"

    def __init__(self, gibibytes: float):
        self._limit = int(0.75 * gibibytes * GIBIBYTE)

    def memory_stats(self):
        return {"bytes_limit": self._limit}


CHAINS = "{base: chain, axes: {episodes: [2], env.max_length: [4, 5], env.length: [3]}}"


@pytest.fixture(autouse=True)
def cache(here):
    """An empty cache, and the file of the sweep."""
    (here / "chains.yaml").write_text(CHAINS)
    with caching_in(here / "cache") as programs:
        yield programs


@pytest.fixture
def enough(monkeypatch):
    """A machine with 16 cores, on which two groups are many."""
    monkeypatch.setattr(compile_processes, "usable_cores", lambda: 16)
    monkeypatch.setattr(compile_processes, "compile_threads", lambda: 2)
    monkeypatch.setattr(compile_processes, "LEAST_GROUPS", 2)


def chains():
    """A sweep of two groups."""
    return load_sweep("chains.yaml", [], 2, None)


@pytest.mark.bits
def test_children_compile_while_other_sweeps_are_planned_and_the_parent_writes_the_same_bytes(
    enough, here, monkeypatch
):
    begun, begin = [], CompileProcesses.begin
    monkeypatch.setattr(
        CompileProcesses, "begin", lambda self, request: begin(self, request) and not begun.append(request)
    )
    (here / "others.yaml").write_text(
        "{base: chain, axes: {episodes: [3], env.max_length: [6], env.length: [3]}}"
    )
    sweeps = [chains(), load_sweep("others.yaml", [], 2, None)]
    before = batch.compile_counts.total()
    requests = [Request(sweep, here / sweep.name) for sweep in sweeps]
    assert run_sweeps(requests, False, ["bojax"]) == 0
    assert batch.compile_counts.total() == before
    assert len(begun) == len({request.key for request in begun}) > 1
    with pytest.MonkeyPatch.context() as patch, caching_in(here / "other"):
        patch.setattr(compile_processes, "LEAST_GROUPS", 3)
        assert run_sweep(chains(), here / "alone") == 0
    assert batch.compile_counts.total() > before
    assert contents(here / sweeps[0].name) == contents(here / "alone")


def test_who_asks_for_programs_that_are_begun_waits_for_them(enough, monkeypatch):
    first, second = (compile_processes.Request._make([None] * 8 + [key]) for key in ("first", "second"))
    go_on, compiled = threading.Event(), []

    def compile_in(self, child, request):
        if request is first:
            assert go_on.wait(60.0)
        compiled.append(request)
        self._idle.put(child)
        return 1.0

    monkeypatch.setattr(CompileProcesses, "_compile_in", compile_in)
    processes = CompileProcesses(1)
    try:
        assert processes.begin(first) and not processes.begin(second)
        with ThreadPoolExecutor() as pool:
            same, other = pool.submit(processes.compile, first), pool.submit(processes.compile, second)
            assert not (same.done() or other.done())
            go_on.set()
            assert same.result(60.0) == other.result(60.0) == 1.0
        assert compiled == [first, second]
    finally:
        processes.close()


def test_an_error_while_programs_are_begun_reaches_who_asks_for_them(enough, monkeypatch):
    def fail(*_):
        raise TypeError("cannot pickle")

    monkeypatch.setattr(CompileProcesses, "_compile_in", fail)
    processes = CompileProcesses(1)
    request = compile_processes.Request._make([None] * 8 + ["first"])
    try:
        assert processes.begin(request)
        with pytest.raises(TypeError, match="cannot pickle"):
            processes.compile(request)
    finally:
        processes.close()


@pytest.mark.parametrize("fault", by_tier(["dies", "refuses"], normal=["dies"]))
def test_the_parent_compiles_what_a_child_does_not(enough, tmp_path, monkeypatch, fault):
    start = CompileProcesses.__init__

    def with_fault(self, number):
        start(self, number)
        for child in self._children if fault == "dies" else ():
            child.kill()

    monkeypatch.setattr(CompileProcesses, "__init__", with_fault)
    if fault == "refuses":  # a flag with which its programs would be others
        monkeypatch.setenv("JAX_DEFAULT_MATMUL_PRECISION", "highest")
    before = batch.compile_counts.total()
    assert run_sweep(chains(), tmp_path / "out") == 0
    assert batch.compile_counts.total() > before


def test_processes_that_do_not_start_are_done_without(monkeypatch):
    def refuse(*_, **__):
        raise BlockingIOError("Resource temporarily unavailable")

    monkeypatch.setattr(compile_processes.subprocess, "Popen", refuse)
    processes = CompileProcesses(2)
    assert not processes
    processes.close()


def test_few_groups_few_cores_or_little_memory_start_no_process(enough, monkeypatch):
    monkeypatch.setattr(compile_processes, "compile_threads", lambda: 8)
    assert number_of_processes(1, []) == 0
    assert number_of_processes(20, []) == number_of_processes(20, jax.devices("cpu")) == 8
    assert number_of_processes(3, []) == 3
    assert number_of_processes(20, [Gpu(80)]) == 8
    assert number_of_processes(20, [Gpu(80), Gpu(25)]) == 3
    assert number_of_processes(20, [Gpu(12)]) == 0
    monkeypatch.setenv("XLA_PYTHON_CLIENT_MEM_FRACTION", "0.9")
    assert number_of_processes(20, [Gpu(82 * 0.9 / 0.75)]) == 4
    monkeypatch.setattr(compile_processes, "usable_cores", lambda: 4)
    assert number_of_processes(20, []) == 0
