"""Keys for simulated noise: Threefry-2x32 of 13 rounds as plain arithmetic, which XLA fuses with its use.

Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (SC 2011): 13 rounds pass TestU01's BigCrush. The
20 rounds of `jax.random`'s default are a loop on a CPU, which costs more than the arithmetic of a simulation.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.extend as jex
import jax.numpy as jnp
from jaxtyping import Array, Int, Key, UInt32

_ROTATIONS = (13, 15, 26, 6, 17, 29, 16, 24)
_NUM_ROUNDS = 13
_PARITY = 0x1BD11BDA


def threefry(
    key: UInt32[Array, "2"], x0: UInt32[Array, "*S"], x1: UInt32[Array, "*S"], num_rounds: int = _NUM_ROUNDS
) -> tuple[UInt32[Array, "*S"], UInt32[Array, "*S"]]:
    """Two words for each counter `(x0, x1)`; `jax.random` has 20 rounds."""
    k0, k1 = key[0], key[1]
    schedule = (k0, k1, k0 ^ k1 ^ jnp.uint32(_PARITY))
    x0, x1 = x0 + k0, x1 + k1
    for i in range(num_rounds):
        rotation = _ROTATIONS[i % 8]
        x0 = x0 + x1
        x1 = ((x1 << jnp.uint32(rotation)) | (x1 >> jnp.uint32(32 - rotation))) ^ x0
        if i % 4 == 3:
            j = i // 4 + 1
            x0 = x0 + schedule[j % 3]
            x1 = x1 + schedule[(j + 1) % 3] + jnp.uint32(j)
    return x0, x1


def _seed(seed: Array) -> UInt32[Array, "2"]:
    return jnp.stack([jnp.zeros((), jnp.uint32), seed.astype(jnp.uint32)])


def _counters(shape: tuple[int, ...]) -> UInt32[Array, "*S"]:
    return jax.lax.iota(jnp.uint32, math.prod(shape)).reshape(shape)


def _split(key: UInt32[Array, "2"], shape: tuple[int, ...]) -> UInt32[Array, "*S 2"]:
    counters = _counters(shape)
    return _joined(*threefry(key, jnp.zeros_like(counters), counters))


def _joined(x0: UInt32[Array, "*S"], x1: UInt32[Array, "*S"]) -> UInt32[Array, "*S 2"]:
    # A choice, not `stack`: XLA does not vectorise what it fuses with a concatenation (five times slower).
    is_first = jax.lax.broadcasted_iota(jnp.int32, (*x0.shape, 2), x0.ndim) == 0
    return jnp.where(is_first, x0[..., None], x1[..., None])


def _fold_in(key: UInt32[Array, "2"], data: Array) -> UInt32[Array, "2"]:
    counter = data.astype(jnp.uint32)
    return _joined(*threefry(key, jnp.zeros_like(counter), counter))


def _random_bits(key: UInt32[Array, "2"], bit_width: int, shape: tuple[int, ...]) -> Array:
    counters = _counters(shape)
    x0, x1 = threefry(key, jnp.zeros_like(counters), counters)
    if bit_width == 64:
        return (x0.astype(jnp.uint64) << jnp.uint64(32)) | x1.astype(jnp.uint64)
    return x0.astype(jnp.dtype(f"uint{bit_width}"))


_IMPLEMENTATION = jex.random.define_prng_impl(
    key_shape=(2,),
    seed=_seed,
    split=_split,
    random_bits=_random_bits,
    fold_in=_fold_in,  # pyright: ignore[reportArgumentType]  # the declared int is an array
    name="bojax_threefry13",
    tag="t13",
)


def is_key(x: Any) -> bool:
    """Whether an array, or what is known of one, has keys rather than numbers."""
    return jnp.issubdtype(getattr(x, "dtype", float), jax.dtypes.prng_key)


def simulation_key(key: Key[Array, ""]) -> Key[Array, ""]:
    """The key of a simulation, seeded by a key of any kind, see `takes_simulation_keys`."""
    return jax.random.wrap_key_data(jax.random.bits(key, (2,), jnp.uint32), impl=_IMPLEMENTATION)


def takes_simulation_keys(draw: Callable[[Key[Array, ""]], Any]) -> bool:
    """Whether a function draws as well with a simulation key as with a key of JAX's.

    `jax.random.poisson` takes the latter alone. `jax.random.gamma`, which `beta`, `dirichlet`, `t` and `ball`
    call, draws one number after the other for all other keys, also in a batch: a GPU takes long for that.
    """
    try:
        program = jax.make_jaxpr(draw)(jax.eval_shape(simulation_key, jax.random.key(0)))
    except NotImplementedError:  # Poisson; if it is another one, the search raises it again
        return False
    return "random_gamma" not in str(program)


def random_index(key: Key[Array, ""], count: Int[Array, ""], shape: tuple[int, ...] = ()) -> Int[Array, "*S"]:
    """Integers below `count`, uniform up to the resolution of float32; 0 if `count` is 0."""
    # `jax.random.randint` draws twice and divides, to be exact for a range of any size, and takes seconds to
    # compile if the bound is not constant.
    draw = jax.random.uniform(key, shape, jnp.float32) * count.astype(jnp.float32)
    return jnp.clip(draw.astype(jnp.int32), 0, jnp.maximum(count - 1, 0))
