"""Following a route that was planned before: a lawnmower, or the route of a survey."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.fields.data import read_waypoints
from bojax.motions.polylines import headings_along, points_along
from bojax.planning.base import Plan, Planner
from bojax.problems.field_belief import FieldBelief
from bojax.problems.field_problem import FieldProblem


class RouteFollower(Planner):
    """The next piece of a route, from wherever the robot is.

    Step t leads along the route from t to t + 1 lengths. A pose within half the distance between two poses of
    a waypoint is at the waypoint. Beyond the end of the route, the robot stays there.

    Settings: `bojax.planning.settings.Route`.
    """

    waypoints: Float[Array, "W 2"]  # the route, m
    length: Float[Array, ""]  # length of a piece, m
    size: int = eqx.field(static=True)  # number of poses of a piece

    def __init__(self, file: str, length: Float[Array, ""], num_samples: int = 10, sha256: str | None = None):
        """Read the route from a file; `sha256` is checked with the settings.

        Raises:
            ValueError: The file holds no waypoints.
        """
        self.waypoints = jnp.asarray(read_waypoints(file), length.dtype)
        self.length, self.size = length, num_samples

    @property
    @override
    def num_samples(self) -> int:
        return self.size

    @override
    def check(self, problem: Any) -> None:
        if not isinstance(problem, FieldProblem) or problem.turning_radius > 0.0:
            raise ValueError(
                "planner: a route is followed on a field, by a vehicle that turns on the spot; allowed: "
                "another planner"
            )
        problem.check_paths(self.length, self.size, "planner.length")

    @override
    def plan(self, key: Key[Array, ""], problem: FieldProblem, belief: FieldBelief) -> Plan:
        step = self.length / self.size
        number = belief.step * self.size + jnp.arange(1, self.size + 1, dtype=jnp.int32)
        points = self.points(belief, step * number.astype(step.dtype), step)
        path = _seen_from(belief.pose, points)
        root, node = problem.root(belief, 1)
        reward = problem.simulate(key, root, node, path[None], None).rewards[0]
        return Plan(action=path, reward=reward, value=reward, visits=jnp.ones((), jnp.int32))

    def points(
        self, belief: FieldBelief, distances: Float[Array, "S"], step: Float[Array, ""]
    ) -> Float[Array, "S 2"]:
        """Points at distances from the start of the route, m, about `step` apart."""
        return points_along(self.waypoints, distances, step)[0]


def _seen_from(pose: Float[Array, "3"], points: Float[Array, "S 2"]) -> Float[Array, "S 3"]:
    """A path through points, in the frame of a robot: the inverse of `bojax.motions.base.place`."""
    cos, sin = jnp.cos(pose[2]), jnp.sin(pose[2])
    x, y = points[:, 0] - pose[0], points[:, 1] - pose[1]
    headings = headings_along(pose, points) - pose[2]
    return jnp.stack([cos * x + sin * y, cos * y - sin * x, headings], axis=-1)
