"""Running sweeps by workers that a launcher starts. This process merges, and needs no device."""

import abc
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax

from bojax.config.errors import say
from bojax.config.saved_sweep import saved
from bojax.engine.chunks import Chunk
from bojax.engine.devices import prepare
from bojax.engine.errors import EngineError
from bojax.engine.plan import plain, plan_made_elsewhere
from bojax.engine.sweep_run import Invocation, SweepRun
from bojax.engine.targets import Target, plan_unfinished
from bojax.errors import FAILURE
from bojax.results.folder import RunFolder, check_plan
from bojax.results.status import status_of
from bojax.results.store import MANIFEST, ResultsError, read_json

POLL_SECONDS = 1.0
"""Time between two looks at the folders."""

TELL_SECONDS = 10.0
"""Time between two lines of progress."""

LATE_SECONDS = 60.0
"""Time after which a file of a worker is visible here: NFS keeps what it knows of a folder for so long."""

SHARES_PER_WORKER = 4
"""Maximum number of shares for each worker. At the end, a worker idles for one share at most."""


def num_shares(workers: int, groups: int, chunks: int) -> int:
    """Number of shares that the chunks that are left are divided into, each run by one worker at a time.

    A worker that has finished a share is given another one by Ray or Slurm, so that more shares than workers
    balance the load. Every share compiles the programs of its groups, and shares that follow one another hold
    whole groups where there are more groups than shares: so there are no more shares than groups, unless a
    worker would have none.
    """
    return min(SHARES_PER_WORKER * workers, max(workers, groups), chunks)


class Launcher(abc.ABC):
    """Starts workers on other machines, or further processes of this one, until it is closed."""

    # Whether the driver waits for the workers, and merges at the end. Otherwise it ends once they are
    # submitted, and merges when it is started again with `--resume`
    is_awaited: bool
    all_refused: bool = False  # whether every worker has left with an error

    @abc.abstractmethod
    def check(self, name: str) -> None:
        """Check, before anything is written, that workers can be started.

        Raises:
            EngineError: The launcher is missing on this machine, or refuses its settings.
        """

    def has_begun(self, folders: Sequence[Path]) -> bool:
        """Whether workers of an earlier launch still run these sweeps, so that none are started."""
        return False

    @abc.abstractmethod
    def start(self, name: str, folders: Sequence[Path], groups: int, chunks: int) -> None:
        """Start workers for the sweeps in these folders, or give these sweeps to those that wait for work.

        The folders have the launch already. `groups` counts the static groups of all sweeps that have chunks
        left, and `chunks` these chunks: an upper bound as long as no worker has planned a sweep.

        Raises:
            EngineError: They cannot be started.
        """

    def keep(self) -> bool:
        """Replace lost workers, and return whether any worker is alive."""
        return False

    def close(self) -> None:
        """Make the workers stop at a checkpoint, and wait for them."""
        return

    def __enter__(self) -> "Launcher":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(eq=False)
class _Remote:
    """A sweep that workers run."""

    target: Target  # the sweep and its folder
    chunks: Sequence[Chunk]  # the chunks of the plan for a CPU; a worker's plan may have fewer
    run: SweepRun | None = None  # the sweep in its folder, open once a worker has planned it


def run_remotely(targets: Sequence[Target], invocation: Invocation, launcher: Launcher) -> int:
    """Start workers for sweeps, merge those whose chunks have ended, and return the exit code.

    The launcher is closed unless all chunks have ended: its workers may wait for other sweeps.
    """
    prepare("cpu")
    names = ", ".join(target.sweep.name for target in targets)
    launcher.check(names)
    # What is wrong with a sweep shows before the launch.
    unfinished = plan_unfinished(targets, jax.devices("cpu")[:1], invocation.finish)
    remotes = [_Remote(_open(target), plan.chunks) for target, plan in unfinished]
    try:
        return _run(remotes, names, invocation, launcher) if remotes else 0
    finally:
        for remote in remotes:
            if remote.run is not None:
                remote.run.folder.close(finished=False)


