"""Sweeps of 24 chunks that drivers and workers share while both are lost: the bytes are those of one process.

A case is run by processes; by processes each of which sees the folder through a mount of its own, like nodes
that share it by NFS; by Ray's actors on two nodes; or by an array of Slurm, where these are installed. Faults
hit when a random share of the chunks has begun, so that a slow machine sees them at the same points as a
quick one.
"""

import abc
import atexit
import dataclasses
import functools
import importlib.util
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from typing_extensions import override

from bojax.results.leases import Attempts, is_gone
from bojax.results.store import MANIFEST, WORK, ResultsError, read_json
from tests.campaign.case import Outcome, raised
from tests.campaign.process import Child, Ended, scratch
from tests.campaign.workloads import ROOT, WORKLOADS, contents, difference, finished

CHUNKS = 24
_PATIENCE = 400.0
"""Seconds after which a process is taken to hang, on a busy machine."""

_MOST_RESUMES = 12

_LATE = 1.0
"""Seconds for which a mount may not see what others have written."""


def check(seed: int) -> Outcome:
    """Disturb a sweep at moments that follow from the seed, and resume it until it is finished."""
    draw = random.Random(f"launches {seed}")
    kind = {0: _Ray, 5: _Slurm, 7: _Mounts}.get(seed % 10, _Processes)
    kind = kind if kind.is_installed() else _Processes
    wanted = contents(finished("shared"))
    with scratch() as place:
        launch = kind(place, draw)
        try:
            launch.begin()
            for mark in sorted(draw.uniform(0, CHUNKS) for _ in range(draw.randint(*kind.faults))):
                launch.wait_for(mark)
                time.sleep(draw.uniform(0.0, 0.2))
                launch.disturb()
            launch.finish()
            fault = launch.fault or difference(contents(launch.out), wanted)
            return Outcome(launch.told, fault)
        finally:
            launch.close()


class _Launch(abc.ABC):
    """A sweep that several processes run."""

    faults = (2, 5)
    """Bounds of the number of faults."""

    lease = 0.5
    """Seconds without a heartbeat after which a lease ends, as the workload sets it."""

    def __init__(self, place: Path, draw: random.Random):
        self.place, self.out, self.fault = place, place / "out", ""
        self._draw, self._paused, self._tried = draw, list[int](), list[str]()
        self._children: dict[Child, bool] = {}  # and whether it was disturbed
        self._driver: Child | None = None

    @staticmethod
    @abc.abstractmethod
    def is_installed() -> bool:
        """Whether this machine has what it needs."""

    @abc.abstractmethod
    def drive(self, *, resume: bool) -> None:
        """Start a driver."""

    def actions(self) -> dict[str, Callable[[], object]]:
        """What can be done to it, by name."""
        return {
            "worker killed": lambda: self._signal_one(signal.SIGKILL),
            "worker paused": self._pause,
            "worker paused to the end": self._pause_to_the_end,
            "driver killed": self._kill_driver,
        }

    @property
    def told(self) -> str:
        """What was tried, in words."""
        return f"{type(self).__name__[1:].lower()}: {', '.join(self._tried)}"

    def begin(self) -> None:
        """Start the sweep."""
        self.drive(resume=False)

    def disturb(self) -> None:
        """Let something go wrong, unless the sweep is over."""
        if self.is_finished:
            return
        name, act = self._draw.choice(sorted(self.actions().items()))
        self._tried.append(f"{name} at {self.begun()}")
        act()

    @property
    def is_finished(self) -> bool:
        """Whether the tables are written, and nothing else is left."""
        try:
            done = read_json(self.out / MANIFEST).get("status") == "finished"
        except ResultsError:
            return False
        return done and not (self.out / WORK).exists()

    def attempts(self) -> Attempts:
        """The attempts at each chunk; none if there is no working folder."""
        found = Attempts(self.out / WORK)
        try:
            found.look()
        except ResultsError:
            pass
        return found

    def begun(self) -> int:
        """Number of chunks that have begun."""
        return CHUNKS if self.is_finished else len(self.attempts().newest)

    def wait_for(self, mark: float) -> None:
        """Wait until a number of chunks has begun, or nothing happens any more."""
        deadline = time.monotonic() + _PATIENCE
        while self.begun() < mark and self.is_running() and time.monotonic() < deadline:
            time.sleep(0.02)

    def is_running(self) -> bool:
        """Whether anything can begin a chunk."""
        return any(child.poll() is None for child in self._children)

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
        for child, was_disturbed in self._children.items():
            self._judge(child.wait(child.wall + _PATIENCE), was_disturbed=was_disturbed)
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

    def _judge(self, ended: Ended, *, was_disturbed: bool) -> None:
        errors = [line for line in ended.err.splitlines() if line.startswith("error: ")]
        if ended.is_late:
            self.fault = self.fault or f"not over after {ended.wall:.0f} s"
        elif "Traceback (most" in ended.err:
            self.fault = self.fault or raised(ended.err)
        elif ended.code in (1, 2) and len(errors) != 1:
            self.fault = self.fault or f"exit code {ended.code} with errors {errors}"
        elif ended.code not in (0, 1, 2) and not was_disturbed:
            self.fault = self.fault or f"exit code {ended.code}: {ended.err[-200:]}"

    def _start(self, function: Callable[[], int], *, is_limited: bool = True) -> Child:
        child = Child(function, self.place, is_limited=is_limited)
        self._children[child] = False
        return child

    def _workers(self) -> list[int]:
        """Processes, other than drivers, that hold a share of the folder and are alive."""
        beats = self.attempts().heartbeats().values() if (self.out / WORK).is_dir() else ()
        found = [int(beat.process[2]) for beat in beats if beat.process and not is_gone(beat.process)]
        drivers = [self._driver.pid] if self._driver else []
        return sorted(set(found) - set(drivers) - set(self._paused))

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
            time.sleep(self._draw.uniform(0.2, 4.0) * self.lease)
            _send(pid, signal.SIGCONT)

    def _pause_to_the_end(self) -> None:
        if not self._paused:  # two would be all workers of Ray or Slurm
            self._paused += self._signal_one(signal.SIGSTOP)

    def _kill_driver(self) -> None:
        if self._driver is not None:
            self._children[self._driver] = True
            self._driver.send(signal.SIGKILL)


