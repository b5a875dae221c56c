"""The league in pieces: each is planned and scored by itself, and kept in a file of its own."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from bojax.surveys.league.fields import LENGTHSCALE, NOISE_VARIANCE, VARIANCE, Field
from bojax.surveys.league.routes import LEG, NOISE, SPACING, adaptive_route, map_routes, peers
from bojax.surveys.league.scores import SHARE, scores_of, threshold_of

LENGTHS, COVERING = (20, 40), 80
"""Lengths of all routes; and one for maps alone, enough for parallel lines about a lengthscale apart."""

GOALS = ("map", "hotspots", "threshold")
"""Goals: the routes of the first do not depend on values, those of the others do."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One start of one length: the routes of one place for a map, or of one field for another goal."""

    goal: str
    place: str
    fields: Sequence[Field]
    length: int
    start: int

    @property
    def name(self) -> str:
        """Name of its file."""
        return f"{self.goal}-{self.place}-{self.length}-{self.start:02d}.json"

    def result(self) -> dict[str, Any]:
        """Its routes, and the scores of each on each field."""
        seconds = None
        if self.goal == "map":
            routes, seconds = map_routes(self.fields[0], self.length, self.start)
        else:
            (field,) = self.fields
            goal = f"threshold={threshold_of(field)}" if self.goal == "threshold" else self.goal
            routes = {f"bojax, {self.goal}": adaptive_route(field, self.length, self.start, goal)}
        scores = {
            field.name: {
                method: scores_of(field, route, self.length, self.start) for method, route in routes.items()
            }
            for field in self.fields
        }
        return {
            "goal": self.goal,
            "length": self.length,
            "start": self.start,
            "seconds": seconds,
            "routes": {method: route.tolist() for method, route in routes.items()},
            "scores": scores,
        }


def cells_of(fields: Sequence[Field], starts: int) -> Iterator[Cell]:
    """The pieces of the league: all of the first start, then all of the next."""
    by_place: dict[str, list[Field]] = {}
    for field in fields:
        by_place.setdefault(field.place, []).append(field)
    for start in range(starts):
        for length in (*LENGTHS, COVERING):
            for place, together in by_place.items():
                yield Cell("map", place, together, length, start)
            for goal in GOALS[1:] if length != COVERING else ():
                for field in fields:
                    yield Cell(goal, field.name, [field], length, start)


def describe(fields: Sequence[Field], starts: int) -> dict[str, Any]:
    """What a league is about, for its page, and to resume it only with the same numbers."""
    return {
        "starts": starts,
        "lengths": [*LENGTHS, COVERING],
        "fields": {field.name: {"place": field.place, "is_real": field.is_real} for field in fields},
        "process": {"lengthscale": LENGTHSCALE, "variance": VARIANCE, "noise_variance": NOISE_VARIANCE},
        "sampling": SPACING,
        "noise": NOISE,
        "leg": LEG,
        "share_above": SHARE,
        "peers": peers()["about"],
    }
