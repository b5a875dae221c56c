"""The accelerations of MJX under constraints, by Newton's method with an exact line search."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bojax.numerics.lanes import batched_together
from bojax.robots.models import MjModel, mujoco


def has_clipped_forces(model: MjModel) -> bool:
    """Whether `constrained` applies: the solver is Newton's, and no contact has an elliptic friction cone."""
    is_newton = model.opt.solver == int(mujoco.mjtSolver.mjSOL_NEWTON)
    return is_newton and model.opt.cone == int(mujoco.mjtCone.mjCONE_PYRAMIDAL)


def constrained(model: Any, data: Any, inertia: Float[Array, "V V"]) -> Any:
    """The data of MJX with the accelerations and the constraint forces, as `mjx.solve` computes them.

    The accelerations a minimise 1/2 (a - b)'M (a - b) + sum s_i(x_i), with the unconstrained accelerations b
    and x = J a - a_ref (MuJoCo's documentation, "Computation"). The derivative of every s_i is D_i x_i,
    clipped to a range: any number for equalities, the friction loss for dry friction, and nothing above 0 for
    limits and contacts, which only push.

    The derivative of the cost along a line is therefore piecewise linear. The piece that contains its root is
    found from its values at the ends of all pieces at once. MJX brackets the root in a loop, whose iterations
    are most of the kernels of a step on a GPU. Newton's method ends after an iteration in which every row
    stays within, below or above its range: the cost was quadratic on the way, and its minimum is reached.

    Deviation: `ls_iterations` and `tolerance` have no influence.

    Args:
        model: Model of MJX.
        data: Data of MJX, with the unconstrained accelerations and the rows of the constraints.
        inertia: The inertia matrix M.
    """
    rows = data._impl
    jacobian, stiffness = rows.efc_J, rows.efc_D
    if not len(stiffness):
        return data.replace(qacc=data.qacc_smooth)
    # Equalities come first, then dry friction, then limits and contacts.
    index, first_friction, first_limit = np.arange(len(stiffness)), rows.ne, rows.ne + rows.nf
    is_equality, is_limit = index < first_friction, index >= first_limit
    low = jnp.where(is_equality | is_limit, -jnp.inf, -rows.efc_frictionloss)
    high = jnp.where(is_limit, 0.0, -low)

    def violation(acceleration: jax.Array) -> jax.Array:
        return jacobian @ acceleration - rows.efc_aref

    def derivative(x: jax.Array) -> jax.Array:
        return jnp.clip(stiffness * x, low, high)

    def cost(acceleration: jax.Array) -> jax.Array:
        x, excess = violation(acceleration), acceleration - data.qacc_smooth
        y = derivative(x)
        return 0.5 * excess @ (inertia @ excess) + jnp.sum(y * x - 0.5 * y * y / stiffness)

    def side(x: jax.Array) -> jax.Array:
        """0 within the range, -1 below and 1 above."""
        return (stiffness * x >= high).astype(jnp.int32) - (stiffness * x <= low).astype(jnp.int32)

    def iterate(loop: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        number, acceleration, _ = loop
        x = violation(acceleration)
        before = side(x)
        inertial = inertia @ (acceleration - data.qacc_smooth)
        active = jnp.where(before == 0, stiffness, 0.0)
        hessian = inertia + (jacobian.T * active[None, :]) @ jacobian
        factor = jax.scipy.linalg.cho_factor(0.5 * (hessian + hessian.T))
        direction = -jax.scipy.linalg.cho_solve(factor, inertial + jacobian.T @ derivative(x))
        change = jacobian @ direction

        # The derivative along the line, at the ends of its pieces.
        first, second = direction @ inertial, direction @ (inertia @ direction)

        def slope(size: jax.Array) -> jax.Array:
            return first + size * second + jnp.sum(change * derivative(x + size * change))

        lower, upper = ((bound / stiffness - x) / change for bound in (low, high))
        ends = jnp.concatenate([lower[first_friction:first_limit], upper[first_friction:]])
        is_end = (ends > 0.0) & (ends < jnp.inf)
        is_before = jax.vmap(slope)(jnp.where(is_end, ends, 0.0)) < 0.0
        left = jnp.max(jnp.where(is_end & is_before, ends, 0.0))
        right = jnp.min(jnp.where(is_end & ~is_before, ends, jnp.inf))
        # A point of the piece, near the full step: far from it, rounding errors are large.
        middle = jnp.minimum(0.5 * (left + right), left + 1.0)
        is_within = side(x + middle * change) == 0
        curvature = second + jnp.sum(jnp.where(is_within, stiffness * change**2, 0.0))
        size = middle - slope(middle) / jnp.where(curvature > 0.0, curvature, jnp.inf)
        acceleration = acceleration + jnp.clip(size, left, right) * direction
        has_changed = jnp.any(side(violation(acceleration)) != before)
        return number + 1, acceleration, has_changed

    starts = jnp.stack([data.qacc_warmstart, data.qacc_smooth])
    costs = jax.vmap(cost)(starts)
    start = jnp.where(costs[0] < costs[1], *starts)
    loop = batched_together((jnp.zeros((), jnp.int32), start, jnp.ones((), bool)))
    _, acceleration, _ = jax.lax.while_loop(
        lambda loop: (loop[0] < model.opt.iterations) & loop[2], iterate, loop
    )
    force = -(jacobian.T @ derivative(violation(acceleration)))
    return data.replace(qacc=acceleration, qfrc_constraint=force)
