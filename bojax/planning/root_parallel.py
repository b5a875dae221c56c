"""Root parallelisation: independent searches of one plan, whose root actions are judged together.

Chaslot, Winands and van den Herik, Parallel Monte-Carlo tree search (Computers and Games 2008). Trees with
continuous actions have no action in common; Kurzer, Hoertnagl and Zoellner, Parallelization of Monte Carlo
tree search in continuous domains (2020, arXiv 2003.13741), weigh each by its similarity to the others.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Num

from bojax.planning.tree import Recommendation, RootActions
from bojax.problems.actions import ActionSpace


def recommended_by_all(
    space: ActionSpace, roots: RootActions, lengthscale: Float[Array, ""], by_value: bool | Array
) -> Recommendation:
    """The best of the actions that each tree recommends, as judged by all trees.

    The value of an action a is the mean return of all simulations of all trees, weighted by the similarity
    k(a, a') = exp(-|a - a'|^2 / (2 l^2)) to their first actions a': sum k R / sum k n, for sums of returns R
    and visits n. Actions of different levels have no similarity. Distances are those of
    `ActionSpace.coordinates`, and l is the `lengthscale`. Roots have a leading axis of trees. Without
    `by_value`, the action with the most visits is recommended, weighted by similarity.
    """
    nominees = jax.vmap(lambda root: root.recommended(by_value).parameters)(roots)
    parameters, visits, returns = (leaf.reshape(-1, *leaf.shape[2:]) for leaf in roots)
    against_all = jax.vmap(lambda one, two: _similarity(space, lengthscale, one, two), (None, 0))
    # Sums in place of a matrix product, whose precision differs between devices.
    weights = jax.vmap(against_all, (0, None))(nominees, parameters)
    visits = jnp.sum(weights * visits[None], axis=1)
    pooled = RootActions(nominees, visits, jnp.sum(weights * returns[None], axis=1))
    return pooled.recommended(by_value)


def _similarity(
    space: ActionSpace, lengthscale: Float[Array, ""], one: Num[Array, "P"], two: Num[Array, "P"]
) -> Float[Array, ""]:
    difference = space.coordinates(one) - space.coordinates(two)
    kernel = jnp.exp(-0.5 * jnp.sum(difference**2) / lengthscale**2)
    return jnp.where(space.level(one) == space.level(two), kernel, 0.0)
