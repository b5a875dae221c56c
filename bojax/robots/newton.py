"""The accelerations of MJX under constraints, by Newton's method with an exact line search."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bojax.numerics.lanes import batched_together
from bojax.robots.models import MjModel, mujoco

_MOST_POINTS = 32
"""Limit of the points that `search_by_points` evaluates; only rounding can make it evaluate more than ten."""


class Rows(NamedTuple):
    """The constraints; equalities come first, then dry friction, then limits and contacts."""

    stiffness: Float[Array, "R"]  # D
    low: Float[Array, "R"]  # least derivative of the cost of a row
    high: Float[Array, "R"]  # largest derivative of it
    first_friction: int  # number of the first row of dry friction
    first_limit: int  # number of the first row of a limit or a contact

    def derivative(self, x: Float[Array, "R"]) -> Float[Array, "R"]:
        """The derivatives of the costs of the rows at x."""
        return jnp.clip(self.stiffness * x, self.low, self.high)

    def side(self, x: Float[Array, "R"]) -> Int[Array, "R"]:
        """0 within the range, -1 below and 1 above."""
        y = self.stiffness * x
        # A kernel knows which rows have no lower bound, and leaves their comparisons out.
        is_below = (y <= self.low) & (self.low > -jnp.inf)
        return (y >= self.high).astype(jnp.int32) - is_below.astype(jnp.int32)


class Line(NamedTuple):
    """The cost along a line, from its start to the whole step of Newton's method and beyond.

    Its derivative at t, first + t second + sum c_i s_i'(x_i + t c_i), is piecewise linear and increases.
    """

    rows: Rows  # the constraints
    x: Float[Array, "R"]  # J a - a_ref at the start
    change: Float[Array, "R"]  # its change c in the whole step
    first: Float[Array, ""]  # derivative of the inertial cost at the start
    second: Float[Array, ""]  # second derivative of it

    def slope(self, size: Float[Array, ""]) -> Float[Array, ""]:
        """The derivative at a point of the line."""
        force = self.rows.derivative(self.x + size * self.change)
        return self.first + size * self.second + jnp.sum(self.change * force)

    def side(self, size: Float[Array, ""]) -> Int[Array, "R"]:
        """Sides of the rows at a point of the line."""
        return self.rows.side(self.x + size * self.change)

    def root(self, size: Float[Array, ""], side: Int[Array, "R"]) -> Float[Array, ""]:
        """The root of the derivative, if it is on the same piece as a point with these sides."""
        curvature = self.second + jnp.sum(jnp.where(side == 0, self.rows.stiffness * self.change**2, 0.0))
        return size - self.slope(size) / jnp.where(curvature > 0.0, curvature, jnp.inf)


Search = Callable[[Line], Float[Array, ""]]
"""Gives the minimum of a line, in whole steps."""


def search_at_ends(line: Line) -> Float[Array, ""]:
    """The minimum of a line, whose piece is found from the derivative at the ends of all pieces at once.

    In a program of XLA on a GPU, this makes steps three times as fast as `search_by_points` does.
    """
    # The ends of the pieces are where a row reaches a bound of its range. The derivative increases, so that
    # the piece with the root lies between the last end with a negative derivative and the first other one.
    rows = line.rows
    lower, upper = ((bound / rows.stiffness - line.x) / line.change for bound in (rows.low, rows.high))
    ends = jnp.concatenate([lower[rows.first_friction : rows.first_limit], upper[rows.first_friction :]])
    is_end = (ends > 0.0) & (ends < jnp.inf)
    is_before = jax.vmap(line.slope)(jnp.where(is_end, ends, 0.0)) < 0.0
    left = jnp.max(jnp.where(is_end & is_before, ends, 0.0))
    right = jnp.min(jnp.where(is_end & ~is_before, ends, jnp.inf))
    # A point of the piece, near the full step: far from it, rounding errors are large.
    middle = jnp.minimum(0.5 * (left + right), left + 1.0)
    return jnp.clip(line.root(middle, line.side(middle)), left, right)


def search_by_points(line: Line) -> Float[Array, ""]:
    """The minimum of a line, by Newton's method for the root of the derivative, in a bracket.

    In a kernel with a warp for each lane, steps are two to three times as fast as with `search_at_ends`.
    """

    # Most often the whole step is the minimum, and this is known after one point: Newton's step from there
    # stays on the piece. A root outside the bracket is replaced by its middle, or by twice the step if it has
    # no right end.
    def closer(state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        number, size, left, right, _ = state
        side, is_left = line.side(size), line.slope(size) < 0.0
        left, right = jnp.where(is_left, size, left), jnp.where(is_left, right, size)
        root = line.root(size, side)
        is_inside = ((root > left) & (root < right)) | (root == size)
        between = jnp.where(right < jnp.inf, 0.5 * (left + right), 2.0 * size)
        following = jnp.where(is_inside, root, between)
        # If no row changes sides on the way, the derivative is linear there.
        return number + 1, following, left, right, ~is_inside | jnp.any(line.side(following) != side)

    zero, one = jnp.zeros_like(line.first), jnp.ones_like(line.first)
    start = batched_together((jnp.zeros((), jnp.int32), one, zero, one * jnp.inf, jnp.ones((), bool)))
    return jax.lax.while_loop(lambda state: (state[0] < _MOST_POINTS) & state[4], closer, start)[1]


def has_clipped_forces(model: MjModel) -> bool:
    """Whether `constrained` applies: the solver is Newton's, and no contact has an elliptic friction cone."""
    is_newton = model.opt.solver == int(mujoco.mjtSolver.mjSOL_NEWTON)
    return is_newton and model.opt.cone == int(mujoco.mjtCone.mjCONE_PYRAMIDAL)


