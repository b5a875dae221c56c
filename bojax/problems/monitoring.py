"""Field monitoring (Chapter 3 and Section 4.7.1): learn a field, judged by the errors of the final belief."""

from typing import ClassVar

from jaxtyping import Scalar
from typing_extensions import override

from bojax.problems.field_belief import FieldBelief
from bojax.problems.field_errors import FIELD_COLUMNS
from bojax.problems.field_problem import FieldProblem, FieldWorld
from bojax.results.schema import Table


class FieldMonitoring(FieldProblem):
    """Learn an environmental variable from noisy samples taken along trajectories.

    Settings: `bojax.problems.settings.Monitoring`, `Diagonal`, `TwoPits` and `SpaceModelling`.
    """

    scores: ClassVar[Table] = FIELD_COLUMNS

    @override
    def score(self, world: FieldWorld, belief: FieldBelief) -> dict[str, Scalar]:
        """Errors of the final belief on a grid over the domain."""
        return self.field_score(world, belief)
