"""Whether kernels and means of one number per dimension fit the points that they are used on."""

import jax
import jax.numpy as jnp

from bojax.models.kernels import RBF, Kernel, Matern12, Matern32, Matern52
from bojax.models.means import LinearMean, Mean


def check_dimensions(name: str, function: Kernel | Mean, num_dims: int, meaning: str) -> None:
    """Refuse a list of lengthscales or weights that is not as long as there are dimensions.

    Args:
        name: The setting that holds the function.
        function: A kernel or a mean, alone or made of others.
        num_dims: Number of dimensions of the points.
        meaning: Of what there is one in each dimension, for the message.

    Raises:
        ValueError: A list has another length; the message names the setting.
    """
    stationary = (RBF, Matern12, Matern32, Matern52)
    parts = jax.tree_util.tree_leaves_with_path(
        function, is_leaf=lambda node: isinstance(node, (*stationary, LinearMean))
    )
    for path, part in parts:
        if isinstance(part, stationary):
            setting, shape, fits = "lengthscale", jnp.shape(part.lengthscale), ((), (1,), (num_dims,))
        elif isinstance(part, LinearMean):
            setting, shape, fits = "weights", jnp.shape(part.weights), ((num_dims,),)
        else:
            continue
        if shape not in fits:
            where = f"{name}{jax.tree_util.keystr(path)}.{setting}"
            alone = "one number, or " if () in fits else ""
            got = f"{shape[0]} numbers" if len(shape) == 1 else f"shape {shape}"
            raise ValueError(f"{where}: got {got}; allowed: {alone}{num_dims}, one for each {meaning}")
