"""A gallery of the trajectories of a family (Fig. 4.2)."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key, Scalar
from typing_extensions import override

from bojax.experiments.base import Experiment, Records
from bojax.motions.base import DiscreteMotions, Motions
from bojax.numerics.angles import wrap_to_pi
from bojax.results.schema import Column, Table


class Gallery(eqx.Module):
    """The state of a run of `TrajectoryGallery`.

    Attributes:
        key: Key of the run.
        is_done: Whether the run has ended.
    """

    key: Key[Array, ""]
    is_done: Bool[Array, ""]


class TrajectoryGallery(Experiment):
    """All paths of a discrete set, or a grid over the parameters of a continuous family.

    A run also draws one path at random, as the random planner does, and measures its turns.

    Settings: `bojax.experiments.settings.Trajectories`.
    """

    motions: Motions
    levels: int = eqx.field(static=True)

    @property
    @override
    def tables(self) -> Mapping[str, Table]:
        return {"runs": _RUN_COLUMNS}

    @property
    @override
    def max_advances(self) -> int:
        return 1

    @override
    def init(self, key: Key[Array, ""]) -> Gallery:
        return Gallery(key, jnp.zeros((), bool))

    @override
    def advance(self, carry: Gallery) -> tuple[Gallery, Records]:
        records = Records(tables={}, active_steps=(~carry.is_done).astype(jnp.int32))
        return Gallery(carry.key, jnp.ones_like(carry.is_done)), records

    @override
    def is_done(self, carry: Gallery) -> Bool[Array, ""]:
        return carry.is_done

    @override
    def summary(self, carry: Gallery) -> dict[str, Scalar]:
        heading = self.motions.sample(carry.key)[:, 2]
        turns = wrap_to_pi(jnp.diff(heading)) * (heading.shape[0] / self.motions.length)
        return {
            "trajectories": jnp.asarray(self.paths().shape[0], jnp.int32),
            "curvature": jnp.sqrt(jnp.mean(turns**2)),
            "start_turn": jnp.abs(wrap_to_pi(heading[0])),
            "end_turn": jnp.abs(wrap_to_pi(heading[-1])),
        }

    @override
    def snapshot(self, carry: Gallery) -> dict[str, dict[str, Array]]:
        return {"trajectories": {"paths": self.paths()}}

    def paths(self) -> Float[Array, "K S 3"]:
        """The paths of the gallery."""
        if isinstance(self.motions, DiscreteMotions):
            return self.motions.paths()
        axis = jnp.linspace(-1.0, 1.0, self.levels, dtype=self.motions.length.dtype)
        grid = jnp.meshgrid(*[axis] * self.motions.num_params, indexing="ij")
        return jax.vmap(self.motions.path)(jnp.stack([g.ravel() for g in grid], axis=-1))


_RUN_COLUMNS: Table = (
    Column("trajectories", "int32", "", "trajectories drawn"),
    Column("curvature", "float64", "1/m", "root mean square curvature of a random path between its poses"),
    Column("start_turn", "float64", "rad", "angle of its first pose from the heading of the robot"),
    Column("end_turn", "float64", "rad", "angle of its last pose from the heading of the robot"),
)
