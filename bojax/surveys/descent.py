"""Descent of all waypoints of many routes of one or several robots at once, under a hard budget."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, PyTree, Scalar

from bojax.models.gaussian_process import GaussianProcess
from bojax.numerics.linalg import matmul
from bojax.surveys.information import Number, PointErrors, path_length, points_at, samples_of_all

SAVED = 0.9
"""Share of the length saved by arcs that may be spent; the rest allows for later changes of the turns."""

EXACT = 1.0 - 1e-12  # share of the budget that is used, so that rounding does not exceed it


class Ends(eqx.Module):
    """The fixed ends of a route, each None if it is free."""

    start: Float[Array, "2"] | None
    end: Float[Array, "2"] | None

    def fixed(self, points: Float[Array, "W 2"]) -> Float[Array, "W 2"]:
        """The points with the first and the last moved to the fixed ends."""
        points = points if self.start is None else points.at[0].set(self.start)
        return points if self.end is None else points.at[-1].set(self.end)

    def shortest(self, points: Float[Array, "W 2"]) -> Float[Array, "W 2"]:
        """The shortest route between the ends: a straight line, or a point that does not move."""
        if self.start is not None and self.end is not None:
            share = jnp.linspace(0.0, 1.0, points.shape[0], dtype=points.dtype)[:, None]
            return (1.0 - share) * self.start[None] + share * self.end[None]
        at = self.start if self.end is None else self.end
        at = jnp.mean(points, axis=0) if at is None else at
        return jnp.broadcast_to(at, points.shape)


def within_budget(points: Float[Array, "W 2"], ends: Ends, budget: Float[Array, ""]) -> Float[Array, "W 2"]:
    """The route of these waypoints between the ends, drawn in until its length is at most the budget.

    The length of (1 - s) shortest + s route is convex in s, so it is at most (1 - s) d + s L, with the
    lengths d and L of the two: the largest s for which this bound keeps the budget is used. The budget must
    be at least d.
    """
    points = ends.fixed(points)
    shortest = ends.shortest(points)
    least = path_length(shortest)
    extra = path_length(points) - least
    share = jnp.clip((budget * EXACT - least) / jnp.where(extra > 0.0, extra, 1.0), 0.0, 1.0)
    return (1.0 - share) * shortest + share * points


class Models(eqx.Module):
    """Plausible beliefs about the field: one Gaussian process on several linear maps of the plane."""

    maps: Float[Array, "Q 2 2"]  # linear maps A; the kernel of each belief is k(A x, A y)
    errors: PointErrors  # the beliefs at the mapped grid, stacked

    @classmethod
    def of(
        cls,
        posterior: GaussianProcess,
        grid: Float[Array, "M 2"],
        weights: Float[Array, "M"],
        maps: Float[Array, "Q 2 2"],
    ) -> "Models":
        """The beliefs given the data of `posterior`, under each map.

        A single map must be the identity: `posterior` is then taken as it is, and may be sparse.
        """
        if len(maps) == 1:
            errors = PointErrors.of(posterior, grid, weights)
            return cls(maps, jax.tree.map(lambda leaf: leaf[None], errors))

        def one(linear: Float[Array, "2 2"]) -> PointErrors:
            mapped = eqx.tree_at(lambda gp: gp.x, posterior, matmul(posterior.x, linear.T))
            mapped = mapped.refitted(posterior.kernel, posterior.noise_variance)
            return PointErrors.of(mapped, matmul(grid, linear.T), weights)

        return cls(maps, jax.lax.map(one, maps))

    def error(
        self,
        index: Int[Array, ""] | int,
        samples: Float[Array, "S 2"],
        is_taken: Bool[Array, "S"],
        samples_per_point: Number,
    ) -> Scalar:
        """Expected root mean squared error after the samples, under one of the beliefs."""
        errors = jax.tree.map(lambda leaf: leaf[index], self.errors)
        return errors.after(matmul(samples, self.maps[index].T), is_taken, samples_per_point)

    def mean_error(
        self, routes: Float[Array, "K W 2"], spacing: Number, number: int, samples_per_point: Number = 1.0
    ) -> Scalar:
        """Expected root mean squared error after the routes of all robots, averaged over the beliefs."""
        sampled = samples_of_all(routes, spacing, number)
        indices = jnp.arange(self.maps.shape[0], dtype=jnp.int32)
        return jnp.mean(jax.lax.map(lambda index: self.error(index, *sampled, samples_per_point), indices))


class Limits(eqx.Module):
    """Limits of a route, as penalties."""

    distance: PyTree  # signed distance to the border of the area, m, negative outside; None without a border
    clearance: Float[Array, ""]  # distance that the route keeps from the border, m
    turning_radius: Float[Array, ""] | None  # least radius of its turns, m; None for any
    # Least distance between two robots that have driven equally far, m; 0 for any
    separation: Float[Array, ""]

    def penalty(self, routes: Float[Array, "K W 2"], step: Float[Array, ""], number: int) -> Scalar:
        """Penalty of the points at every `step` metres of all routes; 0 if they keep all limits there."""
        each = jax.vmap(lambda route: self._penalty_of_one(route, step, number))(routes)
        return jnp.sum(each) + self._closeness(routes, step, number)

    def _closeness(self, routes: Float[Array, "K W 2"], step: Float[Array, ""], number: int) -> Scalar:
        """Squared lack of distance of each pair of robots; both ends, which may be common, are left out."""
        distances = step * jnp.arange(1, number, dtype=routes.dtype)
        points = jax.vmap(points_at, (0, None))(routes, distances)
        total = jnp.zeros((), routes.dtype)
        for first in range(len(routes)):
            for second in range(first):
                squared = jnp.sum((points[first] - points[second]) ** 2, axis=-1)
                # Squares, since the root of 0 has no gradient; in units of the separation.
                least = jnp.maximum(self.separation, jnp.finfo(routes.dtype).tiny) ** 2
                total = total + jnp.mean(jnp.maximum(1.0 - squared / least, 0.0))
        return jnp.where(self.separation > 0.0, total, 0.0)

    def _penalty_of_one(self, route: Float[Array, "W 2"], step: Float[Array, ""], number: int) -> Scalar:
        """Penalty of the points at every `step` metres of a route for the border and the turns."""
        points = points_at(route, step * jnp.arange(number + 1, dtype=route.dtype))
        total = jnp.zeros((), route.dtype)
        if self.distance is not None:
            lacking = jnp.maximum(self.clearance - self.distance(points), 0.0)
            total = total + jnp.sum(lacking**2) / step**2
        if self.turning_radius is not None:
            total = total + jnp.sum(_smooth_lacking(route, self.turning_radius) ** 2) / step**2
        return total

    def saved_by_arcs(self, route: Float[Array, "W 2"]) -> Scalar:
        """Most of the length by which arcs at the corners of a route are shorter than its legs, m."""
        if self.turning_radius is None:
            return jnp.zeros((), route.dtype)
        tangents, _ = _smooth_half_tangents(route)
        return SAVED * jnp.sum(2.0 * self.turning_radius * (tangents - jnp.arctan(tangents)))


def _smooth_half_tangents(route: Float[Array, "W 2"]) -> tuple[Float[Array, "W-2"], Float[Array, "W-1"]]:
    """Tangents of half of the turns, nearly as in `bojax.surveys.turns`, and lengths of legs.

    The tangents are bounded, and have gradients in straight lines.
    """
    legs = jnp.diff(route, axis=0)
    # Where legs have no length, the square of 1 / length occurs in gradients, and must not overflow.
    lengths = jnp.sqrt(jnp.sum(legs**2, axis=-1) + 1e-12)
    cosine = jnp.sum(legs[1:] * legs[:-1], axis=-1) / (lengths[1:] * lengths[:-1])
    return jnp.sqrt(jnp.maximum(1.0 - cosine, 0.0) / (1.01 + cosine) + 1e-6) - 1e-3, lengths


def _smooth_lacking(route: Float[Array, "W 2"], radius: Float[Array, ""]) -> Float[Array, "W-1"]:
    """The length that each leg lacks for the arcs at its ends, m."""
    tangents, lengths = _smooth_half_tangents(route)
    tangents = jnp.pad(tangents, 1)
    return jnp.maximum(radius * (tangents[1:] + tangents[:-1]) - lengths, 0.0)


@eqx.filter_jit
def descend(
    first: Float[Array, "R K W 2"],
    ends: Sequence[Ends],
    budget: Float[Array, "*K"],
    models: Models,
    limits: Limits,
    spacing: Float[Array, ""],
    number: int,
    samples_per_point: Number,
    num_steps: int,
    rate: Float[Array, ""],
) -> Float[Array, "R K W 2"]:
    """Routes of small expected error, by Adam from first guesses.

    Step t descends the error under belief t mod Q: a step costs as much as under one belief, and the average
    over them is minimised as the rate goes to zero.

    Args:
        first: First guesses, each one route for every robot.
        ends: Fixed ends of each robot.
        budget: Maximum length of all routes, or of each robot's, m.
        models: Plausible beliefs.
        limits: Limits of the routes.
        spacing: Distance of two samples of the optimisation, m.
        number: Number of samples that the largest budget allows.
        samples_per_point: Number of measurements that each of them stands for.
        num_steps: Number of steps of Adam.
        rate: Its first rate, m, which decays to zero along a cosine.
    """
    num_models = models.maps.shape[0]
    budgets = [budget] * len(ends) if budget.ndim == 0 else list(budget)

    def rate_at(step: Any) -> Any:
        return rate * optax.cosine_decay_schedule(1.0, num_steps)(step)

    adam = optax.adam(rate_at)

    def drawn_in(points: Float[Array, "K W 2"]) -> Float[Array, "K W 2"]:
        together = zip(points, ends, budgets, strict=True)
        routes = [within_budget(each, fixed, own) for each, fixed, own in together]
        if limits.turning_radius is not None:  # arcs at the corners leave some of the budget
            left = [own + limits.saved_by_arcs(route) for own, route in zip(budgets, routes, strict=True)]
            together = zip(points, ends, left, strict=True)
            routes = [within_budget(each, fixed, own) for each, fixed, own in together]
        return jnp.stack(routes)

    def loss(points: Float[Array, "K W 2"], step: Int[Array, ""]) -> Scalar:
        routes = drawn_in(points)
        samples, is_taken = samples_of_all(routes, spacing, number)
        error = models.error(step % num_models, samples, is_taken, samples_per_point)
        # Waypoints beyond the budget are drawn in; the second penalty keeps them from running away.
        lengths = jnp.stack(
            [
                path_length(fixed.fixed(each)) - limits.saved_by_arcs(route)
                for each, route, fixed in zip(points, routes, ends, strict=True)
            ]
        )
        excess = jnp.sum(jnp.maximum(lengths / budget - 1.0, 0.0) ** 2)
        scale = models.errors.variance.mean() ** 0.5
        # Half the sampling distance, so that no corner of a forbidden zone lies between two points.
        allowed = limits.penalty(routes, spacing / 2.0, 2 * number)
        return error + scale * (allowed + excess)

    def descended(points: Float[Array, "K W 2"]) -> Float[Array, "K W 2"]:
        def step(number, carry):
            points, state = carry
            gradient = jax.grad(loss)(points, number)
            with jax.numpy_dtype_promotion("standard"):  # optax multiplies numbers of two widths
                updates, state = adam.update(gradient, state)
            return points + jnp.asarray(updates), state

        points, _ = jax.lax.fori_loop(0, num_steps, step, (points, adam.init(points)))
        return drawn_in(points)

    return jax.vmap(descended)(first)
