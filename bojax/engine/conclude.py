"""How sweeps end: merged and finished, failed in part, or interrupted."""

import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bojax.config.errors import printable
from bojax.engine.journal import Journal
from bojax.results.merge import runs_ignoring_samples


def conclude(journal: Journal, say: Callable[[str], Any], finish: Callable[[Path], Any]) -> None:
    """Merge a sweep, tell how it ended, and finish it unless it failed."""
    journal.merge()
    if journal.nans:
        say(f"warning: {len(journal.nans)} runs contain NaN: see column nans of runs.parquet")
    if ignoring := runs_ignoring_samples(journal.path):
        say(f"warning: {ignoring} runs left out samples: see column ignored_samples of runs.parquet")
    print(journal.path)
    if journal.errors:
        reasons = dict.fromkeys(journal.errors.values())
        failed = f"{len(journal.errors)} of {len(journal.plan.chunks)} chunks failed"
        advice = "run again with --resume to retry them, or without it if you change the code"
        say(printable(f"error: {failed}: {'; '.join(reasons)}: {advice}"))
    else:
        finish(journal.path)


def interrupt(journals: Sequence[Journal], command: Sequence[str]) -> None:
    """Note that sweeps were interrupted, and print the command that resumes them."""
    for journal in journals:
        if not journal.is_merged:
            journal.write_manifest("interrupted")
    again = resuming(command, [journal.path for journal in journals])
    print(f"interrupted; to resume:\n  {again}", file=sys.stderr)


def resuming(command: Sequence[str], paths: Sequence[Path]) -> str:
    """The command that resumes the sweeps in results folders."""
    given = list(command)
    if len(paths) == 1 and not any(word == "--out" or word.startswith("--out=") for word in given):
        given += ["--out", str(paths[0])]
    if "--resume" not in given:
        given.append("--resume")
    return shlex.join(given)
