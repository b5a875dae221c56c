"""The two tiers of tests: a case for each path in `make test`, the other cases in `make slow`."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def by_tier(cases: Iterable[Any], *, normal: Collection[Any]) -> list[Any]:
    """Mark all cases but those of the normal tier as slow."""
    return [case if case in normal else pytest.param(case, marks=pytest.mark.slow) for case in cases]
