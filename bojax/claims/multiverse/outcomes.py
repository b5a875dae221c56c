"""The outcomes of a multiverse analysis: the verdict of each claim in each configuration.

`multiverse.json` grows block by block. An analysis that was interrupted, or that is continued on another
machine from this file alone, ends in the same bytes wherever runs do not depend on their batch: on CPUs of
one kind, and on accelerators of one kind if the blocks are the same.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bojax.claims.multiverse.declaration import AXIS, Declaration
from bojax.config.claims import Claim, EntryClass
from bojax.report import statistics
from bojax.report.findings import evaluate
from bojax.report.manifest import Count, Recorded, validated
from bojax.report.source import Results, load
from bojax.report.verdicts import TestedClaim, Verdict
from bojax.results.store import ResultsError, make_folder, read_json, write_json

FILE = "multiverse.json"

CODES: dict[Verdict, str] = {"reproduced": "r", "not reproduced": "n", "inconclusive": "i"}
FAILED = "x"
"""Code of a claim that a configuration could not test, such as for runs that failed."""


class ClaimOutcomes(Recorded):
    """The outcomes of one claim, in the order of the configurations."""

    id: str
    sweep: str
    entry_class: EntryClass = "claim"  # files of earlier versions have variants and checks too
    own_bound: bool = False
    source: str | None = None
    claim: str
    thesis: Any = None
    verdicts: str = ""  # a letter for each configuration, see `CODES`
    estimates: list[float | None] = []  # of the quantity that decides the claim
    low: list[float | None] = []  # bounds of its interval
    high: list[float | None] = []
    ours: list[float | None] = []  # counterpart of a printed number
    choices: list[str] | None = None  # those that can change it; None if a file does not say so

    def share(self, mask: NDArray[np.bool_] | None = None) -> statistics.Interval:
        """The share of the configurations in which the claim holds, with Wilson's interval."""
        holds = np.frombuffer(self.verdicts.encode(), "S1") == b"r"
        return statistics.share_interval(holds if mask is None else holds[mask])

    def count(self, code: str) -> int:
        """The number of configurations with this code."""
        return self.verdicts.count(code)

    @property
    def strength(self) -> str:
        """How far the claim depends on the choices.

        `robust`: it holds in more than three quarters of the configurations. `contrary`: it holds in less
        than a quarter, and the opposite is shown in more than half. `undecided`: in more than half, it is
        inconclusive or not tested. `fragile`: everything else.
        """
        holds, fails, undecided = (
            sum(map(self.count, codes)) / max(1, len(self.verdicts)) for codes in ("r", "n", "i" + FAILED)
        )
        if holds > 0.75:
            return "robust"
        if holds < 0.25 and fails > 0.5:
            return "contrary"
        return "undecided" if undecided > 0.5 else "fragile"


class Confirmed(Recorded):
    """The sweep's own and the best configuration, on fresh seeds."""

    runs: Count
    seed: Count
    own: dict[str, str]  # verdict of each claim by id, as a code
    best: dict[str, str]


class Multiverse(Recorded):
    """The outcomes of an analysis so far."""

    name: str
    title: str = ""
    reading: str = ""  # a paragraph on the best configuration
    declaration: dict[str, Any]
    configurations: list[list[int]] = []  # value of each choice, by the number of the configuration
    done: list[int] = []  # numbers of the configurations that were evaluated, in ascending order
    claims: list[ClaimOutcomes] = []
    best: int | None = None  # number of the best configuration, once all are evaluated
    confirmed: Confirmed | None = None

    @property
    def levels(self) -> NDArray[np.int64]:
        """The value of each choice in the evaluated configurations, `[configurations, choices]`."""
        return np.asarray(self.configurations, np.int64)[self.done]

    def choices_of(self, claim: ClaimOutcomes) -> dict[str, Any]:
        """The choices that can change a claim, as declared, by name.

        In a fraction of all combinations, choices are confounded with each other: one that concerns other
        sweeps alone would seem to have an effect.
        """
        choices = self.declaration["choices"].items()
        return {name: each for name, each in choices if claim.choices is None or name in claim.choices}

    def holding(self) -> NDArray[np.int64]:
        """The number of claims that hold in each evaluated configuration."""
        table = np.array([[code == "r" for code in claim.verdicts] for claim in self.claims])
        return table.sum(axis=0) if table.size else np.zeros(len(self.done), np.int64)


