"""The protocol between an experiment and the engine that batches it."""

import abc
from collections.abc import Mapping
from typing import Any

import equinox as eqx
from jaxtyping import Array, Bool, Int, Key, PyTree, Scalar

from bojax.results.schema import Table

Carry = Any
"""Whatever an experiment carries from one advance to the next: a tree of strongly typed arrays."""


class Records(eqx.Module):
    """What one advance of one lane reports.

    Attributes:
        tables: `{table: {column: [capacity], "valid": [capacity]}}`; rows that are not valid are dropped.
        active_steps: Environment steps that this advance really made; 0 for a finished lane.
    """

    tables: dict[str, dict[str, Array]]
    active_steps: Int[Array, ""]


class Experiment(eqx.Module):
    """One run, written for a single lane; batching is the engine's work.

    The module is its own parameter tree: every array leaf can be swept in one compiled program, every
    static field fixes the program's structure. The parameters are never part of the carry. A finished
    lane is a no-op: its carry stays, its records have no valid row and no active step. Randomness is
    `fold_in(key, counter)`, never a chain of splits in the carry, so that a lane's numbers do not depend
    on how often the engine paused.
    """

    @property
    @abc.abstractmethod
    def tables(self) -> Mapping[str, Table]:
        """Columns of every table: `"runs"` are those of `summary`, all others those of `Records`."""

    @property
    def recorded_tables(self) -> frozenset[str]:
        """Tables of which only the recorded runs' rows are kept (`record.runs`)."""
        return frozenset()

    @property
    def is_hosted(self) -> bool:
        """Whether something of it steps on the host: then it cannot be compiled whole."""
        return False

    @property
    def lanes_on_cpu(self) -> int:
        """Most lanes per device of a CPU where the config says nothing."""
        return 64

    @property
    @abc.abstractmethod
    def max_advances(self) -> int:
        """Number of advances after which every lane is done."""

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
        """The run's scalars: one row of `runs.parquet`."""

    def snapshot(self, carry: Carry) -> dict[str, dict[str, Array]]:
        """Arrays worth keeping for the recorded runs: `{name: {array name: array}}`."""
        del carry
        return {}

    def exported_state(self, carry: Carry) -> PyTree:
        """The state that a saved learner is restored from, a tree of arrays; None by default."""
        del carry
        return None
