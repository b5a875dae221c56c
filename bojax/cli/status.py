"""`bojax status`: which chunks of a sweep are done, running, lost or failed."""

import os
from collections.abc import Sequence
from pathlib import Path

from bojax.cli.parser import Parser, path
from bojax.config.errors import printable
from bojax.text import duration

MOST_LINES = 20
"""Number of chunks of each kind that are listed one by one."""

_EXAMPLES = """\
  bojax status results/parking/big         progress of a sweep, from any machine that has the folder
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command; the exit code is 1 if a chunk failed."""
    parser = Parser(
        name, "DIR...", "Show which chunks of a sweep are done, running, lost or failed.", _EXAMPLES
    )
    parser.option("folders", "DIR", "results folder of a sweep", path, nargs="+")
    args = parser.read(words)
    has_failed = False
    for folder in args.folders:
        lines, failed = describe(folder)
        print("\n".join(map(printable, lines)))
        has_failed |= failed
    return 1 if has_failed else 0


def describe(folder: Path) -> tuple[list[str], bool]:
    """Return the status report as lines, and whether any chunk failed.

    Raises:
        ResultsError: The folder is not that of a sweep.
    """
    from bojax.results.folder import is_unfinished
    from bojax.results.status import OpenAttempt, status_of
    from bojax.results.store import MANIFEST, OUTPUT, WORK, read_manifest

    if not is_unfinished(folder) and os.path.lexists(folder / MANIFEST):
        return [f"{folder}: {read_manifest(folder).get('status')}"], False
    status = status_of(folder)

    def about(each: OpenAttempt) -> str:
        silence = "its process is gone" if each.is_gone else f"last wrote {duration(each.silence)} ago"
        runs = f"({each.runs} runs), attempt {each.attempt}, {each.owner}, for {duration(each.age)}"
        return f"{each.chunk} {runs}, {silence}"

    kinds = {
        "running": [about(each) for each in status.running],
        "lost": [about(each) for each in status.lost],
        "failed": [f"{chunk}: {reason}" for chunk, reason in status.failed.items()],
    }
    found = [f"{folder}: {status.summary}"]
    for kind, chunks in kinds.items():
        found += [f"{kind}: chunk {each}" for each in chunks[:MOST_LINES]]
        found += [f"{kind}: {len(chunks) - MOST_LINES} more"] * (len(chunks) > MOST_LINES)
    if status.chunks and status.done == status.chunks:
        found.append("all chunks are done; the command that started the sweep merges them, with --resume")
    elif status.seconds_left is not None and status.running:
        found.append(f"about {duration(status.seconds_left)} left with {len(status.running)} at a time")
    if status.done < max(1, status.chunks) and not status.running:
        outputs = sorted((folder / WORK).glob(OUTPUT.format("*")), key=os.path.getmtime)
        found += [f"output of the last task: {path}" for path in outputs[-1:]]
    return found, bool(status.failed)
