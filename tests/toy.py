"""A random walk of random length: the smallest experiment that has everything the engine must handle."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar
from pydantic import Field

from bojax.config.component import Component
from bojax.config.points import Point, Sweep
from bojax.config.settings import EngineConfig, Record
from bojax.experiments.base import Experiment, Records
from bojax.numerics.lanes import any_lane
from bojax.results.schema import Column

STEPS_PER_ADVANCE = 2


class Walk(eqx.Module):
    key: Key[Array, ""]
    length: Int[Array, ""]
    step: Int[Array, ""]
    position: Float[Array, "2"]
    first_right: Int[Array, ""]


class Toy(Experiment):
    """Walks until its length, drawn from the key, is reached.

    Attributes:
        scale: Standard deviation of a step.
        start: Where the walk starts.
        poison: A step whose draw is above this is NaN.
        max_length: Greatest length.
    """

    scale: Float[Array, ""]
    start: Float[Array, "2"]
    poison: Float[Array, ""]
    max_length: int = eqx.field(static=True)

    tables: ClassVar = MappingProxyType(
        {
            "runs": (
                Column("return", "float64", "m"),
                Column("steps", "int32"),
                Column("first_right", "int32", nullable=True),
                Column("success", "bool"),
            ),
            "steps": (Column("step", "int32"), Column("x", "float64", "m"), Column("y", "float64", "m")),
        }
    )

    @property
    def max_advances(self) -> int:
        return -(-self.max_length // STEPS_PER_ADVANCE)

    @property
    def steps_per_advance(self) -> int:
        return STEPS_PER_ADVANCE

    def init(self, key: Key[Array, ""]) -> Walk:
        # From the bits of the key: to draw an integer would be a third of what a toy takes to compile.
        length = 1 + (jax.random.key_data(key)[1] % jnp.uint32(self.max_length)).astype(jnp.int32)
        zero = jnp.zeros((), jnp.int32)
        return Walk(key=key, length=length, step=zero, position=self.start, first_right=zero - 1)

    def advance(self, carry: Walk) -> tuple[Walk, Records]:
        slots = jnp.arange(STEPS_PER_ADVANCE, dtype=jnp.int32)
        empty = jnp.zeros(STEPS_PER_ADVANCE, self.start.dtype)

        def body(state):
            walk, index, x, y = state
            active = walk.step < walk.length
            draw = jax.random.normal(jax.random.fold_in(walk.key, walk.step + 1), (2,), self.start.dtype)
            draw = jnp.where(draw[0] > self.poison, jnp.nan, draw)
            position = walk.position + jnp.where(active, self.scale * draw, 0.0)
            step = walk.step + active.astype(jnp.int32)
            is_first = active & (position[0] > 0) & (walk.first_right < 0)
            first_right = jnp.where(is_first, step, walk.first_right)
            walk = Walk(walk.key, walk.length, step, position, first_right)
            here = slots == index
            return walk, index + 1, jnp.where(here, position[0], x), jnp.where(here, position[1], y)

        def goes_on(state):
            walk, index, _, _ = state
            return (index < STEPS_PER_ADVANCE) & any_lane(walk.step < walk.length)

        walk, _, x, y = jax.lax.while_loop(goes_on, body, (carry, jnp.zeros((), jnp.int32), empty, empty))
        steps = carry.step + 1 + slots
        columns = {"step": steps, "x": x, "y": y, "valid": steps <= carry.length}
        return walk, Records(tables={"steps": columns}, active_steps=walk.step - carry.step)

    def is_done(self, carry: Walk) -> Bool[Array, ""]:
        return carry.step >= carry.length

    def summary(self, carry: Walk) -> dict[str, Scalar]:
        return {
            "return": jnp.sum(carry.position),
            "steps": carry.step,
            "first_right": carry.first_right,
            "success": carry.position[0] > 0,
        }

    def snapshot(self, carry: Walk) -> dict[str, dict[str, Array]]:
        return {"walk": {"position": carry.position, "start": self.start}}


class ToyConfig(Component, frozen=True):
    """Settings of the toy; its kind is no `Literal`, so that it is not registered."""

    role: ClassVar[str] = "experiment"
    target: ClassVar[str] = "tests.toy:Toy"

    kind: str = "toy"
    dtype: str = "float64"
    scale: float = 1.0
    start: tuple[float, float] = Field(default=(0.0, 1.0), strict=False)
    poison: float = 1e9
    max_length: int = 12


def toy(**settings) -> Toy:
    """The toy built by hand, strongly typed."""
    config = ToyConfig(**settings)
    return Toy(
        scale=jnp.asarray(config.scale, jnp.float64),
        start=jnp.asarray(config.start, jnp.float64),
        poison=jnp.asarray(config.poison, jnp.float64),
        max_length=config.max_length,
    )


def toy_sweep(
    *points: dict,
    runs: int = 10,
    seed: int = 3,
    record: int = 2,
    name: str = "toy",
    report: Mapping[str, Any] = MappingProxyType({}),
    **engine,
) -> Sweep:
    """A sweep over the given settings; by default two static groups, one of them of two points."""
    settings = points or ({"scale": 1.0}, {"scale": 2.0}, {"max_length": 15})
    return Sweep(
        name=name,
        title="A toy",
        points=tuple(
            Point(
                index=index,
                label="toy",
                variant="-".join(f"{key}={value}" for key, value in given.items()) or "toy",
                swept=dict(given),
                config=ToyConfig(**given),
            )
            for index, given in enumerate(settings)
        ),
        runs=runs,
        seed=seed,
        record=Record(runs=record),
        engine=EngineConfig(**engine),
        report=dict(report),
        claims=(),
        base={"experiment": "toy", **settings[0]},
        source=Path("toy.yaml"),
    )
