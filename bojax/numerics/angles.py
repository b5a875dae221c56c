"""Angles in radians: wrapped to one turn, and their cosines and sines."""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_HALF_PI = Fraction("1.57079632679489661923132169163975144209858469968755")


def wrap_to_pi(angle: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """The equivalent angle in [-pi, pi)."""
    return wrap_to_2pi(angle + jnp.pi) - jnp.pi


def wrap_to_2pi(angle: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """The equivalent angle in [0, 2 pi)."""
    turn = 2.0 * jnp.pi
    wrapped = jnp.mod(angle, turn)
    # The remainder of a tiny negative angle rounds to a whole turn.
    return jnp.where(wrapped >= turn, 0.0, wrapped)


@jax.jit  # traced and lowered once in a program, which calls it 20 times
def cos_and_sin(angles: Float[Array, "*N"]) -> tuple[Float[Array, "*N"], Float[Array, "*N"]]:
    """Cosines and sines of many angles.

    The errors are below two units of rounding, plus, for a large angle, the change of the functions within
    half a unit of rounding of the angle.
    """
    # On a CPU, XLA computes them one number after the other, in 10 ns each in float32 and 20 in float64. The
    # elementwise arithmetic here is vectorised and takes a tenth as long: the angle is reduced to a quarter
    # turn (Cody and Waite, 1980), where both functions are their Taylor polynomials.
    if jax.default_backend() != "cpu":
        return jnp.cos(angles), jnp.sin(angles)
    info = jnp.finfo(angles.dtype)
    quarters = jnp.round(angles * (2.0 / math.pi))
    rest = angles
    for part in _parts_of_half_pi((info.nmant + 1) // 2):
        rest = rest - quarters * part
    # The rest is only longer for an angle beyond 1 / eps, and then has no correct digit.
    rest = jnp.clip(rest, -1.0, 1.0)
    square = rest * rest
    eps = float(info.eps)
    cosines, sines = _taylor(square, 0, eps), rest * _taylor(square, 1, eps)
    quadrant = quarters - 4.0 * jnp.floor(0.25 * quarters)
    is_odd = (quadrant == 1.0) | (quadrant == 3.0)
    x, y = jnp.where(is_odd, sines, cosines), jnp.where(is_odd, cosines, sines)
    is_left, is_below = (quadrant == 1.0) | (quadrant == 2.0), quadrant >= 2.0
    return jnp.where(is_left, -x, x), jnp.where(is_below, -y, y)


def _parts_of_half_pi(bits: int) -> list[float]:
    """Three numbers whose sum is pi/2; the first two have so few bits that their multiples are exact."""
    parts, rest = [], _HALF_PI
    for _ in range(2):
        unit = Fraction(2) ** (math.floor(math.log2(rest)) + 1 - bits)
        parts.append(rest // unit * unit)
        rest -= parts[-1]
    return [float(part) for part in (*parts, rest)]


def _taylor(square: Float[Array, "*N"], first: int, eps: float) -> Float[Array, "*N"]:
    """The Taylor series of cos x (`first` 0) or sin x / x (1) in x^2, exact up to pi/4 within rounding."""
    terms, power = [], first
    while not terms or (math.pi / 4.0) ** power / math.factorial(power) > 0.1 * eps:
        terms.append((-1.0) ** (power // 2) / math.factorial(power))
        power += 2
    total = jnp.full_like(square, terms[-1])
    for term in reversed(terms[:-1]):
        total = total * square + term
    return total
