"""A doubt about the unit of measured values: a deviation that no quantity has in the units in common use."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

DOUBTED = 1e9
"""Standard deviation from which the unit of values is doubted.

What robots map varies by less in its usual units: pressures from the surface to the ground of the ocean by
1e8 Pa, depths of the ocean by 1e7 mm, cells in a litre of water seldom by 1e9. A count in a cubic metre may
honestly vary by more, so that this is a reason for a note, and never one to refuse values.
"""


def unit_doubt(values: "np.ndarray") -> str | None:
    """A sentence about values with a standard deviation of at least `DOUBTED`; None for others.

    Values that are not finite are ignored.
    """
    import numpy as np  # not at the start of every command

    finite = values[np.isfinite(values)]
    if not finite.size:
        return None
    with np.errstate(over="ignore"):
        deviation = float(np.std(finite))
    # The square of a deviation that overflows is not finite.
    if math.isfinite(deviation) and deviation < DOUBTED:
        return None
    return f"the values have a standard deviation of {deviation:.3g}; check their unit"
