"""The page of a multiverse analysis: shares by claim, effects of the choices, and the best configuration."""

import math
from operator import itemgetter
from pathlib import Path
from typing import Any

from bojax.claims.multiverse import figures
from bojax.claims.multiverse.outcomes import CODES, FAILED, ClaimOutcomes, Multiverse, effects
from bojax.report import style
from bojax.report.drawing.base import Drawing
from bojax.report.template import fill
from bojax.report.text import counted, joined
from bojax.results.store import make_folder, write_content

_ELSEWHERE = {"n": "refuted", "i": "inconclusive", FAILED: "not tested"}
_WORDS = {"r": "holds", "n": "does not hold", "i": "inconclusive", FAILED: "not tested"}


def write_page(multiverse: Multiverse, page: Path) -> Path:
    """Write the page, `.html` or `.md`, and its figures into the folder `figures` beside it."""
    with style.settings():
        drawings = {
            "shares": figures.shares(multiverse).encoded(),
            "together": figures.count_curve(multiverse).encoded(),
            "effects": figures.effect_map(multiverse).encoded(),
        }
        curves = dict[str, Drawing]()
        for number, claim in enumerate(multiverse.claims, 1):
            if (drawing := figures.claim_curve(multiverse, claim)) is not None:
                curves[f"claim-{number:03d}"] = drawing.encoded()
    make_folder(page.parent)
    # A page in Markdown shows the files themselves, in dark mode too; one in HTML has its own copies.
    images = {
        f"{multiverse.name}-{name}": (
            {"svg": style.adapted(each.files["svg"])} if page.suffix == ".md" else each.files
        )
        for name, each in {**drawings, **curves}.items()
    }
    style.write_images(page.parent, images)
    design = multiverse.declaration["design"]
    values = {
        "name": multiverse.name,
        "title": multiverse.title,
        "summary": summary_of(multiverse),
        "counts": [],
        "reading": multiverse.reading,
        "drawings": drawings,
        "curves": curves,
        "claims": [_row(multiverse, claim) for claim in multiverse.claims],
        "choices": _choices(multiverse),
        "best": _best(multiverse),
        "provenance": [
            ("configurations", f"{len(multiverse.done):,} of {len(multiverse.configurations):,}"),
            (
                "runs of each point, seed",
                f"{multiverse.declaration['runs']}, {multiverse.declaration['seed']}",
            ),
            ("design", joined(f"{key} {value}" for key, value in design.items() if value is not None)),
        ],
        "footer": "Written by bojax from multiverse.json, which has every verdict.",
    }
    write_content(page, fill(f"multiverse{page.suffix}.j2", **values))
    return page


def summary_of(multiverse: Multiverse) -> str:
    """How many claims there are of each strength, as a sentence."""
    claims, total = multiverse.claims, len(multiverse.configurations)
    strengths = [claim.strength for claim in claims]
    kinds = joined(
        f"{strengths.count(kind)} {kind}" for kind in ("robust", "fragile", "contrary", "undecided")
    )
    done = f"{len(multiverse.done)} of {total}" if len(multiverse.done) < total else f"{total}"
    choices = counted(len(multiverse.declaration["choices"]), "choice")
    return f"{counted(len(claims), 'claim')} in {done} configurations of {choices}: {kinds}."


def _row(multiverse: Multiverse, claim: ClaimOutcomes) -> dict[str, Any]:
    own = multiverse.done.index(0) if 0 in multiverse.done else None
    share, bounds = claim.share().in_words(as_percent=True)
    confirmed = multiverse.confirmed
    total = len(claim.verdicts)
    return {
        "id": claim.id,
        "source": _source(multiverse, claim),
        "claim": claim.claim,
        "own": "" if own is None else _WORDS[claim.verdicts[own]],
        "share": f"{share} {bounds}",
        "elsewhere": ", ".join(
            f"{count / total:.0%} {_ELSEWHERE[code]}" for code in _ELSEWHERE if (count := claim.count(code))
        ),
        "strength": claim.strength,
        "fresh_own": _WORDS[confirmed.own.get(claim.id, FAILED)] if confirmed else "",
        "fresh_best": _WORDS[confirmed.best.get(claim.id, FAILED)] if confirmed else "",
        "decisive": _decisive(multiverse, claim),
    }