class _Processes(_Launch):
    """A driver that runs chunks itself, and two workers that are replaced when they are lost."""

    @staticmethod
    @override
    def is_installed() -> bool:
        return True

    @override
    def drive(self, *, resume: bool) -> None:
        self._driver = self._start(self.sweep(self.seen(), resume=resume))

    def sweep(self, out: Path, *, resume: bool) -> Callable[[], int]:
        """A function that runs the sweep in a folder."""
        return WORKLOADS["shared"].start(out, resume=resume)

    def seen(self) -> Path:
        """The results folder as the next process sees it."""
        return self.out

    @override
    def begin(self) -> None:
        super().begin()
        while not (self.out / WORK / "sweep.json").exists() and self.is_running():
            time.sleep(0.01)
        for _ in range(2):
            self._join()

    @override
    def actions(self) -> dict[str, Callable[[], object]]:
        return {
            **super().actions(),
            "worker stopped": lambda: self._signal_one(signal.SIGTERM),
            "driver stopped": self._stop_driver,
            "driver paused": self._pause_driver,
        }

    @override
    def disturb(self) -> None:
        super().disturb()
        if self._draw.random() < 0.5 and self._driver is not None and self._driver.poll() is not None:
            self.drive(resume=True)
        if (self.out / WORK).is_dir():
            self._join()

    def _stop_driver(self) -> None:
        assert self._driver is not None
        self._children[self._driver] = True
        self._driver.send(signal.SIGTERM)
        self._driver.wait(self._driver.wall + _PATIENCE)

    def _pause_driver(self) -> None:
        assert self._driver is not None
        self._driver.send(signal.SIGSTOP)
        time.sleep(self._draw.uniform(0.2, 4.0) * self.lease)
        self._driver.send(signal.SIGCONT)

    def _join(self) -> None:
        from bojax.cli.main import main

        out = str(self.seen())
        self._start(lambda: main(["worker", out, "--cores", "1"]))


