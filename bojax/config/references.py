"""References in explanations: text in braces that stands for a number or a verdict of results.

`{kcbts: return}` is a mean over runs, and `{claim fig-4.4/order: verdict}` a verdict.
`{study-x / kcbts: return}` is of another sweep. `{thesis 93%}` and `{setting 0.5}` stand for themselves: they
are no results.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar, get_args

ClaimKey = Literal["verdict", "here", "interval", "share"]
"""What a reference to a claim stands for: its verdict, its value here, the interval that decides it, or the
share of configurations in which it holds."""

_ALLOWED = (
    "{POINT: COLUMN}, {POINT: COLUMN at step N}, {POINT: COLUMN of episodes N-M} or {claim ID: verdict}, "
    "each also of another sweep, {SWEEP / ...}; {thesis TEXT} or {setting TEXT}"
)

_BRACES = re.compile(r"\{([^{}]*)\}")
_LITERAL = re.compile(r"(?:thesis|setting) (.+)")
_TARGET = re.compile(r"(?:(?P<sweep>\S+) / )?(?P<claim>claim )?(?P<name>.+): (?P<what>.+)")
_COLUMN = re.compile(
    r"(?P<column>\w+)(?: at step (?P<step>\d+)| of (?P<phase>episodes|tests) (?P<first>\d+)-(?P<last>\d+))?"
)


class Place(Protocol):
    """A point of a sweep, or of its results."""

    @property
    def label(self) -> str:
        """Identifier of its planner or learner."""
        ...

    @property
    def variant(self) -> str:
        """Its name in the sweep."""
        ...

    @property
    def swept(self) -> Mapping[str, Any]:
        """The value of every swept key, by dotted path."""
        ...


P = TypeVar("P", bound=Place)


@dataclass(frozen=True)
class Mean:
    """The mean of a column over the runs of a point; the column `runs` is their number."""

    sweep: str  # empty for the sweep of the explanation
    point: str  # a variant or label, with swept values: `kcbts, length 2`
    column: str
    step: int | None = None  # of `steps.parquet`, instead of `runs.parquet`
    episodes: tuple[int, int] | None = None  # first and last of `episodes.parquet`, instead of `runs.parquet`
    phase: Literal["train", "test"] = "train"  # of these episodes


@dataclass(frozen=True)
class OfClaim:
    """A value of a claim."""

    sweep: str  # empty for the sweep of the explanation
    claim: str  # its id
    key: ClaimKey


Reference = Mean | OfClaim


def pieces(text: str) -> Iterator[str | Reference]:
    """The text and the references of an explanation, in order; a ValueError if braces hold anything else."""
    end = 0
    for match in _BRACES.finditer(text):
        yield _outside(text[end : match.start()])
        yield _read(" ".join(match[1].split()))
        end = match.end()
    yield _outside(text[end:])


def references(text: str) -> list[Reference]:
    """The references of an explanation; a ValueError if braces hold anything else."""
    return [piece for piece in pieces(text) if not isinstance(piece, str)]


def matching(points: Sequence[P], name: str) -> list[P]:
    """The points that a reference names: by variant, or else by label, and by swept values."""
    variant, *values = [name] if any(point.variant == name for point in points) else name.split(", ")
    named = [point for point in points if point.variant == variant]
    named = named or [point for point in points if point.label == variant]
    return [point for point in named if all(_has(point, value) for value in values)]


def _outside(text: str) -> str:
    if "{" in text or "}" in text:
        raise ValueError("got a brace without its counterpart")
    return text


def _read(inside: str) -> str | Reference:
    if literal := _LITERAL.fullmatch(inside):
        return literal[1]
    target = _TARGET.fullmatch(inside)
    sweep, what = (target["sweep"] or "", target["what"]) if target else ("", "")
    if target and target["claim"]:
        for key in get_args(ClaimKey):
            if what == key:
                return OfClaim(sweep, target["name"], key)
        raise ValueError(f"got {{{inside}}}; allowed after the colon: {', '.join(get_args(ClaimKey))}")
    if not target or not (column := _COLUMN.fullmatch(what)):
        raise ValueError(f"got {{{inside}}}; allowed: {_ALLOWED}")
    step, window = column["step"], (column["first"], column["last"])
    return Mean(
        sweep,
        target["name"],
        column["column"],
        int(step) if step else None,
        (int(window[0]), int(window[1])) if window[0] else None,
        "test" if column["phase"] == "tests" else "train",
    )


def _has(point: Place, text: str) -> bool:
    """Whether a point has a swept value, written as in the names of reports: `length 2`."""
    key, _, value = text.rpartition(" ")
    found = [each for path, each in point.swept.items() if path == key or path.rsplit(".", 1)[-1] == key]
    return any((f"{each:g}" if isinstance(each, float) else str(each)) == value for each in found)
