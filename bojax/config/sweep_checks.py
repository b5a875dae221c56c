"""Checks of a sweep's report and claims against its points."""

from collections.abc import Collection

from bojax.config.claims import Window
from bojax.config.errors import ConfigError, allowed_names, did_you_mean, shown
from bojax.config.figures import FIGURES, TABLES
from bojax.config.files import available
from bojax.config.points import Sweep
from bojax.config.references import OfClaim, Reference, matching, references


def check_sweep(sweep: Sweep, file: str) -> None:
    """Refuse duplicate ids of claims, and names that the sweep of `file` does not have."""
    variants = {point.variant for point in sweep.points}
    relative_to = sweep.report.get("relative_to")
    if relative_to is not None:
        _require(relative_to, variants, f"{file}: report.relative_to", "; unknown variant")
    figures = [*sorted(FIGURES), *TABLES]
    for name in sweep.report.get("figures", ()):
        if name not in figures:
            raise ConfigError(
                f"{file}: report.figures: got {shown(name)}; allowed: {', '.join(figures)}"
                f"{did_you_mean(name, figures)}"
            )
    for key in ("rank_by", "column"):
        _check_column(sweep, sweep.report.get(key), f"{file}: report.{key}")
    swept = sorted({key for point in sweep.points for key in point.swept})
    named = {"over": [sweep.report.get("over")], "heat_map": sweep.report.get("heat_map") or ()}
    for key, settings in named.items():
        for name in settings:
            if name is not None:
                _require(name, swept, f"{file}: report.{key}", "; no swept setting")
    seen = set()
    for index, claim in enumerate(sweep.claims):
        where = f"{file}: claims.{index}"
        if claim.id in seen:
            raise ConfigError(f"{where}.id: got {shown(claim.id)}; allowed: a unique id")
        seen.add(claim.id)
        values = dict(claim.test)
        if not any(isinstance(value, Window) for value in values.values()):
            _check_column(sweep, values.get("column"), f"{where}.test.column")
        if "over" in values:
            _require(values["over"], swept, f"{where}.test.over", "; no swept setting")
        known = {point.variant if claim.test.by == "variant" else point.label for point in sweep.points}
        for name in claim.test.names:
            _require(name, known, f"{where}.test", f"; unknown {claim.test.by}")
    explained, names = set(), available("sweeps")
    for index, explanation in enumerate(sweep.report.get("explanations", ())):
        where = f"{file}: report.explanations.{index}"
        for name in explanation["claims"]:
            _require(name, seen, f"{where}.claims", "; unknown id")
            if name in explained:
                raise ConfigError(f"{where}.claims: got {shown(name)}; allowed: one explanation of a claim")
            explained.add(name)
        for name in explanation.get("sweeps", ()):
            _require(name, names, f"{where}.sweeps")
        try:
            found = references(explanation["text"])
        except ValueError as error:
            raise ConfigError(f"{where}.text: {error}") from error
        for reference in found:
            if reference.sweep:
                _require(reference.sweep, names, f"{where}.text")
            else:
                check_reference(reference, sweep, f"{where}.text")


def check_reference(reference: Reference, sweep: Sweep, where: str) -> None:
    """Refuse a reference to a claim or a point that a sweep does not have."""
    if isinstance(reference, OfClaim):
        _require(reference.claim, [claim.id for claim in sweep.claims], where, "; unknown id")
        return
    found = matching(sweep.points, reference.point)
    name, known = reference.point, {point.variant for point in sweep.points}
    if not found:
        raise ConfigError(f"{where}: got {shown(name)}; unknown point{allowed_names(name, known)}")
    if len(found) > 1:
        raise ConfigError(
            f"{where}: got {shown(name)}, the name of {len(found)} points; allowed: a variant of one point, "
            "or a name with swept values: NAME, KEY VALUE"
        )
    _check_column(sweep, None if reference.episodes else reference.column, where)


def _require(name: str, known: Collection[str], where: str, what: str = "") -> None:
    """Refuse a name that is not among the known ones; `what` says so in the message."""
    if name not in known:
        raise ConfigError(f"{where}: got {shown(name)}{what}{allowed_names(name, known)}")


def _check_column(sweep: Sweep, column: str | None, where: str) -> None:
    """Refuse the column `return` of the runs of learners, which have one return for each episode."""
    is_learning = any(point.config.kind == "learning" for point in sweep.points)
    if is_learning and column is not None and column.removeprefix("-") == "return":
        renamed = column.replace("return", "last_return")
        raise ConfigError(
            f"{where}: got {shown(column)}; did you mean {shown(renamed)}, of the last episode?"
        )
