"""Feature maps of linear models: random Fourier (2.33), Fourier basis (5.23), polynomial, radial basis."""

import abc
import itertools
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf, ndtri
from jaxtyping import Array, Float, Key
from typing_extensions import override

from bojax.models.checks import Numbers, precision, to_points
from bojax.models.kernels import (
    RBF,
    Kernel,
    KernelName,
    Matern12,
    Matern32,
    Matern52,
    Product,
    Scaled,
    Sum,
    as_kernel,
)
from bojax.numerics.linalg import matmul
from bojax.numerics.quasirandom import inside_the_cube, scrambled_halton

Sampling = Literal["quasi-random", "monte-carlo"]
"""How the frequencies of random Fourier features are drawn."""

Correlation = RBF | Matern12 | Matern32 | Matern52
"""A kernel with k(x, x) = 1 whose spectral density is known."""


class Features(eqx.Module):
    """A map phi from inputs to features (2.3)."""

    @property
    @abc.abstractmethod
    def num_features(self) -> int:
        """Number of features, M."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "D"]) -> Float[Array, "M"]:
        """The features of one input."""

    def design(self, xs: Float[Array, "N D"] | Numbers) -> Float[Array, "N M"]:
        """The design matrix: a row of features for each input (an array or lists)."""
        return jax.vmap(self)(to_points("xs", xs, precision(self, xs), getattr(self, "num_dims", None)))


class RandomFourier(Features):
    """Features whose inner product approximates a stationary kernel, phi(x)'phi(y) ~ k(x, y) (2.31-2.33).

    M/2 frequencies w, drawn from the kernel's spectral density, give the M features a cos(w'x) and
    a sin(w'x), with a^2 = 2 k(x, x) / M, so that phi(x)'phi(x) = k(x, x) exactly. Equation 2.33 is printed
    with another scale. The thesis prints N(0, 2 I / lengthscale^2) as the spectral density of the RBF
    kernel; it is N(0, I / lengthscale^2).

    Attributes:
        frequencies: Angular frequencies, in radians per unit of the input.
        amplitudes: Amplitude of the two features of each frequency.
    """

    frequencies: Float[Array, "F D"]
    amplitudes: Float[Array, "F"]

    @classmethod
    def draw(
        cls,
        key: Key[Array, ""],
        kernel: Kernel | KernelName,
        num_features: int,
        num_dims: int,
        *,
        sampling: Sampling = "quasi-random",
    ) -> "RandomFourier":
        """Features of a kernel; differentiable with respect to its lengthscales and variances.

        The terms of a sum of kernels receive equal shares of the frequencies.

        Args:
            key: Random key.
            kernel: A name, or composed of `RBF`, `Matern12`, `Matern32`, `Matern52`, `Scaled`, `Sum` and
                `Product`.
            num_features: Number of features M, which is even and at least 2 for each term of a sum.
            num_dims: Number of dimensions of the input.
            sampling: `quasi-random` takes points of a scrambled Halton sequence, which cover the density
                evenly. `monte-carlo` takes independent draws; its error falls as 1 / sqrt(num_features).

        Raises:
            ValueError: A number is out of range, or a lengthscale has another number of dimensions.
            TypeError: The spectral density of a part of the kernel is not known.
        """
        terms = _terms(as_kernel(kernel))
        if num_features < 2 * len(terms) or num_features % 2:
            raise ValueError(f"num_features: got {num_features}; allowed: even, >= {2 * len(terms)}")
        _refuse_below(1, "num_dims", num_dims)
        if sampling not in ("quasi-random", "monte-carlo"):
            raise ValueError(f"sampling: got {sampling!r}; allowed: quasi-random, monte-carlo")
        frequencies, amplitudes = [], []
        keys = jax.random.split(key, len(terms))
        for i, (variance, factors) in enumerate(terms):
            number = len(range(i, num_features // 2, len(terms)))
            frequencies.append(_frequencies(keys[i], factors, number, num_dims, sampling))
            amplitudes.append(jnp.full((number,), 1.0, variance.dtype) * jnp.sqrt(variance / number))
        return cls(jnp.concatenate(frequencies), jnp.concatenate(amplitudes))

    @property
    @override
    def num_features(self) -> int:
        return 2 * len(self.amplitudes)

    @override
    def __call__(self, x: Float[Array, "D"]) -> Float[Array, "M"]:
        """The features of one input: the cosines, followed by the sines."""
        angles = matmul(self.frequencies, x)
        return jnp.concatenate([self.amplitudes * jnp.cos(angles), self.amplitudes * jnp.sin(angles)])


class FourierBasis(Features):
    """The (order + 1)^D features cos(pi c'x) for all c in {0, ..., order}^D (5.23), for inputs in [0, 1]^D.

    The first feature is the constant 1.

    Attributes:
        order: Largest number of half periods along a dimension.
        num_dims: Number of dimensions of the input.
    """

    order: int = eqx.field(static=True)
    num_dims: int = eqx.field(static=True)

    def __check_init__(self):
        _refuse_below(0, "order", self.order)
        _refuse_below(1, "num_dims", self.num_dims)

    @property
    @override
    def num_features(self) -> int:
        return (self.order + 1) ** self.num_dims

    @override
    def __call__(self, x: Float[Array, "D"]) -> Float[Array, "M"]:
        return jnp.cos(matmul(jnp.asarray(self.frequencies(), x.dtype), x))

    def frequencies(self) -> np.ndarray:
        """Angular frequency of each feature along each dimension, `[M, D]`."""
        return np.pi * np.indices((self.order + 1,) * self.num_dims).reshape(self.num_dims, -1).T


class Polynomial(Features):
    """All monomials of the input up to `degree`, in ascending order of degree.

    Attributes:
        degree: Largest total degree.
        num_dims: Number of dimensions of the input.
        has_bias: Whether the constant 1 is one of the features.
    """

    degree: int = eqx.field(static=True)
    num_dims: int = eqx.field(static=True)
    has_bias: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        _refuse_below(0 if self.has_bias else 1, "degree", self.degree)
        _refuse_below(1, "num_dims", self.num_dims)

    @property
    @override
    def num_features(self) -> int:
        return len(self._factors())

    @override
    def __call__(self, x: Float[Array, "D"]) -> Float[Array, "M"]:
        # The index past the last coordinate stands for the factor 1, which pads products of a lower degree.
        return jnp.prod(jnp.append(x, jnp.ones((), x.dtype))[self._factors()], axis=1)

    def _factors(self) -> np.ndarray:
        """Indices of the coordinates that each feature multiplies, `[M, degree]`."""
        products = [
            (*chosen, *[self.num_dims] * (self.degree - size))
            for size in range(0 if self.has_bias else 1, self.degree + 1)
            for chosen in itertools.combinations_with_replacement(range(self.num_dims), size)
        ]
        return np.asarray(products, int).reshape(len(products), self.degree)


class RadialBasis(Features):
    """Gaussian radial basis functions, exp(-|x - c|^2 / (2 width^2)).

    Attributes:
        centres: Centre c of each function.
        width: Width of the functions in units of the input: one number, or one for each dimension.
        has_bias: Whether the constant 1 is the first feature.
    """

    centres: Float[Array, "C D"]
    width: Float[Array, ""] | Float[Array, "D"]
    has_bias: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if not self.num_features:
            raise ValueError("centres: got 0; allowed: >= 1, or a bias")

    @property
    @override
    def num_features(self) -> int:
        return len(self.centres) + self.has_bias

    @override
    def __call__(self, x: Float[Array, "D"]) -> Float[Array, "M"]:
        bumps = RBF(self.width).gram(x[None, :], self.centres)[0]
        return jnp.concatenate([jnp.ones((1,), x.dtype), bumps]) if self.has_bias else bumps


def _refuse_below(least: int, name: str, number: int) -> None:
    if number < least:
        raise ValueError(f"{name}: got {number}; allowed: >= {least}")


def _terms(kernel: Kernel) -> list[tuple[Float[Array, ""], list[Correlation]]]:
    """The kernel expanded into a sum of terms, each a variance times a product of correlations."""
    match kernel:
        case Sum():
            return _terms(kernel.first) + _terms(kernel.second)
        case Scaled():
            return [(kernel.variance * variance, factors) for variance, factors in _terms(kernel.kernel)]
        case Product():
            return [
                (one * other, left + right)
                for one, left in _terms(kernel.first)
                for other, right in _terms(kernel.second)
            ]
        case RBF() | Matern12() | Matern32() | Matern52():
            return [(jnp.ones((), kernel.lengthscale.dtype), [kernel])]
    raise TypeError(f"the spectral density of the kernel {type(kernel).__name__} is not known")


def _degrees_of_freedom(kernel: Correlation) -> int | None:
    """Degrees of freedom of the spectral density if it is Student's t; None if it is normal."""
    return {RBF: None, Matern12: 1, Matern32: 3, Matern52: 5}[type(kernel)]


def _frequencies(key, factors, number, num_dims, sampling) -> Float[Array, "F D"]:
    """Frequencies of a product of correlations: sums of independent frequencies of the factors."""
    # Normal variables are quantiles of uniform ones. The spectral density of a Matern kernel of smoothness nu
    # is Student's t with 2 nu degrees of freedom: a normal vector divided by the square root of an
    # independent chi-squared variable over 2 nu, which takes one more uniform variable.
    widths = [num_dims + (_degrees_of_freedom(kernel) is not None) for kernel in factors]
    dtype = factors[0].lengthscale.dtype
    if sampling == "quasi-random":
        uniform = scrambled_halton(key, number, sum(widths), dtype)
    else:
        uniform = inside_the_cube(jax.random.uniform(key, (number, sum(widths)), dtype))
    total = jnp.zeros((number, num_dims), dtype)
    for kernel, columns in zip(
        factors, np.split(np.arange(sum(widths)), np.cumsum(widths)[:-1]), strict=True
    ):
        if kernel.lengthscale.shape not in ((), (num_dims,)):
            raise ValueError(f"lengthscale: got {kernel.lengthscale.shape[0]}; allowed: 1 or {num_dims}")
        normal = ndtri(uniform[:, columns[:num_dims]])
        degrees = _degrees_of_freedom(kernel)
        if degrees is not None:
            normal = normal * (degrees**0.5 / _chi_quantile(uniform[:, columns[-1]], degrees))[:, None]
        lengthscale = jnp.broadcast_to(kernel.lengthscale, (num_dims,))
        total = total + normal / lengthscale[None, :]
    return total


def _chi_quantile(probabilities: Float[Array, "F"], degrees: int) -> Float[Array, "F"]:
    """Quantiles of the chi distribution with 1, 3 or 5 degrees of freedom, by bisection."""

    def distribution(r):
        polynomial = {1: 0.0 * r, 3: r, 5: r + r**3 / 3.0}[degrees]
        return erf(r / 2.0**0.5) - (2.0 / jnp.pi) ** 0.5 * polynomial * jnp.exp(-0.5 * r**2)

    def halve(bracket, _):
        low, high = bracket
        middle = 0.5 * (low + high)
        is_below = distribution(middle) < probabilities
        return (jnp.where(is_below, middle, low), jnp.where(is_below, high, middle)), None

    bracket = (jnp.zeros_like(probabilities), jnp.full_like(probabilities, 16.0))
    (_, high), _ = jax.lax.scan(halve, bracket, length=jnp.finfo(probabilities.dtype).nmant + 4)
    return high
