"""Ray: one long-lived actor for each GPU, or for some cores each, on a cluster that runs already.

An actor runs one share of the chunks after the other: the driver gives the next share to the next idle actor.
The rounds of a search are run by the same actors. Ray starts an actor again if its process or node is lost;
its share goes to the next idle actor. The actors end with the driver.
"""

import functools
import importlib
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from typing_extensions import override

from bojax import gpu_allocator
from bojax.config.errors import say
from bojax.config.extras import needed
from bojax.config.launching import RayConfig
from bojax.engine.errors import EngineError
from bojax.engine.remote import Launcher, num_shares
from bojax.errors import FAILURE
from bojax.text import error_line

NAMESPACE = "bojax"

REACH_SECONDS = 10.0
"""Maximum time for a cluster to answer."""

CONNECT_SECONDS = 40.0
"""Maximum time for a cluster that answers to admit this process. A cluster that asks for a token takes 20 s
to refuse it."""

LOST_SECONDS = 30.0
"""Time after which a cluster that no longer answers, or has no node for an actor, is given up."""

LOCAL = "local"
"""Ray's address for a cluster that it starts on this machine."""

STOP_SECONDS = 600.0
"""Maximum time for actors to reach a checkpoint."""

HEAR_SECONDS = 5.0
"""Maximum time for a living actor to answer that it will stop."""


