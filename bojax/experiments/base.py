"""The protocol between an experiment and the engine that batches it."""

import abc
from collections.abc import Mapping
from typing import Any

import equinox as eqx
from jaxtyping import Array, Bool, Int, Key, PyTree, Scalar

from bojax.numerics.lanes import LANES_ON_GPU
from bojax.results.schema import Table

Carry = Any
"""Whatever an experiment carries from one advance to the next: a tree of strongly typed arrays."""


class Records(eqx.Module):
    """The records of one advance of one lane.

    Attributes:
        tables: `{table: {column: [capacity], "valid": [capacity]}}`; invalid rows are not stored.
        active_steps: Number of environment steps of the advance; 0 for a finished lane.
    """

    tables: dict[str, dict[str, Array]]
    active_steps: Int[Array, ""]


class Experiment(eqx.Module):
    """One run, written for a single lane; the engine batches lanes.

    The module is its own parameter tree: array leaves can be swept within one compiled program, and static
    fields fix the structure of the program. Parameters are never part of the carry. An advance of a finished
    lane keeps the carry and reports no valid rows and no active steps. Random keys are
    `fold_in(key, counter)`, not a chain of splits in the carry, so that they do not depend on how often the
    engine paused.
    """

    @property
    @abc.abstractmethod
    def tables(self) -> Mapping[str, Table]:
        """Columns of every table: those of `"runs"` come from `summary`, all others from `Records`."""

    @property
    def recorded_tables(self) -> frozenset[str]:
        """Tables that keep only the rows of recorded runs (`record.runs`)."""
        return frozenset()

    @property
    def is_hosted(self) -> bool:
        """Whether a part of the experiment steps on the host, so that it cannot be compiled as a whole."""
        return False

    @property
    def lanes_on_cpu(self) -> int:
        """Default number of lanes on a core of a CPU."""
        return 16

    @property
    def lanes_on_gpu(self) -> int:
        """Default number of lanes of a GPU, whose memory limits it."""
        return LANES_ON_GPU

    @property
    def narrowest(self) -> int | None:
        """Least number of lanes of an accelerator to which the last runs of a chunk move.

        None if all runs take about as many advances.
        """
        return None

    @property
    @abc.abstractmethod
    def max_advances(self) -> int:
        """Number of advances after which every lane is done."""

    @property
    def steps_per_advance(self) -> int:
        """Largest number of environment steps of an advance."""
        return 1

    @abc.abstractmethod
    def init(self, key: Key[Array, ""]) -> Carry:
        """The carry before the first advance."""

    @abc.abstractmethod
    def advance(self, carry: Carry) -> tuple[Carry, Records]:
        """One planning step, or one episode with its refit."""

    @abc.abstractmethod
    def is_done(self, carry: Carry) -> Bool[Array, ""]:
        """Whether this lane has finished."""

    @abc.abstractmethod
    def summary(self, carry: Carry) -> dict[str, Scalar]:
        """The scalar results of the run: one row of `runs.parquet`."""

    def snapshot(self, carry: Carry) -> dict[str, dict[str, Array]]:
        """Arrays to keep for recorded runs: `{name: {array name: array}}`."""
        return {}

    def exported_state(self, carry: Carry) -> PyTree:
        """The state that a saved learner is restored from, a tree of arrays; None by default."""
        return None