def _open(target: Target) -> Target:
    """Create the results folder, or check that it belongs to the sweep; return it with its final name."""
    folder, sweep = RunFolder(target.path), plain(saved(target.sweep))
    if target.is_resumed:
        try:
            before, now = _asked_for(folder.launched().sweep), _asked_for(sweep)
        except ResultsError:  # a driver was lost before it wrote the file, or the file is damaged
            before, now = _described(folder.plan() or sweep), _described(sweep)
        check_plan(folder.path, before, now)
    else:
        folder.create(None, may_rename=target.may_rename)
    folder.close(finished=False)
    return replace(target, path=folder.path, is_resumed=True)


def _asked_for(sweep: dict[str, Any]) -> dict[str, Any]:
    """The values that must be equal when a sweep is resumed."""
    kept = {name: sweep[name] for name in ("runs", "seed", "record", "config", "points")}
    return {**kept, "engine.lanes_per_device": sweep["engine"]["lanes_per_device"]}


def _described(content: dict[str, Any]) -> dict[str, Any]:
    """The values that a sweep shares with its plan, without settings of points, which workers resolve."""
    kept = {name: content[name] for name in ("runs", "seed", "record", "config")}
    return {**kept, "points": [{**point, "config": None} for point in content["points"]]}


def _run(remotes: Sequence[_Remote], names: str, invocation: Invocation, launcher: Launcher) -> int:
    paths, waiting = [remote.target.path for remote in remotes], list(remotes)
    _merge_ended(waiting, invocation)
    if waiting:
        try:
            folders = [remote.target.path for remote in waiting]
            if not launcher.has_begun(folders):
                left = [_launch(remote) for remote in waiting]
                groups = sum(len({chunk.group for chunk in chunks}) for chunks in left)
                launcher.start(names, folders, groups, sum(map(len, left)))
            if not launcher.is_awaited:
                folders = shlex.join(map(str, paths))
                print(f"progress:  bojax status {folders}\nto merge:  {invocation.resuming(paths)}")
                return 0
            _wait(waiting, invocation, launcher)
        finally:
            if waiting:
                launcher.close()
    runs = [remote.run for remote in remotes if remote.run is not None]
    if not invocation.stop and (len(runs) < len(remotes) or any(run.merged is None for run in runs)):
        raise EngineError(f"the workers have ended early; to go on: {invocation.resuming(paths)}", FAILURE)
    return invocation.exit_code(runs)


def _plan(remote: _Remote, invocation: Invocation) -> None:
    """Open a sweep that a worker has planned."""
    folder = RunFolder(remote.target.path)
    content = folder.plan()
    if content is None or remote.run is not None:
        return
    plan = plan_made_elsewhere(remote.target.sweep, content, folder.device())
    run = SweepRun(plan, remote.target, invocation.command)
    # Failed chunks are retried only after a merge without them, which sets this status and reports them.
    manifest = remote.target.path / MANIFEST
    run.open(retry=manifest.exists() and read_json(manifest).get("status") == "failed")
    remote.run = run


def _launch(remote: _Remote) -> Sequence[Chunk]:
    """Write what workers need to know: the sweep, and the chunks that are left, which are returned."""
    left = None if remote.run is None else remote.run.left
    indices = None if left is None else [chunk.index for chunk in left]
    RunFolder(remote.target.path).launch(plain(saved(remote.target.sweep)), indices)
    return remote.chunks if left is None else left


def _merge_ended(waiting: list[_Remote], invocation: Invocation) -> None:
    """Merge each sweep whose chunks are all done or have failed, and take it off the list."""
    for remote in list(waiting):
        _plan(remote, invocation)
        if remote.run is not None:
            remote.run.attempts.look()
            if not remote.run.left:
                waiting.remove(remote)
                remote.run.finalise(say, invocation.finish)


def _wait(waiting: list[_Remote], invocation: Invocation, launcher: Launcher) -> None:
    """Merge sweeps as their chunks end.

    What the last workers wrote may become visible some time after they have left.
    """
    told, left = time.monotonic(), None
    while waiting and not invocation.stop:
        if launcher.keep():
            left = None
        elif left is None:
            left = time.monotonic()
        if time.monotonic() - told > TELL_SECONDS:
            told = time.monotonic()
            for remote in waiting:
                print(status_of(remote.target.path).summary, file=sys.stderr)
        _merge_ended(waiting, invocation)
        if left is not None and (launcher.all_refused or time.monotonic() - left > LATE_SECONDS):
            return
        end = time.monotonic() + POLL_SECONDS
        while waiting and time.monotonic() < end and not invocation.stop:
            time.sleep(0.05)
