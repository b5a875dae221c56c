"""The model of the field that a survey expects: a Gaussian process, learned from an earlier survey if any."""

from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bojax.areas.area import longer_side
from bojax.areas.place import MOST_CELLS, Place, Values, values_of
from bojax.fields.data import in_file, read_points, split_choice
from bojax.fields.raster import DEGREES
from bojax.fields.raster_files import read_raster
from bojax.models.evidence import log_normal_prior, relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern52, Scaled
from bojax.models.means import ConstantMean
from bojax.surveys.measurements import predict

MOST_POINTS = 200
"""Points of an earlier survey that the model is learned from."""

MOST_SEEN = 1000
"""Points of an earlier survey that the weights of a goal are computed from."""

SMALL = 0.01
"""Share of the area's width below which the positions of an earlier survey may be in another unit."""

FAR = 10.0
"""Widths of the area beyond which the positions of an earlier survey may be errors."""

NOISE = 0.1  # standard deviation of the noise of a measurement, as a share of that of the field


@dataclass(frozen=True)
class FieldModel:
    """A stationary model of a field: a Matern kernel of smoothness 5/2, and noise."""

    lengthscale: float  # distance over which values are alike, m
    std: float  # standard deviation of the field around its mean
    noise: float  # standard deviation of the noise of a measurement
    source: str  # where the numbers come from, for the report
    mean: float = 0.0  # mean of the field
    # Points `[N, 2]`, m, and values `[N]` of the earlier survey; None without one
    seen: tuple[np.ndarray, np.ndarray] | None = None
    notes: tuple[str, ...] = ()  # what a user should know of the earlier survey, a sentence each
    read: Values | None = None  # its values, to be drawn

    def belief(self) -> GaussianProcess:
        """The belief about the field before the survey; inputs are in metres."""
        return GaussianProcess.prior(self._kernel, jnp.asarray(self.noise**2), 1, 2)

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation `[M]` of the field at points `[M, 2]`, given the earlier survey."""
        if self.seen is None:
            return np.full(len(points), self.mean), np.full(len(points), self.std)
        x, y = self.seen
        posterior = GaussianProcess.fit(
            self._kernel, jnp.asarray(self.noise**2), jnp.asarray(x), jnp.asarray(y - self.mean)
        )
        mean, variance = predict(posterior, jnp.asarray(points))
        return self.mean + np.asarray(mean), np.sqrt(np.asarray(variance))

    @property
    def _kernel(self) -> Scaled:
        return Scaled(Matern52(jnp.asarray(self.lengthscale)), jnp.asarray(self.std**2))


def assumed_model(size: float, lengthscale: float | None) -> FieldModel:
    """A model without data: standard deviation 1, and a lengthscale of a tenth of the root of the area."""
    if lengthscale is not None:
        return FieldModel(lengthscale, 1.0, NOISE, "lengthscale as given, standard deviation 1")
    assumed = size**0.5 / 10.0
    return FieldModel(
        assumed, 1.0, NOISE, "assumed: lengthscale a tenth of the root of the area, standard deviation 1"
    )


def learned_model(file: str, place: Place, lengthscale: float | None) -> FieldModel:
    """The model that maximises the posterior density given an earlier survey of the field.

    Args:
        file: A raster, or rows of x, y and value, in the area or near it.
        place: What is surveyed.
        lengthscale: Its lengthscale, m; learned if None.

    Raises:
        ValueError: The file cannot be read, has fewer than 10 values, or all of them, or their places, are
            equal.
    """
    points, values, read, notes = _read_values(file, place)
    if len(values) < 10:
        raise ValueError(f"{file}: got {len(values)} values; allowed: at least 10 to learn from")
    width, extent = longer_side(place.area.bounds), float(np.ptp(points, axis=0).max())
    beyond = _distances(points, place)
    if beyond.min() > 0.0:
        away = float(f"{beyond.min():.2g}")
        nearest = f"{away / 1000:,g} km" if away >= 1000 else f"{away:g} m"
        notes.append(
            f"{file}: no value lies in the area, and the nearest is {nearest} away{_swapped(points, place)}: "
            "the model is learned from a field elsewhere."
        )
    elif number := int(np.sum(beyond > FAR * width)):
        why = ", from which the lengthscale is learned" if lengthscale is None else ""
        notes.append(
            f"{file}: {number} of {len(points)} values lie more than {FAR:g} widths of the area away from "
            f"it; check their positions{why}."
        )
    if extent <= 1e-9 * width:
        raise ValueError(f"{file}: all values lie at one place; allowed: places that differ")
    if extent < SMALL * width:
        notes.append(
            f"{file}: all values lie within {extent:.3g} m, and the area is {width:.4g} m wide; "
            "check the unit of their positions."
        )
    chosen = np.random.default_rng(0).permutation(len(values))[:MOST_SEEN]
    seen = points[chosen], values[chosen]
    points, values = (each[:MOST_POINTS] for each in seen)
    scale = float(values.std())
    if scale <= 1e-12 * np.abs(values).max() or scale == 0.0:
        raise ValueError(f"{file}: all values are {values[0]:g}; allowed: values that differ")
    gp = GaussianProcess.fit(
        Scaled(Matern52(jnp.asarray(lengthscale or extent / 10.0)), jnp.asarray(1.0)),
        jnp.asarray(NOISE**2),
        jnp.asarray(points),
        jnp.asarray((values - values.mean()) / scale),
    )
    learned = _learned(gp)
    assert isinstance(learned.kernel, Scaled) and isinstance(learned.kernel.kernel, Matern52)
    found = float(learned.kernel.kernel.lengthscale)
    assert isinstance(learned.mean, ConstantMean)
    mean = float(values.mean()) + scale * float(learned.mean.value)
    std, noise = scale * float(learned.kernel.variance) ** 0.5, scale * float(learned.noise_variance) ** 0.5
    source = f"learned from {len(values)} values of {Path(file).name}"
    return FieldModel(lengthscale or found, std, noise, source, mean, seen, tuple(notes), read)


@eqx.filter_jit  # with the prior, whose medians would else be constants of a program of their own
def _learned(gp: GaussianProcess) -> GaussianProcess:
    """The process with learned hyper-parameters, mean and noise."""
    # A broad prior: few or clustered points determine a lengthscale poorly.
    prior = log_normal_prior(gp.kernel, gp.noise_variance, jnp.asarray(1.0))
    learned, _ = relearn(gp, jax.random.key(0), learn_mean=True, log_prior=prior, num_starts=4)
    return learned


def _distances(points: np.ndarray, place: Place) -> np.ndarray:
    """Distances `[N]` of points from the bounds of the area, m; 0 within them."""
    low, high = np.array(place.area.bounds).reshape(2, 2)
    return np.hypot(*np.maximum(0.0, np.maximum(low - points, points - high)).T)


def _swapped(points: np.ndarray, place: Place) -> str:
    """The words for points that would lie in the area with longitude and latitude exchanged, or none."""
    if place.projection.crs is None:
        return ""
    exchanged = place.projection.from_other(place.projection.to_degrees(points)[:, ::-1], DEGREES)
    return " (longitude and latitude may be swapped)" if _distances(exchanged, place).min() == 0.0 else ""


def _read_values(file: str, place: Place) -> tuple[np.ndarray, np.ndarray, Values, list[str]]:
    """Points `[N, 2]` in metres of the place and values `[N]` of an earlier survey, and notes on them."""
    path, notes = split_choice(file)[0], list[str]()
    with in_file(file):
        if Path(path).suffix.lower() in (".csv", ".txt", ".xyz"):
            read = read_points(file)
            # Columns without the name of a longitude are in the coordinates of the area.
            crs = read.crs or place.projection.crs
            if crs == DEGREES:
                read.check_degrees()
            if read.left_out:
                number = len(read.rows) + read.left_out
                notes.append(f"{file}: {read.left_out} of {number} rows have no data and are left out.")
            if repeated := len(read.rows) - len(np.unique(read.rows, axis=0)):
                notes.append(
                    f"{file}: {repeated} of {len(read.rows)} rows repeat an earlier one; all of them count."
                )
        else:
            read = read_raster(file, MOST_CELLS)
            crs = read.crs
            notes += (f"{file}: {note}" for note in read.notes)
        points, values = read.cells
        drawn = values_of(file, read, crs, place.projection)
        return place.projection.from_other(points, crs), values, drawn, notes