class _Mounts(_Processes):
    """The same, where each process is on a node of its own: it sees what others write a second late.

    A mount of bindfs keeps entries of folders, also missing ones, and attributes of files, as NFS does.
    """

    lease = 4 * _LATE

    def __init__(self, place: Path, draw: random.Random):
        super().__init__(place, draw)
        self._mounts: list[Path] = []

    @staticmethod
    @override
    def is_installed() -> bool:
        return os.geteuid() == 0 and shutil.which("bindfs") is not None and Path("/dev/fuse").exists()

    @override
    def sweep(self, out: Path, *, resume: bool) -> Callable[[], int]:
        shared = WORKLOADS["shared"]
        patient = dataclasses.replace(shared, words=(*shared.words, f"engine.lease_seconds={self.lease}"))
        return patient.start(out, resume=resume)

    @override
    def seen(self) -> Path:
        folder = self.place / f"node-{len(self._mounts)}"
        folder.mkdir()
        (self.place / "shared").mkdir(exist_ok=True)
        self.out = self.place / "shared" / "out"
        caching = ",".join(f"{kind}_timeout={_LATE}" for kind in ("attr", "entry", "negative"))
        subprocess.run(["bindfs", "-o", caching, self.place / "shared", folder], check=True)
        self._mounts.append(folder)
        return folder / "out"

    @override
    def _start(self, function: Callable[[], int], *, is_limited: bool = True) -> Child:
        def elsewhere() -> int:
            import bojax.results.leases

            # Processes of other machines cannot be looked up: their leases end with their heartbeats alone.
            bojax.results.leases.process_identity = lambda pid: None
            return function()

        return super()._start(elsewhere, is_limited=is_limited)

    @override
    def _workers(self) -> list[int]:
        alive = [child.pid for child in self._children if child.poll() is None and child is not self._driver]
        return sorted(set(alive) - set(self._paused))

    @override
    def close(self) -> None:
        super().close()
        for folder in self._mounts:
            subprocess.run(["umount", "-l", folder], check=True)


class _Ray(_Launch):
    """Actors on two nodes, one of which may be lost."""

    faults = (1, 3)

    @staticmethod
    @override
    def is_installed() -> bool:
        return importlib.util.find_spec("ray") is not None

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
    """An array of two tasks."""

    faults = (1, 3)

    @staticmethod
    @override
    def is_installed() -> bool:
        commands = ("slurmctld", "slurmd", "munged", "sbatch")
        return os.geteuid() == 0 and all(map(shutil.which, commands))

    @override
    def drive(self, *, resume: bool) -> None:
        os.environ["SLURM_CONF"] = str(_slurm_cluster() / "slurm.conf")
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
        }
        return {**super().actions(), **own}

    @override
    def settle(self) -> None:
        super().settle()
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline and self.is_running():
            attempts = self.attempts()
            if len(set(attempts.complete) | set(attempts.failed)) == CHUNKS:
                return
            time.sleep(0.2)

    @override
    def close(self) -> None:
        for task in self._tasks():
            subprocess.run(["scancel", task], check=False)
        super().close()

    def _tasks(self) -> list[str]:
        """The tasks of this sweep that run; one that waits after it was requeued may wait for minutes."""
        shown = subprocess.run(
            ["squeue", "-h", "-r", "-t", "R,CG", "-o", "%i %Z"], capture_output=True, text=True
        )
        pending = subprocess.run(
            ["squeue", "-h", "-r", "-t", "PD", "-o", "%i %Z %r"], capture_output=True, text=True
        )
        lines = [
            *shown.stdout.splitlines(),
            *(x for x in pending.stdout.splitlines() if "BeginTime" not in x),
        ]
        return [line.split()[0] for line in lines if line.split()[1] == str(self.place)]

    def _slurm(self, *words: str) -> None:
        if tasks := self._tasks():
            subprocess.run([*words, self._draw.choice(tasks)], check=False, capture_output=True)


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
def _slurm_cluster() -> Path:
    folder = Path(_scratch_folder())
    script = ROOT / "tests" / "engine" / "slurm_cluster.sh"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = min(free.getsockname()[1], 65000)
    environment = {**os.environ, "SLURM_PORT": str(port)}
    subprocess.run([script, folder, "start"], check=True, timeout=120, env=environment)
    atexit.register(subprocess.run, [script, folder, "stop"])
    return folder


def _scratch_folder() -> str:
    import tempfile

    return tempfile.mkdtemp(prefix="bojax-slurm-")
