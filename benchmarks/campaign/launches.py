"""Sweeps of 24 chunks whose drivers and workers are lost: the bytes are those of one process.

A case is run by Ray's actors on two nodes; by an array of Slurm; or, where these are not installed, by a
driver and two workers that are started by hand. Faults hit when a random share of the chunks has begun, so
that a slow machine sees them at the same points as a quick one, and while a chunk runs.
"""

import abc
import atexit
import contextlib
import functools
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from typing_extensions import override

from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import Child, cli, scratch
from benchmarks.campaign.workloads import ROOT, WORKLOADS, fault_in, finished
from bojax.results.attempts import AttemptRegistry
from bojax.results.store import MANIFEST, WORK, ResultsError, read_json
from tests.engine.clusters import HAS_SLURM, running, slurm

CHUNKS = 24
_PATIENCE = 300.0
"""Seconds after which a process is taken to hang, on a busy machine."""

_MOST_RESUMES = 12


def check(seed: int) -> Outcome:
    """Disturb a sweep at moments that follow from the seed, and resume it until it is finished."""
    draw = random.Random(f"launches {seed}")
    kind = (_Processes, _Ray, _Slurm)[seed % 3]
    if (kind is _Ray and not find_spec("ray")) or (kind is _Slurm and not HAS_SLURM):
        kind = _Processes
    finished("shared")
    with scratch() as place:
        launch = kind(place, draw)
        try:
            launch.drive(resume=False)
            for mark in sorted(draw.uniform(0, CHUNKS) for _ in range(draw.randint(3, 6))):
                launch.wait_for(mark)
                launch.disturb()
            launch.finish()
            fault = launch.fault or fault_in(launch.out, "shared")
            return Outcome(launch.told, fault)
        finally:
            launch.close()


