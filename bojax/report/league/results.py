"""The results of a league: errors by measure, field, length, method and start."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bojax.report.statistics import Interval, ratio_interval
from bojax.results.store import ResultsError, read_json

LEAGUE, CELLS = "league.json", "cells"
"""The description of a league, and the folder of its pieces."""

Key = tuple[str, str, int, str]  # measure, field, length, method


@dataclass(frozen=True)
class League:
    """What a league has found."""

    about: Mapping[str, Any]  # its description
    errors: Mapping[Key, Mapping[int, float]]  # by start
    seconds: Mapping[int, Sequence[float]]  # CPU seconds of `bojax survey` after the first start, by length

    @classmethod
    def read(cls, folder: Path) -> "League":
        """The league in a folder; some of its pieces may be missing, but not all."""
        errors: dict[Key, dict[int, float]] = defaultdict(dict)
        seconds: dict[int, list[float]] = defaultdict(list)
        files = sorted((folder / CELLS).glob("*.json"))
        if not files:
            raise ResultsError(f"{folder}: no results of a league")
        for file in files:
            cell = read_json(file)
            length, start = cell["length"], cell["start"]
            if cell["seconds"] is not None and start > 0:  # the first start compiles
                seconds[length].append(cell["seconds"])
            for field, by_method in cell["scores"].items():
                for method, scores in by_method.items():
                    for measure, value in scores.items():
                        errors[measure, field, length, method][start] = value
        return cls(read_json(folder / LEAGUE), errors, seconds)

    @property
    def fields(self) -> list[str]:
        """Names of its fields."""
        return list(self.about["fields"])

    @property
    def lengths(self) -> list[int]:
        """Lengths of its routes."""
        return list(self.about["lengths"])

    def ratio(
        self, measure: str, own: str, other: str, fields: Sequence[str], lengths: Sequence[int]
    ) -> tuple[Interval, int] | None:
        """Sum of a method's errors over another's, and the number of starts.

        Pairs of field and length are left out if one of the methods has no route for them, and starts that
        a pair lacks. None if nothing is left.
        """
        pairs = [
            (mine, theirs)
            for field in fields
            for length in lengths
            if (mine := self.errors.get((measure, field, length, own)))
            and (theirs := self.errors.get((measure, field, length, other)))
        ]
        if not pairs:
            return None
        starts = sorted(set.intersection(*({*mine} & {*theirs} for mine, theirs in pairs)))
        if not starts:
            return None
        numerator, denominator = (
            np.array([sum(pair[side][start] for pair in pairs) for start in starts]) for side in (0, 1)
        )
        return ratio_interval(numerator, denominator), len(starts)
