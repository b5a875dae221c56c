"""The figures of a multiverse analysis: specification curves (Simonsohn et al., 2020), and shares."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from bojax.claims.multiverse.outcomes import FAILED, ClaimOutcomes, Multiverse, effects
from bojax.report import style
from bojax.report.drawing.base import Drawing
from bojax.report.text import counted

INKS = {"r": style.BLUE, "i": "#BDBDBD", "n": style.ORANGE, FAILED: style.INK}
WORDS = {"r": "holds", "i": "inconclusive", "n": "does not", FAILED: "not tested"}

_ROW = 0.16
"""Height of a row of a dashboard, in inches."""


def shares(multiverse: Multiverse) -> Drawing:
    """A bar for each claim: the shares of its verdicts over all configurations."""
    claims = multiverse.claims
    figure, grid = style.figure(0.9 + 0.24 * len(claims))
    axes = grid[0, 0]
    for row, claim in enumerate(claims):
        left = 0.0
        for code, ink in INKS.items():
            share = claim.count(code) / len(claim.verdicts)
            axes.barh(row, share, left=left, height=0.72, color=ink)
            left += share
    axes.set_yticks(range(len(claims)), [style.drawn_text(claim.id) for claim in claims], fontsize=8)
    axes.set_ylim(len(claims) - 0.4, -0.6)
    axes.set_xlim(0, 1)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axes.set_xlabel("share of configurations")
    axes.tick_params(axis="y", length=0)
    axes.spines[["left"]].set_visible(False)
    shown = [code for code in INKS if any(claim.count(code) for claim in claims)]
    patches = [Patch(color=INKS[code]) for code in shown]
    style.legend(figure, patches, [WORDS[code] for code in shown], loc="outside upper center", ncols=4)
    return Drawing(
        figure=figure,
        title="In how many configurations each claim holds",
        caption=f"Verdicts of each claim in {counted(len(multiverse.done), 'configuration')} of the choices.",
        alt="Bars with the share of configurations in which each claim holds, or does not hold.",
    )


def count_curve(multiverse: Multiverse) -> Drawing:
    """The number of claims that hold in each configuration, sorted, with the values of all choices below."""
    holding, choices = multiverse.holding(), multiverse.declaration["choices"]
    order = np.argsort(-holding, kind="stable")
    figure, curve, dashboard = _panels(choices)
    curve.vlines(range(order.size), 0, holding[order], color=style.BLUE, **_mark(order.size))
    if 0 in multiverse.done:
        own = int(np.flatnonzero(order == multiverse.done.index(0))[0])
        curve.plot([own], [holding[order[own]]], "o", color=style.ORANGE, markersize=5, clip_on=False)
    curve.set_ylim(0, max(1, len(multiverse.claims)))
    curve.set_ylabel("claims that hold")
    curve.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    style.quiet_grid(curve)
    _draw_dashboard(dashboard, multiverse, choices, order, np.full(order.size, style.INK, object))
    return Drawing(
        figure=figure,
        title="Claims that hold together",
        caption=f"Number of the {counted(len(multiverse.claims), 'claim')} that hold in each configuration, "
        "the best first; the dot is the configuration of the sweep itself. Below, a mark for the value of "
        "each choice.",
        alt="Specification curve of the number of claims that hold, with the values of the choices below.",
    )


def claim_curve(multiverse: Multiverse, claim: ClaimOutcomes) -> Drawing | None:
    """The estimate that decides a claim in each configuration, sorted, above the choices that can change it.

    None if no configuration has an estimate, or no choice can change it.
    """
    # None becomes NaN.
    estimates, low, high = np.array([claim.estimates, claim.low, claim.high], np.float64)
    known = np.flatnonzero(np.isfinite(estimates))
    if not known.size or not (choices := multiverse.choices_of(claim)):
        return None
    order = known[np.argsort(estimates[known], kind="stable")]
    inks = np.array([INKS[code] for code in claim.verdicts], object)[order]
    figure, curve, dashboard = _panels(choices)
    places = np.arange(order.size)
    curve.vlines(places, low[order], high[order], colors=list(inks), alpha=0.45, **_mark(order.size))
    curve.scatter(places, estimates[order], s=5, c=list(inks), linewidths=0, rasterized=True)
    if 0 in multiverse.done and (own := np.flatnonzero(order == multiverse.done.index(0))).size:
        curve.plot(own, estimates[order[own]], "o", mfc="none", color=style.INK, markersize=8, clip_on=False)
    curve.set_ylabel("estimate")
    style.quiet_grid(curve)
    style.plain_ticks(curve.yaxis)
    _draw_dashboard(dashboard, multiverse, choices, order, inks)
    return Drawing(
        figure=figure,
        title=claim.claim,
        caption="Estimate of the comparison that decides the claim, with its interval, in each "
        "configuration; blue where the claim holds, orange where it does not. Circle: the configuration of "
        "the sweep itself.",
        alt=f"Specification curve of the claim {claim.id} with a dashboard of the values of the choices.",
    )


def effect_map(multiverse: Multiverse) -> Drawing:
    """For each claim and choice, the difference between the shares of its best and its worst value."""
    claims, choices = multiverse.claims, list(multiverse.declaration["choices"])
    table = np.full((len(claims), len(choices)), np.nan)
    for row, claim in enumerate(claims):
        for name, intervals in effects(multiverse, claim).items():
            found = [each.estimate for each in intervals if np.isfinite(each.estimate)]
            table[row, choices.index(name)] = max(found) - min(found) if found else np.nan
    height = 1.9 + 0.24 * len(claims)
    figure, grid = style.figure(height)
    axes = grid[0, 0]
    image = axes.imshow(table, cmap="cividis", vmin=0, vmax=1, aspect="auto")
    axes.set_xticks(
        range(len(choices)), [style.drawn_text(name) for name in choices], rotation=60, ha="right", fontsize=8
    )
    axes.set_yticks(range(len(claims)), [style.drawn_text(claim.id) for claim in claims], fontsize=8)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    bar = figure.colorbar(image, ax=axes, location="top", aspect=40, shrink=0.8, pad=0.2 / height)
    bar.set_label("difference of shares")
    bar.ax.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    return Drawing(
        figure=figure,
        title="Which choice decides which claim",
        caption="For each choice, the share of configurations in which a claim holds under its most "
        "favourable value, less that under its least favourable one. Empty: the choice does not concern the "
        "claim.",
        alt="Map of the effect of each choice on the share of configurations in which each claim holds.",
    )


def _panels(choices: Mapping[str, Any]) -> tuple[Any, Axes, Axes]:
    rows = sum(len(choice["values"]) for choice in choices.values())
    height = 1.5 + _ROW * rows + 0.1
    figure, grid = style.figure(height, 2, 1, sharex=True, gridspec_kw={"height_ratios": [1.5, _ROW * rows]})
    return figure, grid[0, 0], grid[1, 0]


def _draw_dashboard(
    axes: Axes,
    multiverse: Multiverse,
    choices: Mapping[str, Any],
    order: NDArray[np.int64],
    inks: NDArray[Any],
) -> None:
    """A row for each value of these choices, with a mark where a configuration has it."""
    names, levels = list(multiverse.declaration["choices"]), multiverse.levels[order]
    labels, row = list[str](), 0
    places = np.arange(order.size)
    for name, choice in choices.items():
        if row:
            axes.axhline(row - 0.5, color="#E4E4E4", linewidth=0.7)
        for level, value in enumerate(choice["values"]):
            has = levels[:, names.index(name)] == level
            axes.vlines(places[has], row - 0.38, row + 0.38, colors=list(inks[has]), **_mark(order.size))
            labels.append(f"{name if level == 0 else ''}  {value}")
            row += 1
    axes.set_yticks(range(row), [style.drawn_text(label) for label in labels], fontsize=6.5)
    axes.set_ylim(row - 0.5, -0.5)
    axes.set_xlabel("configurations, sorted")
    axes.tick_params(axis="y", length=0)
    axes.spines[:].set_visible(False)


def _mark(count: int) -> dict[str, Any]:
    """Style of marks, so wide that those of all configurations fill the width of the panel."""
    return {"linewidth": max(0.4, min(6.0, 0.75 * 3.3 * 72 / max(1, count))), "rasterized": True}
