"""The settings in which a sweep differs from the published sweep of the same name."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from bojax.config.points import Point, Sweep
from bojax.config.sweep import load_sweep

_MISSING = object()


def changed_from_published(sweep: Sweep) -> dict[str, list[Any]]:
    """The settings in which a sweep differs from the sweep of bojax with its name, see `changed_settings`."""
    return {} if sweep.published is None else changed_settings(load_sweep(str(sweep.published)), sweep)


def changed_settings(published: Sweep, ours: Sweep) -> dict[str, list[Any]]:
    """The published value and our value of every setting that differs, by dotted path.

    The comparison covers everything that affects a verdict: runs, seed, axes, the resolved settings of each
    point and the tests of claims. It leaves out `engine`, `record` and `report`. The values of a setting that
    differs between points are given as a list.
    """
    pairs: dict[str, list[tuple[Any, Any]]] = {
        name: [(getattr(published, name), getattr(ours, name))] for name in ("runs", "seed")
    }
    tests = {claim.id: claim.test.model_dump(mode="json") for claim in published.claims}
    for claim in ours.claims:
        if claim.id in tests:
            pairs[f"claims.{claim.id}"] = [(tests[claim.id], claim.test.model_dump(mode="json"))]
    theirs, own = ([point.swept for point in sweep.points] for sweep in (published, ours))
    for axis in dict.fromkeys(name for swept in (*theirs, *own) for name in swept):
        pairs[f"axes.{axis}"] = [(_values(theirs, axis), _values(own, axis))]
    if all(a == b for name, ((a, b), *_) in pairs.items() if name.startswith("axes.")):
        # The same values can be combined differently, for example by a zip instead of a grid.
        pairs["points"] = [(_without(published, ours), _without(ours, published))]
    for path, values in _differences(published, ours):
        pairs.setdefault(path, []).append(values)
    return {
        path: [_one_or_all([pair[side] for pair in values]) for side in (0, 1)]
        for path, values in pairs.items()
        if any(a != b for a, b in values)
    }


def _differences(published: Sweep, ours: Sweep) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """The unswept settings in which a point differs from its counterpart."""
    same_values = {_key(point): point for point in reversed(published.points)}
    same_variant = {point.variant: point for point in reversed(published.points)}
    for point in ours.points:
        other = same_values.get(_key(point)) or same_variant.get(point.variant) or published.points[0]
        axes = [
            name
            for name in point.swept.keys() | other.swept.keys()
            if point.swept.get(name, _MISSING) != other.swept.get(name, _MISSING)
        ]
        before, after = (dict(leaves(p.config.model_dump(mode="json"))) for p in (other, point))
        for path in dict.fromkeys((*before, *after)):
            values = before.get(path), after.get(path)
            if values[0] != values[1] and not any(f"{path}.".startswith(f"{axis}.") for axis in axes):
                yield path, values


def _without(sweep: Sweep, other: Sweep) -> list[dict[str, Any]]:
    """The swept values of the points of `sweep` that `other` does not have."""
    known = set(map(_key, other.points))
    return [point.swept for point in sweep.points if _key(point) not in known]


def _key(point: Point) -> str:
    return json.dumps(point.swept, sort_keys=True, default=str)


def leaves(config: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """The plain settings of a nested mapping, by dotted path."""
    if not isinstance(config, Mapping):
        yield path, config
        return
    for name, value in config.items():
        yield from leaves(value, f"{path}.{name}" if path else name)


def _values(points: list[dict[str, Any]], axis: str) -> list[Any] | None:
    """The distinct values of an axis; None if the axis is not swept."""
    return _distinct([swept[axis] for swept in points if axis in swept]) or None


def _one_or_all(values: list[Any]) -> Any:
    distinct = _distinct(values)
    return distinct[0] if len(distinct) == 1 else distinct


def _distinct(values: list[Any]) -> list[Any]:
    return list({json.dumps(value, sort_keys=True, default=str): value for value in values}.values())
