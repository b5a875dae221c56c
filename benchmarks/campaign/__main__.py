"""`python -m benchmarks.campaign`: runs the cases and prints how many held; exit code 1 if any fell short."""

import argparse
import importlib
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.campaign.case import Outcome

KINDS = {
    **{"configs": 600, "kills": 110, "launches": 100, "damage": 220, "disk": 24, "results": 150},
    **{"numbers": 60, "environment": 80, "caches": 80, "terminals": 40, "comparisons": 100, "clusters": 80},
}
"""Kinds of cases, each a module of this package, with how many are run by default."""

QUICK = {
    "configs": (2, 6, 7, 11, 13, 17, 22, 30, 39, 46, 59, 66),
    "kills": (1,),
    "damage": (1, 9, 27),
    "disk": (1,),
}
"""Seeds of the cases that `make slow` runs as well: one family of inputs each, and the quickest sweep."""

_CASES_PER_SEED = 1_000_000


def main() -> int:
    """Run what the command line asks for."""
    args = _arguments()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell or nohup may have them ignored
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("MPLBACKEND", "agg")
    os.environ.setdefault("BOJAX_CACHE", str(Path(__file__).parents[2] / ".pytest_cache" / "jax"))
    from benchmarks.campaign.case import Tally, table
    from benchmarks.campaign.process import import_all

    import_all()
    tallies: dict[str, Tally] = {}
    for kind, seeds in _wanted(args).items():
        check = importlib.import_module(f"benchmarks.campaign.{kind}").check
        start, short = time.monotonic(), []
        for number, seed in enumerate(seeds, 1):
            outcome = _checked(check, seed)
            if args.case or args.verbose:
                print(f"{kind}:{seed}  {outcome.tried}", flush=True)
            if outcome.fault:
                short.append((seed, outcome))
                print(f"\r--case {kind}:{seed}  {outcome.tried}\n    {outcome.fault}", flush=True)
            if sys.stderr.isatty():
                spent = time.monotonic() - start
                print(f"\r{kind} {number}/{len(seeds)}, {spent:.0f} s", end="", file=sys.stderr, flush=True)
        tallies[kind] = Tally(len(seeds), short)
    print(f"\n{table(tallies, markdown=args.markdown)}")
    if args.markdown:
        print(f"\n{time.strftime('%d %B %Y')}, commit `{_commit()}`, seed {args.seed}.")
    failed = any(tally.short for tally in tallies.values())
    if failed:
        print("\nto run a case again: python -m benchmarks.campaign --case KIND:SEED")
    return int(failed)


def _wanted(args: argparse.Namespace) -> Mapping[str, Sequence[int]]:
    """The seeds to run, by kind."""
    if args.quick:
        return QUICK
    if args.case:
        kind, _, seed = args.case.partition(":")
        return {kind: [int(seed)]}
    first = args.seed * _CASES_PER_SEED
    counts = {kind: count if args.count is None else args.count for kind, count in KINDS.items()}
    return {kind: range(first, first + counts[kind]) for kind in ([args.only] if args.only else KINDS)}


def _checked(check: "Callable[[int], Outcome]", seed: int) -> "Outcome":
    """The outcome of a case; a mistake in the campaign itself falls short too, and does not end it."""
    from benchmarks.campaign.case import Outcome

    try:
        return check(seed)
    except Exception:
        return Outcome("", f"the case itself failed: {traceback.format_exc()}")


def _commit() -> str:
    """The commit that is checked out, marked if files have changed since."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=10", "--exclude=*"]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip() or "unknown"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign", description=__doc__)
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of all cases; 0")
    parser.add_argument("--only", choices=KINDS, help="cases of this kind alone")
    parser.add_argument("--count", type=int, metavar="N", help="cases of each kind")
    parser.add_argument("--case", metavar="KIND:SEED", help="one case, as a failure names it")
    parser.add_argument("--quick", action="store_true", help="the few cases that `make slow` runs")
    parser.add_argument("--verbose", action="store_true", help="print what each case tries")
    parser.add_argument("--markdown", action="store_true", help="print the table in Markdown")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