def begin(declaration: Declaration) -> Multiverse:
    """An analysis without outcomes."""
    irrelevant = {"title", "reading", "block"}  # to the verdicts
    return Multiverse(
        name=declaration.name,
        title=declaration.file.title,
        reading=declaration.file.reading.strip(),
        declaration=declaration.file.model_dump(mode="json", exclude=irrelevant),
        configurations=[list(levels) for levels in declaration.configurations],
    )


def read(folder: Path, declaration: Declaration | None = None) -> Multiverse:
    """The outcomes in a folder, of the given declaration; without a file, an analysis without outcomes."""
    path = folder / FILE
    if declaration is not None and not path.exists():
        return begin(declaration)
    found = validated(Multiverse, read_json(path), str(path))
    found.claims = [claim for claim in found.claims if claim.entry_class == "claim"]
    if declaration is not None and found.declaration != begin(declaration).declaration:
        raise ResultsError(
            f"{path}: was made by another version of {declaration.name}; allowed: the declaration that the "
            "analysis began with, or a new --out"
        )
    if declaration is not None:
        found = _with_declaration(found, declaration)
    lengths = {len(each) for claim in found.claims for each in (claim.verdicts, claim.estimates, claim.ours)}
    if lengths - {len(found.done)}:
        raise ResultsError(f"{path}: is damaged: delete it, and run again with --resume")
    return found


def _with_declaration(multiverse: Multiverse, declaration: Declaration) -> Multiverse:
    """The outcomes with what the declaration says of them, which may have been written since."""
    claims = [
        claim.model_copy(update={"choices": declaration.choices_of_claims.get(claim.id)})
        for claim in multiverse.claims
    ]
    file = declaration.file
    return multiverse.model_copy(
        update={"title": file.title, "reading": file.reading.strip(), "claims": claims}
    )


def found_below(folders: Iterable[Path]) -> list[Multiverse]:
    """The analyses in some folders, and in those below; of several of a name, the most complete one."""
    found: dict[str, Multiverse] = {}
    for path in sorted(path for folder in folders for path in folder.rglob(FILE)):
        multiverse = read(path.parent)
        if multiverse.name not in found or len(multiverse.done) > len(found[multiverse.name].done):
            found[multiverse.name] = multiverse
    return list(found.values())


def with_shares(
    claims: Iterable[TestedClaim], sweep: str, multiverses: Iterable[Multiverse]
) -> list[TestedClaim]:
    """The claims of a sweep, each with the share of configurations in which it holds, where that is known."""
    known = {
        outcomes.id: {"share": outcomes.share().estimate, "configurations": len(outcomes.verdicts)}
        for multiverse in multiverses
        for outcomes in multiverse.claims
        if outcomes.sweep == sweep
    }
    return [claim.model_copy(update=known.get(claim.id)) for claim in claims]


def write(folder: Path, multiverse: Multiverse) -> None:
    """Write the file, whole or not at all."""
    make_folder(folder)
    write_json(folder / FILE, multiverse.model_dump(mode="json"), indent=None)


Entry = tuple[Claim, str, TestedClaim]
"""A claim, its sweep, and its entry of `claims.json`."""


def evaluated(
    declaration: Declaration, folders: Mapping[str, Path], numbers: Sequence[int]
) -> dict[int, list[Entry]]:
    """The claims of these configurations, by number, from the results of each sweep."""
    found: dict[int, list[Entry]] = {number: [] for number in numbers}
    for source in declaration.file.sweeps:
        results = load(folders[source])
        tested = [each for each in results.claims if isinstance(each, Claim) and each.test.kind != "latency"]
        for number in numbers:
            entries = evaluate(configuration_of(results, number), tested)
            found[number] += [(claim, source, entry) for claim, entry in zip(tested, entries, strict=True)]
    return found


def configuration_of(results: Results, number: int) -> Results:
    """The results of one configuration, which may share points with others."""
    order = list(dict.fromkeys(point.variant for point in results.points))
    points = [
        replace(point, name=point.variant, swept={k: v for k, v in point.swept.items() if k != AXIS})
        for point in sorted(results.points, key=lambda point: order.index(point.variant))
        if str(number) in point.swept[AXIS].split()
    ]
    return results.only(points)


