"""Attitudes as unit quaternions (w, x, y, z), the convention of MuJoCo."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def rotation_matrix(quaternion: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def yaw_of(quaternion: Float[Array, "*N 4"]) -> Float[Array, "*N"]:
    """Heading of a unit quaternion (w, x, y, z), in [-pi, pi] rad."""
    w, x, y, z = (quaternion[..., index] for index in range(4))
    return jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def rotate_yaw(quaternion: Float[Array, "4"], yaw: Float[Array, ""]) -> Float[Array, "4"]:
    """The attitude rotated about the vertical axis of the world by an angle in rad."""
    w, x, y, z = quaternion
    cos, sin = jnp.cos(0.5 * yaw), jnp.sin(0.5 * yaw)
    return jnp.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w])
