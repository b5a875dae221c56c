"""`bojax worker`: runs chunks of sweeps that another process has started and will merge."""

import os
import signal
import subprocess
import sys
from argparse import ArgumentTypeError
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bojax.cli.parser import Parser, integer, path

if TYPE_CHECKING:
    from bojax.engine.signals import StopRequest

REQUEUE = signal.SIGUSR2
"""The signal that the batch script of Slurm asks for when the time limit is near."""

_EXAMPLES = """\
  bojax worker results/parking/big                 beside the driver, or on another machine with this folder
  bojax worker results/parking/big --devices 1     on the second GPU only
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command: 0; 1 if a chunk failed; 2 for a wrong input; 128 and its number after a signal."""
    args = _parser(name).parse_intermixed_args(list(words))
    from bojax.engine.signals import SIGNALS, StopRequest

    signals = (*SIGNALS, REQUEUE)
    with StopRequest(announce=lambda _: None, signals=signals) as stop:
        from bojax.engine.worker import WorkerOptions, guarded, run_worker

        if stop:
            return _stopped(stop)
    number, count = args.share
    options = WorkerOptions(args.devices, args.cores, number, count)
    with StopRequest(signals=signals) as stop:
        code = guarded(lambda: run_worker(args.folders, options, stop.__bool__))
        return _stopped(stop) if stop else code


def _stopped(stop: "StopRequest") -> int:
    """Requeue the task if Slurm asked for it, and return the exit code of the signal."""
    job = os.environ.get("SLURM_JOB_ID")
    if stop.signum == REQUEUE and job:
        # Slurm ends this process, and starts the task again once there is a node.
        subprocess.run(["scontrol", "requeue", job], check=False)
    print("stopped; other workers or --resume go on", file=sys.stderr)
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


def _cores(text: str) -> int:
    number = integer(text)
    if number < 1:
        raise ArgumentTypeError(f"got {text}; allowed: >= 1")
    return number


def _parser(name: str) -> Parser:
    parser = Parser(
        prog=f"bojax {name}",
        usage=f"bojax {name} DIR... [--devices I,J] [--cores N] [--share NUMBER/COUNT]",
        description="Run chunks of sweeps that `bojax sweep` or `bojax reproduce` has started, on this\n"
        "machine or on another one that shares their folders. Several workers share the chunks; the\n"
        "process that started the sweeps merges them.",
        examples=_EXAMPLES,
    )
    parser.add_argument("folders", nargs="+", type=path, metavar="DIR", help="results folder of the sweep")
    parser.add_argument(
        "--devices", type=device_indices, metavar="I,J", help="indices of the GPUs to use (default: all)"
    )
    parser.add_argument("--cores", type=_cores, metavar="N", help="number of CPU cores to use (default: all)")
    parser.add_argument(
        "--share",
        type=_share,
        default=(0, 1),
        metavar="NUMBER/COUNT",
        help="which of several workers this is, from 0: they start with different chunks",
    )
    return parser
