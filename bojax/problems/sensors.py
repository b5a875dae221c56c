"""How a robot measures a field."""

import abc
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from bojax.fields.base import Field
from bojax.robots.quaternions import rotation_of
from bojax.robots.range_sensor import cone, ranges


class Sensor(eqx.Module):
    """Measures a field where a robot is."""

    def check(self, field: Field, points: Float[Array, "N 2"], altitude: float | None) -> None:
        """Compare with the field at some points, and with the altitude of the robot; None on the ground.

        Raises:
            ValueError: The sensor cannot measure it from there.
        """
        del field, points, altitude

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


class RangeSensor(Sensor):
    """Measures the height of the ground from above, by the distance to it (thesis, Section 3.5.2).

    A reading is the `"mean"` distance along rays that fill the beam, or the `"minimum"`, plus noise; what is
    farther than `max_range` reads as that. The height is what is left of the robot's altitude, of which it
    has a reading too, after the distance along the beam, by default put upright with the robot's attitude,
    which it knows. It counts as measured at the robot's own position, as in the thesis, although a robot
    that leans by 3 degrees 1.5 m above the ground sees a place 8 cm away.

    Attributes:
        beam: Full opening angle of the beam, in rad.
        max_range: How far it sees, in metres.
        altitude_noise: Standard deviation of a reading of the altitude, in metres.
        rays: Rays in the beam.
        reading: Which distance it tells.
        upright: Whether the height takes account of the attitude.
    """

    beam: Float[Array, ""]
    max_range: Float[Array, ""]
    altitude_noise: Float[Array, ""]
    rays: int = eqx.field(static=True)
    reading: Literal["mean", "minimum"] = eqx.field(static=True)
    upright: bool = eqx.field(static=True)

    def check(self, field: Field, points: Float[Array, "N 2"], altitude: float | None) -> None:
        """See `Sensor`."""
        if altitude is None:
            raise ValueError("sensor: range looks down from above: vehicle has to be one that flies")
        depth = altitude - float(jnp.min(field.values(points)))
        if depth > float(self.max_range):
            raise ValueError(
                f"sensor.max_range: got {float(self.max_range):g}; the ground is up to {depth:.2f} m below: "
                "fly lower, or see farther"
            )

    def __call__(
        self,
        key: Key[Array, ""],
        field: Field,
        poses: Float[Array, "S 3"],
        mounts: Float[Array, "S 7"] | None,
        noise: Float[Array, ""],
    ) -> Float[Array, "S"]:
        """See `Sensor`; `noise` is that of a distance."""
        assert mounts is not None, "see `check`"
        del poses
        mounts = mounts.astype(noise.dtype)
        rays = cone(self.beam, self.rays)

        def measure(mount: Float[Array, "7"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
            rotation = rotation_of(mount[3:])
            distances = ranges(field.values, mount[:3], rotation, rays, self.max_range)
            reading = jnp.mean(distances) if self.reading == "mean" else jnp.min(distances)
            return reading, rotation[2, 2] if self.upright else jnp.ones_like(reading)

        distances, drop = jax.vmap(measure)(mounts)
        errors = jax.random.normal(key, (2, *distances.shape), distances.dtype)
        distances = jnp.clip(distances + noise * errors[0], 0.0, self.max_range)
        return mounts[:, 2] + self.altitude_noise * errors[1] - drop * distances
