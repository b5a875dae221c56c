"""Error measures of a learned field on a grid: RMSE, weighted RMSE (3.7) and negative log likelihood."""

from dataclasses import replace
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Scalar

from bojax.fields.base import Field
from bojax.results.schema import Column, Table

Weighting = Literal["gradient", "gradient-norm", "value"]
"""Weights of the weighted RMSE, see `error_weights`."""

ERROR_COLUMNS: Table = (
    Column("rmse", "float64", "", "root mean square error of the final belief"),
    Column("wrmse", "float64", "", "the same, weighted as `problem.weighting` sets"),
    Column("wrmse_gradient", "float64", "", "the same, weighted by the gradient as printed in (3.7)"),
    Column("wrmse_value", "float64", "", "the same, weighted by the value"),
    Column("mnll", "float64", "", "mean negative log likelihood of the field under the final belief"),
    Column("mean_std", "float64", "", "mean standard deviation of the final belief"),
)

FIELD_COLUMNS: Table = (
    *ERROR_COLUMNS,
    Column("collisions", "int32", "", "times that a wall stopped the robot"),
    Column("sampled_gradient", "float64", "1/m", "mean norm of the field's gradient at the samples"),
    Column(
        "ignored_samples", "int32", "", "samples left out of the belief: not finite, or beyond its capacity"
    ),
)


STEP_ERRORS = ("rmse", "mnll", "mean_std")
"""Errors of the belief in `steps.parquet`, if they are asked for."""

DISTANCE = Column("distance", "float64", "m", "distance driven so far, along the poses of the paths")
STEP_COLUMNS: Table = tuple(
    replace(each, doc=each.doc.replace("the final belief", "the belief after the step"))
    for each in ERROR_COLUMNS
    if each.name in STEP_ERRORS
)
REGION_COLUMNS: Table = tuple(
    replace(each, name=f"{each.name}_region", doc=f"{each.doc}, in `problem.region`") for each in STEP_COLUMNS
)


def field_errors(
    field: Field,
    grid: Float[Array, "G 2"],
    mean: Float[Array, "G"],
    variance: Float[Array, "G"],
    is_open: Bool[Array, "G"],
    weighting: Weighting,
) -> dict[str, Scalar]:
    """The columns of `ERROR_COLUMNS`, from the moments of the belief at the points of a regular grid.

    Points that are not open, in walls, do not count. `weighting` gives the weights of the weighted RMSE.
    """
    truth = field.values(grid)
    counts = is_open.astype(truth.dtype)
    number = jnp.sum(counts)
    squared = counts * (mean - truth) ** 2
    variance = jnp.maximum(variance, jnp.finfo(variance.dtype).eps)

    def weighted(weighting: Weighting) -> Scalar:
        return jnp.sqrt(jnp.sum(squared * error_weights(field, grid, weighting)) / number)

    nll = 0.5 * jnp.log(2.0 * jnp.pi * variance) + (mean - truth) ** 2 / (2.0 * variance)
    return {
        "rmse": jnp.sqrt(jnp.sum(squared) / number),
        "wrmse": weighted(weighting),
        "wrmse_gradient": weighted("gradient"),
        "wrmse_value": weighted("value"),
        "mnll": jnp.sum(counts * nll) / number,
        "mean_std": jnp.sum(counts * jnp.sqrt(variance)) / number,
    }


def error_weights(field: Field, points: Float[Array, "N 2"], weighting: Weighting) -> Float[Array, "N"]:
    """Weights in [0, sqrt(2)] from the true field at the points of a grid.

    - `"gradient"`: as (3.7) prints it, the norm of the gradient's components, each scaled to [0, 1] by its
      smallest and largest signed value over the grid; a flat area weighs about 0.7;
    - `"gradient-norm"`: the norm of the gradient, scaled to [0, 1];
    - `"value"`: the value, scaled to [0, 1] (Section 4.7.1: errors at locations of high value).
    """
    if weighting == "value":
        return _unit(field.values(points))
    gradients = field.gradients(points)
    if weighting == "gradient-norm":
        return _unit(jnp.sqrt(jnp.sum(gradients**2, axis=-1)))
    return jnp.sqrt(jnp.sum(jax.vmap(_unit, 1, 1)(gradients) ** 2, axis=-1))


def _unit(values: Float[Array, "N"]) -> Float[Array, "N"]:
    """Values scaled to [0, 1]; ones if they are all equal."""
    low, high = jnp.min(values), jnp.max(values)
    is_flat = high == low
    return jnp.where(is_flat, 1.0, (values - low) / jnp.where(is_flat, 1.0, high - low))
