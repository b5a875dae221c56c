"""Maps of the values Q and U of a learner over the observations (Figs. 5.6 and 5.7)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Scalar

from bojax.envs.spaces import Box, Space
from bojax.learning.base import Learner, LearnerState
from bojax.results.schema import Column, Table


def value_map(
    learner: Learner, state: LearnerState, observations: Space, actions: Space, resolution: int
) -> Float[Array, "2 *grid"]:
    """Q and U at the middle action.

    For a discrete space, the values of every observation. For a box, the values at the centres of
    `resolution` cells along each of the first two dimensions, with the other dimensions at their middle.
    """
    dtype = learner.exploration_weight.dtype
    if isinstance(actions, Box):
        action = 0.5 * (actions.low + actions.high)
    else:
        action = jnp.asarray(actions.num // 2, jnp.int32)
    values = jax.vmap(lambda observation: learner.values(state, observation, action))
    if not isinstance(observations, Box):
        return jnp.stack(values(jnp.arange(observations.num, dtype=jnp.int32)))
    axis = (jnp.arange(resolution, dtype=dtype) + 0.5) / resolution
    first, second = jnp.meshgrid(axis, axis, indexing="ij")
    unit = jnp.full((resolution, resolution, observations.num_dims), 0.5, dtype)
    unit = unit.at[..., 0].set(first)
    unit = unit.at[..., 1].set(second) if observations.num_dims > 1 else unit
    return jnp.stack(jax.lax.map(values, observations.from_unit(unit)))  # one row of cells at a time


class Visits(eqx.Module):
    """The cells of a map over two observations that a run has visited."""

    seen: Bool[Array, "R R"]  # whether a training step was taken in the cell
    starts: Bool[Array, "R R"]  # whether a training episode began in the cell

    @classmethod
    def none(cls, resolution: int) -> "Visits":
        """No visits."""
        nowhere = jnp.zeros((resolution, resolution), bool)
        return cls(nowhere, nowhere)

    def after(self, unit: Float[Array, "T 2"], length: Int[Array, ""]) -> "Visits":
        """The visits after an episode of `length` steps, from observations in [0, 1] before them."""
        resolution = self.seen.shape[0]
        cells = jnp.clip(jnp.floor(unit * resolution), 0, resolution - 1).astype(jnp.int32)
        is_step = jnp.arange(len(cells), dtype=jnp.int32) < length
        return Visits(
            self.seen.at[cells[:, 0], cells[:, 1]].max(is_step),
            self.starts.at[cells[0, 0], cells[0, 1]].max(is_step[0]),
        )

    def scores(self, u: Float[Array, "R R"]) -> Float[Array, "4"]:
        """Four numbers of a map of U.

        The mean of the unvisited cells minus that of the starting cells, the latter, the share of high cells,
        and the share of the visited cells from which the gradient of U leads to a high unvisited cell. A cell
        is high if its U is nearer to the largest of the map than to the least.
        """
        start = jnp.mean(u, where=self.starts)
        is_high = 2.0 * u > jnp.min(u) + jnp.max(u)
        # NaN where U is not a number anywhere, like the other scores.
        leads = jnp.where(
            jnp.isnan(jnp.max(u)), jnp.nan, (is_high & ~self.seen).ravel()[peaks(u)].astype(u.dtype)
        )
        return jnp.stack(
            [
                jnp.mean(u, where=~self.seen) - start,
                start,
                jnp.mean(is_high.astype(u.dtype)),
                jnp.mean(leads, where=self.seen.ravel()),
            ]
        )


class Maps(eqx.Module):
    """The maps that a run keeps at some of its episodes, and scores of those over two observations."""

    values: Float[Array, "K 2 *grid"]  # the maps, NaN before
    visits: Visits | None  # cells that the run has been in; None if maps are not scored
    scores: Float[Array, "K 4"] | None  # `Visits.scores` of each map, NaN before; None as `visits`

    @classmethod
    def none(cls, number: int, of_one: jax.ShapeDtypeStruct, *, are_scored: bool) -> "Maps":
        """No maps yet of `number`, each with the shape and dtype of one."""
        values = jnp.full((number, *of_one.shape), jnp.nan, of_one.dtype)
        if not are_scored:
            return cls(values, None, None)
        return cls(values, Visits.none(of_one.shape[-1]), jnp.full((number, 4), jnp.nan, of_one.dtype))

    def after(
        self,
        now: Bool[Array, "K"],
        found: Float[Array, "2 *grid"],
        unit: Float[Array, "T 2"] | None,
        length: Int[Array, ""],
    ) -> "Maps":
        """The maps after an episode, whose map was found; `now` says which of the maps it is, if any.

        The observations before its steps are in units of their range; None if maps are not scored.
        """
        values = jnp.where(now.reshape(-1, *[1] * found.ndim), found[None], self.values)
        if self.visits is None or self.scores is None or unit is None:
            return Maps(values, None, None)
        visits = self.visits.after(unit, length)
        return Maps(values, visits, jnp.where(now[:, None], visits.scores(found[1])[None], self.scores))

    def summary(self) -> dict[str, Scalar]:
        """The values of `SCORE_COLUMNS`; none if maps are not scored."""
        if self.scores is None:
            return {}
        contrast, start, high, leads = self.scores.T
        return {
            "unseen_u": jnp.mean(contrast),
            "start_u_change": start[-1] - start[0],
            "high_u_change": high[-1] - high[0],
            "u_leads": jnp.mean(leads),
        }


def peaks(u: Float[Array, "R R"]) -> Int[Array, "RR"]:
    """The cell in which the gradient of a map ends, for every cell, both as indices of the flat map.

    The gradient is followed to the one of the eight neighbours with the largest value, as long as it rises.
    """
    resolution = u.shape[0]
    padded = jnp.pad(u, 1, constant_values=-jnp.inf)
    # The cell itself comes first, so that it is kept where no neighbour is higher.
    steps = [(0, 0), *((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0))]
    around = jnp.stack([padded[1 + i : 1 + i + resolution, 1 + j : 1 + j + resolution] for i, j in steps])
    offsets = jnp.asarray([i * resolution + j for i, j in steps], jnp.int32)
    following = jnp.arange(resolution**2, dtype=jnp.int32) + offsets[jnp.argmax(around, axis=0).ravel()]
    # Each round doubles the number of steps, up to more than there are cells.
    for _ in range((resolution**2).bit_length()):
        following = following[following]
    return following


SCORE_COLUMNS: Table = (
    Column(
        "unseen_u",
        "float64",
        "",
        "mean U of the cells without a visit less that of the starting cells, mean over map_episodes",
        nullable=True,
    ),
    Column(
        "start_u_change",
        "float64",
        "",
        "change of the mean U of the starting cells from the first of map_episodes to the last",
        nullable=True,
    ),
    Column(
        "high_u_change",
        "float64",
        "",
        "change of the share of cells with a U in the upper half of the map's range, between the same maps",
        nullable=True,
    ),
    Column(
        "u_leads",
        "float64",
        "",
        "share of the visited cells from which the gradient of U leads to an unvisited cell with a U in the "
        "upper half of the map's range; mean over map_episodes",
        nullable=True,
    ),
)