def constrained(model: Any, data: Any, inertia: Float[Array, "V V"], search: Search = search_at_ends) -> Any:
    """The data of MJX with the accelerations and the constraint forces, as `mjx.solve` computes them.

    The accelerations a minimise 1/2 (a - b)'M (a - b) + sum s_i(x_i), with the unconstrained accelerations b
    and x = J a - a_ref (MuJoCo's documentation, "Computation"). The derivative of every s_i is D_i x_i,
    clipped to a range: any number for equalities, the friction loss for dry friction, and nothing above 0 for
    limits and contacts, which only push.

    The derivative of the cost along a line is therefore piecewise linear, and its root is found exactly; MJX
    evaluates three points in each of `ls_iterations` iterations. Newton's method ends after an iteration in
    which every row stays within, below or above its range: the cost was quadratic on the way, and its minimum
    is reached.

    Deviation: `ls_iterations` and `tolerance` have no influence.
    """
    efc = data._impl
    jacobian, stiffness = efc.efc_J, efc.efc_D
    if not len(stiffness):
        return data.replace(qacc=data.qacc_smooth)
    index, first_friction, first_limit = np.arange(len(stiffness)), efc.ne, efc.ne + efc.nf
    is_equality, is_limit = index < first_friction, index >= first_limit
    low = jnp.where(is_equality | is_limit, -jnp.inf, -efc.efc_frictionloss)
    rows = Rows(stiffness, low, jnp.where(is_limit, 0.0, -low), first_friction, first_limit)

    # Every row is a quadratic whose derivative is clipped to [low, high]: equalities have no bounds, dry
    # friction both, limits and contacts only the upper one, 0. One formula serves all, with no branch on the
    # kind of a row.
    def violation(acceleration: jax.Array) -> jax.Array:
        return jacobian @ acceleration - efc.efc_aref

    # Within its range, a row costs y x / 2. Beyond it, limits and contacts cost nothing, and y is 0.
    def cost(x: jax.Array) -> jax.Array:
        y = rows.derivative(x)
        is_friction = ~(is_equality | is_limit)
        return jnp.sum(y * x - 0.5 * jnp.where(is_friction, y * y / stiffness, y * x))

    def iterate(loop: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        number, acceleration, x, _ = loop
        before = rows.side(x)
        inertial = inertia @ (acceleration - data.qacc_smooth)
        # Only rows within their range have curvature. The sum is symmetric but for rounding, and the Cholesky
        # factor reads one triangle: a kernel does not compute the other one.
        active = jnp.where(before == 0, stiffness, 0.0)
        hessian = inertia + (jacobian.T * active[None, :]) @ jacobian
        factor = jax.scipy.linalg.cho_factor(hessian)
        direction = -jax.scipy.linalg.cho_solve(factor, inertial + jacobian.T @ rows.derivative(x))
        first, second = direction @ inertial, direction @ (inertia @ direction)
        change = jacobian @ direction
        size = search(Line(rows, x, change, first, second))
        acceleration = acceleration + size * direction
        # If no row has changed sides, the cost was quadratic on the way and its minimum is reached.
        x = x + size * change
        return number + 1, acceleration, x, jnp.any(rows.side(x) != before)

    # As MJX does: start from the last accelerations, or from the unconstrained ones if those cost less.
    starts = jnp.stack([data.qacc_warmstart, data.qacc_smooth])
    violations, excess = jax.vmap(violation)(starts), data.qacc_warmstart - data.qacc_smooth
    costs = jax.vmap(cost)(violations)
    is_warm = costs[0] + 0.5 * excess @ (inertia @ excess) < costs[1]
    start, x = (jnp.where(is_warm, *pair) for pair in (starts, violations))
    loop = batched_together((jnp.zeros((), jnp.int32), start, x, jnp.ones((), bool)))
    _, acceleration, x, _ = jax.lax.while_loop(
        lambda loop: (loop[0] < model.opt.iterations) & loop[3], iterate, loop
    )
    force = -(jacobian.T @ rows.derivative(x))
    return data.replace(qacc=acceleration, qfrc_constraint=force)
