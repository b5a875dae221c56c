"""Aims of the league with the predictions that were made, and the verdict of each.

Aims and predictions were written before the league of all goals was run for the first time, and those of a
changed goal before the first result of the change. A league of maps with eight starts had been run by then,
so that predictions about maps are no more than expectations that it would repeat. Those about maps with
learned hyper-parameters were written when eleven maps of the first start had been seen.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from bojax.report.league.results import League
from bojax.report.statistics import Interval

REACHED, MISSED, OPEN, UNTESTED = "reached", "not reached", "inconclusive", "not tested"
RIVALS = ("lawnmower", "lawnmower from a corner", "SGP-Tools")
ODD = ("coast", "new-guinea", "course", "non-stationary")
"""Fields with holes or walls, and the one that is not stationary."""

TIMED, MOST_SECONDS = 40, 5.0
"""Length of a route, and how many seconds of one core it may take."""


@dataclass(frozen=True)
class Comparison:
    """The ratio of the errors of a method to a rival's, and the verdict on the bound."""

    rival: str
    where: str
    ratio: Interval
    starts: int
    verdict: str


@dataclass(frozen=True)
class Aim:
    """An aim: the errors of a method are at most a multiple of those of each rival."""

    short: str  # its name in tables
    title: str  # the aim in words
    prediction: str  # what was expected
    measure: str  # column of errors
    own: str  # method
    bound: float  # largest ratio of its errors to a rival's
    fields: Sequence[str] | str = "all"  # their names, `square` for those in the empty square, or all
    by: str = ""  # what is compared one by one: `length`, `field`, or nothing
    _: KW_ONLY
    # What bounds it, where it is not reached or inconclusive: written after a run, whose numbers it may name
    reason: str
    # Set by `judged`:
    verdict: str = UNTESTED
    found: str = ""  # in words
    comparisons: Sequence[Comparison] = ()


AIMS = (
    Aim(
        "deviation",
        "In the empty square, the mean deviation that the process expects is below that of the lawnmowers "
        "and of SGP-Tools, at each length.",
        "reached: 3 to 10% below in the earlier league. Of the routes since 27 November, averaged over "
        "longer plausible lengthscales: reached, 2 to 8% below. Of length 80, which covers: reached, 5 to "
        "10% below",
        "deviation", "bojax", 1.0, "square", "length",
        reason="where the lines of a lawnmower cover the square, little is left to gain: on 27 November, "
        "5.0 to 8.8% at length 40, but 1.0 to 2.9% at 80.",
    ),
    Aim(
        "RMSE",
        "In the empty square, the RMSE over all fields and lengths is below that of the lawnmowers and of "
        "SGP-Tools.",
        "not reached: level with the lawnmowers and 1 to 2% below SGP-Tools in the earlier league. Of the "
        "routes since 27 November: 2% below the lawnmower, 4% below SGP-Tools, and not below the lawnmower "
        "from a corner. With length 80: no other verdict",
        "rmse", "bojax", 1.0, "square",
        reason="the route is better on the field that the process has drawn itself, and worse on clouds, and "
        "on the elevation than lines from a corner. These do not vary as the process assumes: with learned "
        "hyper-parameters, the same routes are better than the lawnmower's and than those of SGP-Tools.",
    ),
    Aim(
        "RMSE of a field",
        "In the empty square, the RMSE on no field is above that of one of them by more than 3%.",
        "not reached: clouds were 10% and more above in the earlier league. Of the routes since 27 November: "
        "not reached, by the clouds. With length 80: no other verdict",
        "rmse", "bojax", 1.03, "square", "field",
        reason="a model fitted to the clouds has noise with four times the deviation that the process has: "
        "they vary over distances that no route of these lengths resolves. With learned hyper-parameters, "
        "routes of bojax are better there.",
    ),
    Aim(
        "RMSE, odd fields",
        "With holes, with walls or on a field that is not stationary, the RMSE is at least 10% below "
        "theirs.",
        "not reached: some 3% below the lawnmower in the earlier league. Of the routes since 27 November: "
        "not reached, 4% below. With length 80: not reached, 5% below",
        "rmse", "bojax", 0.9, ODD,
        reason="lawnmowers that are laid around holes and walls, from which the route begins, leave little "
        "to gain. Longer plausible lengthscales help on the field that is not stationary, but not around "
        "holes and walls.",
    ),
    Aim(
        "RMSE, learned",
        "As RMSE, if the process of every map learns its hyper-parameters from the measurements of its "
        "route.",
        "reached against the lawnmower and SGP-Tools, 5 to 10% below; inconclusive against the lawnmower "
        "from a corner. Of the routes since 27 November, 3% better on other windows: reached against all "
        "three. With length 80: reached but against lines from a corner",
        "rmse_learned", "bojax", 1.0, "square",
        reason="lines from the nearest corner leave smaller gaps: on average over the starts, the farthest "
        "place is 3.4, 1.8 and 0.97 units from them at length 20, 40 and 80, and 4.0, 2.0 and 1.04 from the "
        "route. That may count where a field varies over longer distances than the process.",
    ),
    Aim(
        "field, learned",
        "As RMSE of a field, with learned hyper-parameters.",
        "not reached on one field or another: 18 comparisons; but no longer on clouds. Of the routes since "
        "27 November: not reached, by the pacific from a corner. With length 80: no other verdict",
        "rmse_learned", "bojax", 1.03, "square", "field",
        reason="clouds are no longer among the fields that are worse. On the elevation, the route is worse "
        "than lines from a corner at all lengths; on the pacific and the bathymetry, at length 20 alone. On "
        "the bathymetry, it is worse than SGP-Tools at length 80. Errors of single starts differ too much "
        "for a verdict.",
    ),
    Aim(
        "odd fields, learned",
        "As RMSE, odd fields, with learned hyper-parameters.",
        "not reached: about 5% below. Of the routes since 27 November: not reached, 6% below the lawnmower. "
        "With length 80: no other verdict",
        "rmse_learned", "bojax", 0.9, ODD,
        reason="as without learning, lawnmowers that are laid around holes and walls leave little to gain.",
    ),
    Aim(
        "hot spots",
        "The regret of the best place found by a mission is at least 20% below theirs, at "
        "each length.",
        "reached at both lengths: legs after the first return to where the map is high. Of the goal since "
        "26 November: 15 to 20% below at length 20 and 30% or more at 40, as on other windows and draws; "
        "with four starts, intervals that are too long for a verdict",
        "regret", "bojax, hotspots", 0.8, "all", "length",
        reason="until 26 November, the goal weighed the variance at places that may be hot, which a route "
        "reduces from some distance: regrets were 6 to 27% above at length 20. By expected improvement, "
        "missions drive to the places that may be the highest. Regrets differ so much between starts that "
        "intervals of few starts are long, and six of the nine maxima lie within 0.4 units of the border.",
    ),
    Aim(
        "threshold",
        "The share of the area that the map of a mission puts on the wrong side is at least "
        "20% below theirs, at each length.",
        "reached at length 40, 25% below; not at 20, 5 to 10% below, since most of the square is not seen. "
        "Of the goal since 26 November: not reached, 10 to 13% below at length 20 and 15% at 40, as on other "
        "windows and draws",
        "missed", "bojax, threshold", 0.8, "all", "length",
        reason="a route sees a quarter of the area at length 20, and less than half at 40: what it has not "
        "seen is most of the error, whichever the goal. Places are now chosen by the expected share on the "
        "wrong side, and no longer by the straddle.",
    ),
)  # fmt: skip