class Ray(Launcher):
    """Starts actors, and waits for them."""

    is_awaited = True

    def __init__(self, config: RayConfig):
        self._config = config
        self._actors: list[Any] = []
        self._calls: dict[Any, tuple[Any, int | None]] = {}  # the actor and the share of each pending call
        self._shares: deque[int] = deque()
        self._idle: list[Any] = []
        self._refusing: set[Any] = set()
        self._has_connected = False
        self._address: str | None = None
        self._lost_since: float | None = None

    @override
    def check(self, name: str) -> None:
        ray = _ray()
        if ray.is_initialized():
            return
        is_main = threading.current_thread() is threading.main_thread()
        handler = signal.getsignal(signal.SIGTERM) if is_main else None
        # Without an address, Ray would look for the last cluster of this machine, which may have ended.
        where = self._config.address or os.environ.get("RAY_ADDRESS") or LOCAL
        advice = "start one with `ray start --head`, or leave out the address to use this machine"
        try:
            if _answers(where):
                advice = "if it asks for a token, set RAY_AUTH_MODE=token"
            _connect(where)
            self._has_connected = True
        except Exception as error:
            reason = f"no Ray cluster at {where} ({error_line(error)}); {advice}"
            if where == LOCAL:
                reason = f"Ray cannot start on this machine ({error_line(error)})"
            raise EngineError(f"--launcher ray: {reason}") from error
        if handler is not None:  # Ray's own would end this process at once
            signal.signal(signal.SIGTERM, handler)
        self._address = ray.get_runtime_context().gcs_address
        self._shape(ray.cluster_resources(), len(ray.nodes()))  # refuses settings that do not fit the cluster

    @override
    def start(self, name: str, folders: Sequence[Path], groups: int, chunks: int) -> None:
        ray = _ray()
        self._paths = [str(folder.absolute()) for folder in folders]
        workers, self._options, self._cores = self._shape(ray.cluster_resources(), len(ray.nodes()))
        if not self._actors:
            print(f"{workers} workers on Ray", file=sys.stderr)
            options = {"max_restarts": -1, "max_concurrency": 2, **self._options}
            self._actors = [ray.remote(_Actor).options(**options).remote() for _ in range(workers)]
        self._count = num_shares(workers, groups, chunks)
        self._shares, self._idle, self._refusing = deque(range(self._count)), [], set()
        self._calls = {actor.__ray_ready__.remote(): (actor, None) for actor in self._actors}

    def _shape(self, resources: dict[str, float], num_nodes: int) -> tuple[int, dict[str, Any], int | None]:
        """Number of actors, what each needs, and its number of cores."""
        config, gpus, cpus = self._config, int(resources.get("GPU", 0)), int(resources.get("CPU", 0))
        if gpus and config.cpus_per_worker is None:
            # The actors of a machine share its cores.
            return config.workers or gpus, {"num_gpus": 1, "num_cpus": 0}, max(1, cpus // gpus)
        cores = config.cpus_per_worker or max(1, cpus // num_nodes)
        if cores > cpus:
            raise EngineError(f"--launcher ray: cpus_per_worker: got {cores}; allowed: at most {cpus}")
        options = {"num_cpus": cores, "num_gpus": 0, "runtime_env": {"env_vars": {"JAX_PLATFORMS": "cpu"}}}
        return config.workers or max(1, cpus // cores), options, cores

    @override
    def keep(self) -> bool:
        if self._address is not None and (reason := self._lost()):
            return not self._is_over(reason)
        self._lost_since = None
        ray = _ray()
        ended, _ = ray.wait(list(self._calls), num_returns=len(self._calls), timeout=0.0)
        for call in ended:
            actor, share = self._calls.pop(call)
            try:
                told = ray.get(call)
            except ray.exceptions.RayError as problem:
                is_lost = isinstance(problem, ray.exceptions.RayActorError) and not problem.actor_init_failed
                if not is_lost:
                    lines = str(problem).strip().splitlines() or [error_line(problem)]
                    reason = f"--launcher ray: a worker cannot run: {lines[-1]}"  # the end of Ray's traceback
                    raise EngineError(reason, FAILURE) from problem
                self._calls[actor.__ray_ready__.remote()] = actor, None  # once Ray has started it again
            else:
                if share is None or told is None:
                    self._idle.append(actor)
                    continue
                self._refusing.add(actor)
                say(f"a worker has left: {told}")
            if share is not None:
                self._shares.appendleft(share)
        while self._shares and self._idle:
            actor, share = self._idle.pop(), self._shares.popleft()
            self._calls[actor.work.remote(self._paths, share, self._count, self._cores)] = actor, share
        self.all_refused = self._refusing == set(self._actors)
        is_busy = any(share is not None for _, share in self._calls.values())
        return not self.all_refused and (bool(self._shares) or is_busy)

    def _is_over(self, reason: str) -> bool:
        """Whether a cluster that is lost has been so for `LOST_SECONDS`; it is given up then."""
        self._lost_since = self._lost_since or time.monotonic()
        if time.monotonic() - self._lost_since < LOST_SECONDS:
            return False
        print(f"error: --launcher ray: the cluster at {self._address} {reason}", file=sys.stderr)
        self._has_connected, self.all_refused = False, True
        self._actors.clear()
        self._calls.clear()
        return True

    def _lost(self) -> str | None:
        """Why no actor can run; None if one can.

        Nothing may be asked of a cluster that does not answer: Ray would wait, and end this process.
        """
        try:
            _answers(self._address)
        except OSError:
            return "does not answer any more"
        found = _ray().cluster_resources()
        needed = {"CPU": self._options["num_cpus"], "GPU": self._options["num_gpus"]}
        if any(found.get(name, 0.0) < number for name, number in needed.items()):
            return "has no node for a worker any more"
        return None

    @override
    def close(self) -> None:
        if not self._has_connected and not self._actors:
            return
        ray = _ray()
        told = {actor.stop.remote(): actor for actor in self._actors}
        if told:
            heard, _ = ray.wait(list(told), num_returns=len(told), timeout=HEAR_SECONDS)
            alive = [told[call] for call in heard]  # others may wait for a node that is gone
            calls = [call for call, (actor, _) in self._calls.items() if actor in alive]
            if calls:
                ray.wait(calls, num_returns=len(calls), timeout=STOP_SECONDS)
        for actor in self._actors:
            ray.kill(actor)
        self._actors.clear()
        self._calls.clear()
        if self._has_connected:
            self._has_connected = False
            ray.shutdown()


class _Actor:
    """A worker in a process of Ray."""

    def __init__(self):
        gpu_allocator.choose()  # JAX has not started in this process
        self._is_stopping = False

    def work(self, folders: Sequence[str], share: int, count: int, cores: int | None) -> str | None:
        """Run a share of the chunks, and return the error for which the worker left early, in one line."""
        from bojax.engine.worker import EXPECTED, run_worker

        paths = [Path(folder) for folder in folders]
        try:
            run_worker(paths, lambda: self._is_stopping, cores=cores, share=(share, count))
        except EXPECTED as problem:
            return f"{socket.gethostname()}: {problem}"
        return None

    def stop(self) -> None:
        """Make `work` stop at a checkpoint."""
        self._is_stopping = True


def _connect(address: str) -> None:
    """Connect this process to a cluster, or start one.

    Raises:
        Exception: As Ray raises them.
        TimeoutError: The cluster does not let this process in. Ray would try for minutes.
    """
    init = functools.partial(_ray().init, address, namespace=NAMESPACE, logging_level=logging.ERROR)
    if address == LOCAL:  # the processes that Ray starts end with the thread that has started them
        init()
        return
    connected: Future[None] = Future()

    def connect() -> None:
        try:
            init()
            connected.set_result(None)
        except BaseException as error:
            connected.set_exception(error)

    threading.Thread(target=connect, daemon=True).start()
    try:
        connected.result(CONNECT_SECONDS)
    except TimeoutError as error:
        raise TimeoutError(f"no connection within {CONNECT_SECONDS:.0f} s") from error


def _answers(address: str | None) -> bool:
    """Whether an address is of the form `host:port`, and something answers there.

    Raises:
        OSError: Nothing answers. Ray would try for minutes.
    """
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if not (host and port.isdecimal()):
        return False
    socket.create_connection((host.strip("[]"), int(port)), REACH_SECONDS).close()
    return True


def _ray() -> Any:
    with needed("ray", "ray"):
        return importlib.import_module("ray")