def extended(
    multiverse: Multiverse,
    declaration: Declaration,
    found: Mapping[int, Iterable[Entry]],
) -> Multiverse:
    """The outcomes, with further configurations added."""
    by_id = {claim.id: claim for claim in multiverse.claims}
    order = sorted({*multiverse.done, *found})
    rows: dict[str, dict[int, Row]] = {}
    for claim in multiverse.claims:
        entries = zip(*(getattr(claim, column) for column in _COLUMNS), strict=True)
        rows[claim.id] = dict(zip(multiverse.done, entries, strict=True))
    for number, entries in found.items():
        for claim, sweep, entry in entries:
            if claim.id not in by_id:
                about = claim.model_dump(include={"id", "own_bound", "source", "claim", "thesis"})
                by_id[claim.id] = ClaimOutcomes(sweep=sweep, **about)
            rows.setdefault(claim.id, {})[number] = _row(entry)
    claims = []
    for name, claim in by_id.items():
        verdicts, *numbers = zip(*(rows[name][number] for number in order), strict=True)
        columns = zip(_COLUMNS, ["".join(verdicts), *map(list, numbers)], strict=True)
        claims.append(claim.model_copy(update=dict(columns)))
    extended = _with_declaration(multiverse.model_copy(update={"done": order, "claims": claims}), declaration)
    if len(order) == len(multiverse.configurations):
        extended = extended.model_copy(update={"best": best_of(extended)})
    return extended


def confirmed(
    declaration: Declaration, folders: Mapping[str, Path], numbers: Sequence[int]
) -> dict[int, dict[str, str]]:
    """The code of each claim in each of these configurations, with Holm's correction over all claims.

    Holm's procedure (1979) is stepped down in levels: what holds at the level of all hypotheses that are left
    is rejected at once, and the level counts only those still left.
    """
    found: dict[int, dict[str, str]] = {}
    for number in numbers:
        rejected, total = 0, 1
        while True:
            with statistics.at_tail(statistics.TAIL / max(1, total - rejected)):
                entries = evaluated(declaration, folders, [number])[number]
            codes = {claim.id: _row(entry)[0] for claim, _, entry in entries}
            holding = sum(code == CODES["reproduced"] for code in codes.values())
            if total == len(codes) and holding in (rejected, total):
                break
            # The first look, at the usual level, only counts the claims.
            rejected, total = (holding, total) if total == len(codes) else (0, len(codes))
        found[number] = codes
    return found


_COLUMNS = ("verdicts", "estimates", "low", "high", "ours")
Row = tuple[str, *tuple[float | None, ...]]
"""These columns of a claim in a configuration: its code, and its numbers."""


def _row(entry: TestedClaim) -> Row:
    comparisons = entry.test.comparisons
    decisive = next((each.estimate for each in comparisons if each.interval == entry.interval), None)
    low, high = entry.interval or (None, None)
    code = FAILED if entry.test.reason else CODES[entry.verdict]
    printed = entry.ours if isinstance(entry.ours, int | float) else None
    return code, *(None if each is None else float(f"{each:.6g}") for each in (decisive, low, high, printed))


def best_of(multiverse: Multiverse) -> int:
    """The configuration in which most claims hold; of several, the one nearest to the printed numbers."""
    holding = multiverse.holding()
    distances = [distance(multiverse.claims, place) for place in range(len(multiverse.done))]
    places = range(len(multiverse.done))
    best = min(places, key=lambda place: (-int(holding[place]), distances[place], place))
    return multiverse.done[best]


def distance(claims: Iterable[ClaimOutcomes], place: int) -> float:
    """The mean relative distance from the numbers of the thesis, each at most 1; 0 if it prints none."""
    apart = []
    for claim in claims:
        if not isinstance(claim.thesis, int | float) or isinstance(claim.thesis, bool) or not claim.thesis:
            continue
        ours = claim.ours[place]
        apart.append(1.0 if ours is None else min(1.0, abs(ours - claim.thesis) / abs(claim.thesis)))
    return math.fsum(apart) / len(apart) if apart else 0.0


def effects(multiverse: Multiverse, claim: ClaimOutcomes) -> dict[str, list[statistics.Interval]]:
    """The share of configurations in which a claim holds, by value of its choices; NaN if unused."""
    names, found = list(multiverse.declaration["choices"]), {}
    for name, choice in multiverse.choices_of(claim).items():
        levels = multiverse.levels[:, names.index(name)]
        found[name] = [claim.share(levels == level) for level in range(len(choice["values"]))]
    return found
