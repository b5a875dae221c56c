"""`bojax worker`: runs a share of the chunks of sweeps, which another process merges."""

import signal
import sys
from argparse import ArgumentTypeError
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bojax.cli.parser import Parser, at_least, path

if TYPE_CHECKING:
    from bojax.engine.signals import StopRequest

REQUEUE = signal.SIGUSR2
"""The signal that Slurm sends when the time limit is near; the batch script requeues the task then."""

_EXAMPLES = """\
  bojax worker results/parking/big                 all chunks that are left
  bojax worker results/parking/big --share 1/4     the second quarter of them, on this or another machine
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command: 0; 1 if a chunk failed; 2 for a wrong input; 128 and its number after a signal."""
    args = _parser(name).read(words)
    from bojax.engine.signals import SIGNALS, StopRequest

    signals = (*SIGNALS, REQUEUE)
    with StopRequest(announce=lambda _: None, signals=signals) as stop:
        from bojax.engine.worker import guarded, run_worker

        if stop:
            return _stopped(stop)
    options = {"devices": args.devices, "cores": args.cores, "share": args.share}
    with StopRequest(signals=signals) as stop:
        code = guarded(lambda: run_worker(args.folders, stop.__bool__, **options))
        return _stopped(stop) if stop else code


def _stopped(stop: "StopRequest") -> int:
    print("stopped at a checkpoint; a worker with this share, or --resume, goes on", file=sys.stderr)
    return stop.exit_code


def device_indices(text: str) -> list[int]:
    """Indices of devices, such as `0,2`."""
    try:
        indices = [int(word) for word in text.split(",")]
    except ValueError:
        indices = []
    if not indices or min(indices) < 0 or len(set(indices)) < len(indices):
        raise ArgumentTypeError(f"got {text}; allowed: different indices from 0, such as 0,2")
    return indices


def _share(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and int(number) < int(count)):
        raise ArgumentTypeError(f"got {text}; allowed: NUMBER/COUNT with a number from 0, such as 0/4")
    return int(number), int(count)


def _parser(name: str) -> Parser:
    parser = Parser(
        name,
        "DIR... [--devices I,J] [--cores N] [--share NUMBER/COUNT]",
        "Run chunks of sweeps that `bojax sweep` or `bojax reproduce` has started and no longer\n"
        "runs, on this machine or on another one that shares their folders. Each worker runs a share of\n"
        "the chunks. The command that started the sweeps merges them, with --resume.",
        _EXAMPLES,
    )
    parser.option("folders", "DIR", "results folder of the sweep", path, nargs="+")
    parser.option("--devices", "I,J", "indices of the GPUs to use (default: all)", device_indices)
    parser.option("--cores", "N", "number of CPU cores to use (default: all)", at_least(1))
    share = "which share of the chunks to run, from 0: 1/4 is the second of four (default: all)"
    parser.option("--share", "NUMBER/COUNT", share, _share, default=(0, 1))
    return parser
