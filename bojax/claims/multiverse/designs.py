"""Designs: which combinations of the values of several choices are run."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

Levels = tuple[int, ...]
"""The index of the value of each choice."""


def grid(sizes: Sequence[int]) -> list[Levels]:
    """All combinations of choices with these numbers of values."""
    return list(itertools.product(*map(range, sizes)))


def random(sizes: Sequence[int], count: int, seed: int) -> list[Levels]:
    """Distinct combinations, the first values of all choices first; each value is equally likely.

    Raises:
        ValueError: There are fewer combinations.
    """
    total = math.prod(sizes)
    if count > total:
        raise ValueError(f"got {count:,} configurations; allowed: at most {total:,}, all combinations")
    if count == total:
        return grid(sizes)
    generator = np.random.default_rng(seed)
    found: dict[Levels, None] = {(0,) * len(sizes): None}
    while len(found) < count:
        found[tuple(int(level) for level in generator.integers(sizes))] = None
    return list(found)


def fractional(sizes: Sequence[int], count: int) -> list[Levels]:
    """A regular fraction of the grid, the first values of all choices first.

    Each choice with 2^b values is read from b columns of a two-level design in `count` = 2^m runs: words of
    m basic factors, independent of each other (Box, Hunter and Hunter, Statistics for Experimenters, ch. 6).
    Words of an odd number of factors are taken first: a product of two of them has an even number, so that
    no main effect is confounded with an interaction of two choices (resolution IV) while they last.

    Raises:
        ValueError: `count` or a number of values is no power of 2, or there are too many choices.
    """
    if count & (count - 1) or any(size & (size - 1) for size in sizes):
        raise ValueError(f"got {count} configurations of {list(sizes)} values; allowed: powers of 2")
    words = sorted(
        range(1, count),
        key=lambda word: (word.bit_count() % 2 == 0, word.bit_count() > 1, -word.bit_count(), word),
    )
    taken: set[int] = set()
    columns: list[list[int]] = []
    for size in sizes:
        own: list[int] = []
        for _ in range(size.bit_length() - 1):
            # Sums of the columns of one choice are its contrasts, too.
            free = [word for word in words if not ({word, *(word ^ other for other in _span(own))} & taken)]
            free = [word for word in free if word not in _span(own)]
            if not free:
                raise ValueError(
                    f"got {list(sizes)} values; allowed: fewer choices, or more than {count} configurations"
                )
            own.append(free[0])
        taken |= _span(own)
        columns.append(own)
    runs = []
    for run in range(count):
        levels = []
        for own in columns:
            bits = [((run & word).bit_count() & 1) for word in own]
            levels.append(sum(bit << place for place, bit in enumerate(bits)))
        runs.append(tuple(levels))
    return runs


def _span(words: Sequence[int]) -> set[int]:
    """All sums of some of these words."""
    found = {0}
    for word in words:
        found |= {word ^ other for other in found}
    return found - {0}