class _Launch(abc.ABC):
    """A sweep that several processes run."""

    def __init__(self, place: Path, draw: random.Random):
        self.place, self.out, self.fault = place, place / "out", ""
        self._draw, self._paused, self._tried = draw, list[int](), list[str]()
        self._children: dict[Child, bool] = {}  # and whether it was disturbed
        self._driver: Child | None = None

    @abc.abstractmethod
    def drive(self, *, resume: bool) -> None:
        """Start a driver."""

    def actions(self) -> dict[str, Callable[[], object]]:
        """What can be done to it, by name."""
        return {
            "worker killed": lambda: self._signal_one(signal.SIGKILL),
            "worker paused": self._pause,
            "driver killed": self._kill_driver,
            "worker paused to the end, driver killed": self._pause_to_the_end,
        }

    @property
    def told(self) -> str:
        """What was tried, in words."""
        return f"{type(self).__name__[1:].lower()}: {', '.join(self._tried)}"

    def disturb(self) -> None:
        """Let something go wrong, unless the sweep is over."""
        name, act = self._draw.choice(sorted(self.actions().items()))
        running = len(self._workers())
        if running and not self.is_finished:
            self._tried.append(f"{name} at {self.begun()} while {running} ran")
            act()

    @property
    def is_finished(self) -> bool:
        """Whether the tables are written, and nothing else is left."""
        try:
            done = read_json(self.out / MANIFEST).get("status") == "finished"
        except ResultsError:
            return False
        return done and not (self.out / WORK).exists()

    def attempts(self) -> AttemptRegistry | None:
        """The attempts at each chunk; None if there is no working folder."""
        try:
            return AttemptRegistry(self.out / WORK, self.out)
        except ResultsError:
            return None

    def begun(self) -> int:
        """Number of chunks that have begun."""
        attempts = self.attempts()
        return CHUNKS * self.is_finished if attempts is None else len(attempts.begun())

    def wait_for(self, mark: float) -> None:
        """Wait until a number of chunks has begun and one runs, or nothing happens any more."""
        deadline = time.monotonic() + _PATIENCE
        while self.is_running() and time.monotonic() < deadline:
            if self.begun() >= mark and self._workers():
                return
            time.sleep(0.02)

    def is_running(self) -> bool:
        """Whether anything can begin a chunk: a process that was paused to the end cannot."""
        return any(child.poll() is None and child.pid not in self._paused for child in self._children)

    def finish(self) -> None:
        """Resume the sweep until it is finished, and wake up what was paused."""
        for _ in range(_MOST_RESUMES):
            if self._driver is None or self._driver.poll() is not None:
                if self.is_finished:
                    break
                self.drive(resume=True)
            self.settle()
        for pid in self._paused:
            _send(pid, signal.SIGCONT)
        self._paused.clear()
        for child, was_disturbed in self._children.items():
            ended = child.wait(child.wall + _PATIENCE)
            codes = (0, 1, 2, *([ended.code] if was_disturbed else []))
            self.fault = self.fault or fault_of(ended, codes)
        if not self.is_finished:
            self.fault = self.fault or f"not finished after {_MOST_RESUMES} drivers"

    def settle(self) -> None:
        """Wait for the driver."""
        assert self._driver is not None
        self._driver.wait(self._driver.wall + _PATIENCE)

    def close(self) -> None:
        """End what is left of a case that fell short."""
        for pid in self._paused:
            _send(pid, signal.SIGKILL)
        for child in self._children:
            child.send(signal.SIGKILL)
            child.wait()

    def _start(self, function: Callable[[], int], *, is_limited: bool = True) -> Child:
        child = Child(function, self.place, is_limited=is_limited)
        self._children[child] = False
        return child

    def _workers(self) -> list[int]:
        """Processes, other than drivers, that run a chunk at this moment."""
        attempts = self.attempts()
        found = set() if attempts is None else set(running(attempts))
        return sorted(found - {self._driver.pid if self._driver else 0} - set(self._paused))

    def _signal_one(self, number: int) -> list[int]:
        """Send a signal to one of the workers, and return it; none if there is none."""
        workers = self._workers()
        if not workers:
            return []
        pid = self._draw.choice(workers)
        _send(pid, number)
        for child in self._children:
            if child.pid == pid:
                self._children[child] = True
        return [pid]

    def _pause(self) -> None:
        for pid in self._signal_one(signal.SIGSTOP):
            time.sleep(self._draw.uniform(0.2, 4.0))
            _send(pid, signal.SIGCONT)

    def _pause_to_the_end(self) -> None:
        if not self._paused:  # two would be all workers
            self._paused += self._signal_one(signal.SIGSTOP)
            self._kill_driver()

    def _kill_driver(self) -> None:
        if self._driver is not None:
            self._children[self._driver] = True
            self._driver.send(signal.SIGKILL)


class _Processes(_Launch):
    """Two workers of a launch that a driver has begun; or, later, a driver that runs all chunks itself."""

    @override
    def drive(self, *, resume: bool) -> None:
        self._driver = self._start(WORKLOADS["shared"].start(self.out, resume=resume))
        while not (self.out / WORK / "launch.json").exists() and self.is_running() and not resume:
            time.sleep(0.01)
        if not resume:
            self._kill_driver()
            for number in range(2):
                self._join(number)

    @override
    def actions(self) -> dict[str, Callable[[], object]]:
        number = self._draw.randrange(2)
        return {
            **super().actions(),
            "worker stopped": lambda: self._signal_one(signal.SIGTERM),
            "worker started beside": lambda: self._join(number),
        }

    def _join(self, number: int) -> None:
        self._start(lambda: cli("worker", str(self.out), "--cores", "1", "--share", f"{number}/2"))


class _Ray(_Launch):
    """Actors on two nodes, one of which may be lost."""

    @override
    def drive(self, *, resume: bool) -> None:
        os.environ["RAY_ADDRESS"] = _ray_cluster("address")
        start = WORKLOADS["shared"].start_afresh(self.out, "--launcher", "ray", resume=resume)
        self._driver = self._start(start, is_limited=False)

    @override
    def actions(self) -> dict[str, Callable[[], object]]:
        return {**super().actions(), "node lost": self._lose_node}

    def _lose_node(self) -> None:
        if self._driver is not None:
            self._children[self._driver] = True  # it may use that node to reach the cluster
        _ray_cluster("lose")


