"""A sweep that is read and expanded: its points, and what holds for all of them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bojax.config.claims import Claim
from bojax.config.component import Component
from bojax.config.errors import Location, dotted
from bojax.config.settings import EngineConfig, Record


@dataclass(frozen=True)
class Point:
    """One point of a sweep: an experiment with a value of each swept key."""

    index: int  # number of the point, from 0
    label: str  # identifier of the point in results: the kind of its planner or learner
    variant: str  # name of the point in the sweep
    swept: dict[str, Any]  # values of the swept keys, by dotted path; for a named subtree, the name
    config: Component


@dataclass(frozen=True)
class Sweep:
    """A sweep, validated except for the parts given by import path."""

    name: str  # name of the sweep and of its results folder
    title: str  # title in reports, one line
    points: tuple[Point, ...]
    runs: int  # number of runs of each point
    seed: int  # seed of all run keys
    record: Record  # which runs are recorded
    engine: EngineConfig  # how runs are executed
    report: dict[str, Any]  # content of the report
    claims: tuple[Claim, ...]  # claims of the thesis, with their tests
    base: dict[str, Any]  # the experiment before the axes are applied, as written and overridden
    source: Path
    published: Path | None = None  # the shipped sweep of this name, with which results are compared
    # Formats the origin of a setting of a point as `FILE: dotted.path`, for messages.
    locate: Callable[[int, Location], str] = field(
        default=lambda index, location: f"point {index}: {dotted(location)}", repr=False, compare=False
    )

    @property
    def is_published(self) -> bool:
        """Whether its file is part of bojax."""
        return self.published == self.source.resolve()
