"""How a robot measures a field."""

import abc

import equinox as eqx
import jax
from jaxtyping import Array, Float, Key

from bojax.fields.base import Field


class Sensor(eqx.Module):
    """Measures a field where a robot is."""

    @abc.abstractmethod
    def __call__(
        self,
        key: Key[Array, ""],
        field: Field,
        poses: Float[Array, "S 3"],
        mounts: Float[Array, "S 7"] | None,
        noise: Float[Array, ""],
    ) -> Float[Array, "S"]:
        """Measurements.

        Args:
            key: What the noise is drawn from.
            field: The field as it is.
            poses: Where the robot really was.
            mounts: Where its sensor was, see `Ride`.
            noise: Standard deviation of a measurement, in units of the field.
        """


class PointSensor(Sensor):
    """Reads the value at the robot's position."""

    def __call__(
        self,
        key: Key[Array, ""],
        field: Field,
        poses: Float[Array, "S 3"],
        mounts: Float[Array, "S 7"] | None,
        noise: Float[Array, ""],
    ) -> Float[Array, "S"]:
        """See `Sensor`."""
        del mounts
        points = poses[:, :2]
        return field.values(points) + noise * jax.random.normal(key, points.shape[:1], points.dtype)
