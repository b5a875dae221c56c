"""What a case of the campaign is: its outcome, the judgement of how a command ended, and the final table."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.campaign.process import ChildResult

MAX_LINE = 420
"""Longest error message, in characters."""

_TRACEBACK = "Traceback (most recent call last)"


@dataclass(frozen=True)
class Outcome:
    """How a case ended."""

    tried: str  # what was done, in a few words
    fault: str = ""  # why it fell short; empty if it held


@dataclass(frozen=True)
class Tally:
    """The cases of one kind: the number tried, and the seed and outcome of each that fell short."""

    tried: int
    short: Sequence[tuple[int, Outcome]]


def fault_of(ended: ChildResult, codes: Iterable[int], *, alone: bool = False) -> str:
    """Why the end of a command falls short; empty if it ended with one of `codes`, and said so properly.

    Args:
        ended: How the command ended.
        codes: The exit codes that are allowed.
        alone: Whether nothing but the error, and notes before it, may stand on the standard error stream.
    """
    lines = [line for line in ended.err.splitlines() if not line.startswith("note: ")]
    errors = [line for line in lines if line.startswith("error: ")]
    if ended.is_late:
        return f"not over after {ended.wall:.0f} s"
    if _TRACEBACK in ended.err:
        return f"traceback: {raised(ended.err)}"
    if ended.code not in codes:
        return f"exit code {ended.code}: {(errors or lines or [''])[-1][:200]}"
    if ended.code < 0 or ended.code > 128:
        return ""  # a signal needs no error
    if ended.code == 0:
        return f"an error, and exit code 0: {errors[0][:200]}" if errors else ""
    if len(errors) != 1 or (alone and len(lines) != 1):
        return f"exit code {ended.code} with {len(lines)} lines, {len(errors)} of them errors: {lines[-3:]}"
    if len(errors[0]) > MAX_LINE:
        return f"a message of {len(errors[0])} characters: {errors[0][:120]}..."
    if unprintable := re.sub(r"[^\x00-\x1f\x7f-\x9f\ud800-\udfff]", "", errors[0]):
        return f"the message holds {unprintable!r}"
    return ""


def is_whole(page: Path) -> bool:
    """Whether a page of HTML is there from its beginning to its end."""
    return page.is_file() and page.read_text().rstrip().endswith("</html>")


def raised(text: str) -> str:
    """The exception that the last traceback in a text ends with, and the place in bojax that raised it."""
    _, _, last = text.rpartition(_TRACEBACK)
    ends = [line for line in last.splitlines()[1:] if line[:1].strip()]
    frames = re.findall(r'File ".*?/(bojax/\S+)", line (\d+)', last)
    where = f" ({frames[-1][0]}, line {frames[-1][1]})" if frames else ""
    return f"{(ends or [''])[0][:200]}{where}"


def table(tallies: Mapping[str, Tally], *, markdown: bool) -> str:
    """Tried, held and fell short by kind."""
    rows = [("kind", "tried", "held", "fell short")]
    rows += [
        (kind, str(tally.tried), str(tally.tried - len(tally.short)), str(len(tally.short)))
        for kind, tally in tallies.items()
    ]
    if markdown:
        lines = [f"| {' | '.join(row)} |" for row in rows]
        return "\n".join([lines[0], "|---|---|---|---|", *lines[1:]])
    return "\n".join(f"{kind:<10}{tried:>8}{held:>8}{short:>12}" for kind, tried, held, short in rows)