def _source(multiverse: Multiverse, claim: ClaimOutcomes) -> str:
    """Where the paper makes a claim; with the sweep, if the claim is made of several sweeps."""
    same = [each for each in multiverse.claims if (each.claim, each.source) == (claim.claim, claim.source)]
    return "; ".join(each for each in (claim.source, claim.sweep if len(same) > 1 else "") if each)


def _decisive(multiverse: Multiverse, claim: ClaimOutcomes) -> str:
    """The choice with the largest effect on a claim, in words; empty if none has one."""
    words, most = "", 0.0
    for name, intervals in effects(multiverse, claim).items():
        shares = zip(intervals, multiverse.declaration["choices"][name]["values"], strict=True)
        known = [(each.estimate, value) for each, value in shares if math.isfinite(each.estimate)]
        high = max(known, key=itemgetter(0), default=(0.0, ""))
        low = min(known, key=itemgetter(0), default=(0.0, ""))
        if high[0] - low[0] > most:
            most = high[0] - low[0]
            words = f"{name}: {high[0]:.0%} with {high[1]}, {low[0]:.0%} with {low[1]}"
    return words


def _choices(multiverse: Multiverse) -> list[dict[str, Any]]:
    """Each choice with its values and the mean number of claims that hold under each."""
    holding, levels = multiverse.holding(), multiverse.levels
    rows = []
    for column, (name, choice) in enumerate(multiverse.declaration["choices"].items()):
        values = []
        for level, value in enumerate(choice["values"]):
            has = levels[:, column] == level
            mean = f"{holding[has].mean():.1f}" if has.any() else "–"
            values.append((str(value), int(has.sum()), mean))
        rows.append({"name": name, "says": choice["says"], "source": choice["source"], "values": values})
    return rows


def _best(multiverse: Multiverse) -> dict[str, Any] | None:
    """The best configuration beside the sweep's own; None until all configurations were evaluated."""
    if multiverse.best is None:
        return None
    claims, holding = multiverse.claims, multiverse.holding()
    place = multiverse.done.index(multiverse.best)
    choices, levels = multiverse.declaration["choices"].items(), multiverse.configurations[multiverse.best]
    differing = []
    for (name, choice), level in zip(choices, levels, strict=True):
        if level:
            values = list(choice["values"])
            differing.append((name, str(values[0]), str(values[level])))
    confirmed, fresh, ids = multiverse.confirmed, None, {claim.id for claim in claims}
    if confirmed is not None:
        holds = CODES["reproduced"]
        fresh = [sum(each.get(name) == holds for name in ids) for each in (confirmed.best, confirmed.own)]
    return {
        "number": multiverse.best,
        "total": len(claims),
        "selected": (int(holding[place]), int(holding[multiverse.done.index(0)])),
        "fresh": fresh,
        "runs": confirmed.runs if confirmed else None,
        "seed": confirmed.seed if confirmed else None,
        "differing": differing,
        **_tied(multiverse, place),
    }


def _tied(multiverse: Multiverse, place: int) -> dict[str, Any]:
    """Other configurations with as many claims as the best, and claims that hold in some of them only."""
    holding = multiverse.holding()
    places = [other for other, count in enumerate(holding) if count == holding[place]]
    some = []
    for claim in multiverse.claims:
        count = sum(claim.verdicts[each] == CODES["reproduced"] for each in places)
        if 0 < count < len(places):
            some.append((claim.claim, _source(multiverse, claim), f"{count} of {len(places)}"))
    return {"tied": [multiverse.done[each] for each in places if each != place], "some": some}