TIME = Aim(
    "time",
    f"A route of length {TIMED} takes at most {MOST_SECONDS:g} s on one core after compilation.",
    "reached: 3 s before the lawnmowers' lines stopped before the border",
    "seconds", "bojax", MOST_SECONDS,
    reason="seconds depend on the processor, and on what else it runs: on 27 November 2026, medians were "
    "3.0 s on an idle machine and 3.8 s on two busy cores.",
)  # fmt: skip


def judged(league: League) -> list[Aim]:
    """Every aim with its verdict: reached or not if a whole 95% interval says so, else inconclusive."""
    found = [*(_judge(league, aim) for aim in AIMS), _judge_time(league)]
    return [each if each.verdict in (MISSED, OPEN) else replace(each, reason="") for each in found]


def _judge(league: League, aim: Aim) -> Aim:
    fields = aim.fields
    if fields == "all":
        fields = league.fields
    elif fields == "square":
        fields = [name for name, field in league.about["fields"].items() if field["place"] == "square"]
    groups: dict[str, tuple[Sequence[str], Sequence[int]]] = {"": (fields, league.lengths)}
    if aim.by == "length":
        groups = {f"length {length}": (fields, [length]) for length in league.lengths}
    elif aim.by == "field":
        groups = {field: ([field], league.lengths) for field in fields}
    found = [
        Comparison(rival, where, *ratio, _verdict(ratio[0], aim.bound))
        for where, group in groups.items()
        for rival in RIVALS
        if (ratio := league.ratio(aim.measure, aim.own, rival, *group)) is not None
    ]
    verdicts = [each.verdict for each in found]
    verdict = (
        UNTESTED if not found
        else MISSED if MISSED in verdicts
        else REACHED if {*verdicts} == {REACHED}
        else OPEN
    )  # fmt: skip
    count = f"{verdicts.count(REACHED)} of {len(found)} comparisons within the bound"
    count += f", {verdicts.count(MISSED)} beyond it"
    return replace(aim, verdict=verdict, found=count, comparisons=found)


def _judge_time(league: League) -> Aim:
    if not (seconds := league.seconds.get(TIMED)):
        return TIME
    median = float(np.median(seconds))
    found = f"median of {median:.1f} CPU s, the comparison with lawnmowers included"
    return replace(TIME, verdict=REACHED if median <= MOST_SECONDS else MISSED, found=found)


def _verdict(ratio: Interval, bound: float) -> str:
    # Comparisons with NaN, of a ratio without an interval, are false.
    return REACHED if ratio.high <= bound else MISSED if ratio.low > bound else OPEN