class _Slurm(_Launch):
    """An array of two tasks at a time."""

    @override
    def drive(self, *, resume: bool) -> None:
        os.environ["SLURM_CONF"] = str(_slurm_conf())
        (self.place / "cluster.yaml").write_text("{tasks: 2, cpus_per_task: 1, time: '0:10:00'}")
        words = ("--launcher", "slurm", "--cluster", "cluster.yaml")
        start = WORKLOADS["shared"].start_afresh(self.out, *words, resume=resume)
        self._driver = self._start(start, is_limited=False)
        if not resume:
            self._driver.wait(_PATIENCE)

    @override
    def is_running(self) -> bool:
        return super().is_running() or len(self._tasks()) > len(self._paused)

    @override
    def actions(self) -> dict[str, Callable[[], object]]:
        own = {
            "task requeued": lambda: self._slurm("scontrol", "requeue"),
            "task near its limit": lambda: self._slurm("scancel", "--signal=USR2", "--batch"),
            "task cancelled": lambda: self._slurm("scancel"),
            "node lost": self._lose_node,
        }
        return {**super().actions(), **own}

    def _lose_node(self) -> None:
        node = f"NodeName={socket.gethostname().split('.')[0]}"
        _run("scontrol", "update", node, "State=DOWN", "Reason=lost")
        time.sleep(2.0)
        _run("scontrol", "update", node, "State=RESUME")

    @override
    def settle(self) -> None:
        super().settle()
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline and self._tasks():
            if self._paused and len(self._tasks()) <= len(self._paused):
                for task in self._tasks():  # what a user would do with a task that hangs
                    _run("scancel", task)
                self._paused.clear()  # Slurm wakes them up, to end them
            time.sleep(0.2)

    @override
    def close(self) -> None:
        for task in self._tasks():
            _run("scancel", task)
        super().close()

    def _tasks(self, states: str = "R,CG,PD") -> list[str]:
        """The tasks of this sweep; Slurm holds one whose node was lost while it was launched."""
        shown = _run("squeue", "-h", "-r", "-t", states, "-o", "%i %Z %r").splitlines()
        own = [line.split(maxsplit=2) for line in shown if line.split()[1] == str(self.place)]
        for task, _, reason in own:
            if "held" in reason:
                _run("scontrol", "release", task)
        return [task for task, *_ in own]

    def _slurm(self, *words: str) -> None:
        if tasks := self._tasks("R"):
            _run(*words, self._draw.choice(tasks))


def _run(*words: str) -> str:
    return subprocess.run(words, check=False, capture_output=True, text=True).stdout


def _send(pid: int, number: int) -> None:
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        pass


_CLUSTER = """
import sys
from ray.cluster_utils import Cluster
given = {"num_cpus": 1, "num_gpus": 1, "object_store_memory": 80_000_000}
cluster = Cluster(initialize_head=True, head_node_args=given)
node = cluster.add_node(**given)
cluster.wait_for_nodes()
for line in sys.stdin:
    if line == "lose\\n":
        cluster.remove_node(node, allow_graceful=False)
        node = cluster.add_node(**given)
        cluster.wait_for_nodes()
    print(cluster.address, flush=True)
cluster.shutdown()
"""
"""Two nodes that pretend to have a GPU each; a lost one is replaced."""


def _ray_cluster(request: str) -> str:
    """The address of the cluster, once a node was lost if that is requested."""
    server = _ray_server()
    assert server.stdin is not None and server.stdout is not None
    server.stdin.write(f"{request}\n")
    server.stdin.flush()
    return server.stdout.readline().strip()


@functools.cache
def _ray_server() -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    server = subprocess.Popen(
        [sys.executable, "-c", _CLUSTER],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    atexit.register(server.communicate, timeout=60)
    return server


@functools.cache
def _slurm_conf() -> Path:
    """The configuration of Slurm's daemons, which end with this process."""
    stack = contextlib.ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(slurm(Path(tempfile.mkdtemp(prefix="bojax-slurm-"))))
