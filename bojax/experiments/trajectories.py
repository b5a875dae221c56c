"""A gallery of the trajectories of a family (Fig. 4.2)."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key, Scalar
from typing_extensions import override

from bojax.experiments.base import Experiment, Records
from bojax.motions.base import DiscreteMotions, Motions
from bojax.motions.kernel_effects import kernel_effects
from bojax.motions.kernel_trajectories import KernelTrajectories
from bojax.numerics.angles import wrap_to_pi
from bojax.results.schema import Column, Table


class Gallery(eqx.Module):
    """The state of a run of `TrajectoryGallery`."""

    key: Key[Array, ""]  # key of the run
    is_done: Bool[Array, ""]  # whether the run has ended


class TrajectoryGallery(Experiment):
    """All paths of a discrete set, or a grid over the parameters of a continuous family.

    A run also draws one path at random, as the random planner does, and measures its turns, and for kernel
    trajectories what each of the two kernels changes.

    Settings: `bojax.experiments.settings.Trajectories`.
    """

    motions: Motions
    levels: int = eqx.field(static=True)

    @property
    @override
    def tables(self) -> Mapping[str, Table]:
        has_kernels = isinstance(self.motions, KernelTrajectories)
        return {"runs": _RUN_COLUMNS + (_KERNEL_COLUMNS if has_kernels else ())}

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
        if isinstance(self.motions, KernelTrajectories):
            params = self.motions.draw(carry.key)
            path, effects = self.motions.path(params), kernel_effects(self.motions, params)
        else:
            path, effects = self.motions.sample(carry.key), {}
        heading = path[:, 2]
        turns = wrap_to_pi(jnp.diff(heading)) * (heading.shape[0] / self.motions.length)
        return {
            "trajectories": jnp.asarray(self.paths().shape[0], jnp.int32),
            "curvature": jnp.sqrt(jnp.mean(turns**2)),
            "start_turn": jnp.abs(wrap_to_pi(heading[0])),
            "end_turn": jnp.abs(wrap_to_pi(heading[-1])),
            **effects,
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

_EFFECT = "logarithm of the ratio of two changes of {} of that path: those by halving the lengthscale on {}"

_KERNEL_COLUMNS: Table = (
    Column("speed_by_time", "float64", "", _EFFECT.format("the speed", "time and on positions"), True),
    Column(
        "acceleration_by_time",
        "float64",
        "",
        _EFFECT.format("the rate of change of the speed", "time and on positions"),
        True,
    ),
    Column("turns_by_space", "float64", "", _EFFECT.format("the turns", "positions and on time"), True),
)
