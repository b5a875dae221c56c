"""State problems: continuous POMDPs given by a model for one state, with a belief of particles."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Scalar
from typing_extensions import override

from bojax.numerics.trial import check_names
from bojax.problems import particles
from bojax.problems.base import (
    ACCUMULATED_REWARD,
    DISCOUNTED_RETURN,
    DONE,
    PLANNED_VALUE,
    RETURN,
    REWARD,
    STEP,
    STEPS,
    Events,
    Problem,
)
from bojax.problems.particles import Particles
from bojax.problems.state_model import Action, Observation, State, StateModel
from bojax.results.schema import Column, Table

NUM_DRAWN = 64
"""Number of states of a belief that are recorded for pictures and films."""

OUTSIDE = Column("outside_actions", "int32", "", "steps whose action is outside of the space of actions")

COLLAPSES = Column("collapses", "int32", "", "times that no particle of the belief explained the observation")

OVERRIDABLE = (
    "actions",
    "initial",
    "step",
    "observe",
    "log_likelihood",
    "heuristic_value",
    "sketch",
    "filter",
)
"""Methods that a subclass defines or overrides; of others, it keeps the parameters."""

Sketch = dict[str, Float[Array, "*T N P"]]
"""Points by name, see `StateProblem.sketch`: of the true state, then of states of the belief."""


class StateEvents(Events):
    """Outcome of a step, see `Events`; a step cannot fail."""

    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    failed: Bool[Array, ""] | None = None


class Observed(eqx.Module):
    """What is observed of a step.

    Attributes:
        values: The observation.
        terminated: Whether the episode has ended.
    """

    values: Float[Array, "O"]
    terminated: Bool[Array, ""]


class StateProblem(StateModel, Problem):
    """A planning problem whose world is a state of a model, and whose belief is a set of particles.

    A subclass defines the model: `actions`, `initial`, `step`, `observe` and `log_likelihood`.

    Attributes:
        num_particles: Particles of the belief between plans.
    """

    num_particles: int = eqx.field(static=True, default=10_000, kw_only=True)
    samples_belief: ClassVar[bool] = True

    def __init_subclass__(cls, **kwargs):
        """Check the names of a user's class, or raise TypeError."""
        super().__init_subclass__(**kwargs)
        check_names(cls, StateProblem, OVERRIDABLE)

    @override
    def __check_init__(self):
        if self.num_particles < 1:
            raise ValueError(f"num_particles: got {self.num_particles}; allowed: >= 1")

    def sketch(self, state: State) -> dict[str, Float[Array, "P"]]:
        """What pictures and films draw of a state: named points of a plane, or numbers, drawn by step.

        By default, the first two components of the state, or its only one. The scenery is `outline`.
        """
        return {"state": state[:2]}

    def filter(
        self, key: Key[Array, ""], belief: Particles, action: Action, observation: Observation
    ) -> tuple[Particles, Bool[Array, ""]]:
        """The belief after an action and an observation, and whether no particle explains the observation."""
        return particles.update(self, key, belief, action, observation)

    @override
    def reset(self, key: Key[Array, ""]) -> State:
        return self.initial(key)

    @override
    def prior(self, key: Key[Array, ""], world: State, num_samples: int) -> Particles:
        """Draws from the initial belief, which do not depend on the world."""
        return particles.initial(self, key, self.num_particles).counted()

    @override
    def execute(
        self, key: Key[Array, ""], world: State, action: Action
    ) -> tuple[State, Observed, StateEvents]:
        key_step, key_observe = jax.random.split(key)
        after, reward, terminated = self.step(key_step, world, action)
        values = self.observe(key_observe, world, action, after)
        return after, Observed(values, terminated), StateEvents(reward, terminated)

    @override
    def update(
        self, belief: Particles, action: Action, observation: Observed, key: Key[Array, ""] | None = None
    ) -> Particles:
        assert key is not None and belief.collapses is not None and belief.outside is not None
        after, collapsed = self.filter(key, belief, action, observation.values)
        # No particle need explain the last observation of an episode.
        counts = collapsed & ~observation.terminated
        return replace(
            after,
            collapses=belief.collapses + counts.astype(jnp.int32),
            outside=belief.outside + (~self.actions.contains(action)).astype(jnp.int32),
        )

    @property
    @override
    def return_discount(self) -> Float[Array, ""]:
        return self.discount

    @property
    @override
    def run_columns(self) -> Table:
        return (RETURN, DISCOUNTED_RETURN, STEPS, COLLAPSES, OUTSIDE)

    @property
    @override
    def step_columns(self) -> Table:
        columns = [Column(name, "float64", "", meaning) for name, meaning in self._own_columns().items()]
        return (STEP, REWARD, PLANNED_VALUE, ACCUMULATED_REWARD, DONE, *columns)

    def _own_columns(self) -> dict[str, str]:
        """The names and meanings of the columns of a step that depend on the problem."""

        def rows(key: Key[Array, ""]) -> tuple[dict[str, Scalar], dict[str, Scalar]]:
            key_state, key_action, key_observe = jax.random.split(key, 3)
            action, state = self.actions.decode(self.actions.sample(key_action)), self.initial(key_state)
            values = self.observe(key_observe, state, action, state)  # `step` takes much longer to trace
            return self.step_row(action, Observed(values, jnp.zeros((), bool))), self.row(state)

        of_step, of_state = jax.eval_shape(rows, jax.random.key(0))
        meanings = {"action": "action", "observation": "observation after it"}
        other = "of the action and the observation after it"  # in a `step_row` of one's own
        found = {name: meanings.get(name.rpartition("_")[0], other) for name in of_step}
        return found | dict.fromkeys(of_state, "true state after the action")

    @override
    def step_row(self, action: Action, observation: Observed) -> dict[str, Scalar]:
        parts = {"action": action, "observation": observation.values}
        return {f"{name}_{i}": value for name, values in parts.items() for i, value in enumerate(values)}

    @override
    def row(self, world: State) -> dict[str, Scalar]:
        return {f"state_{index}": value for index, value in enumerate(world)}

    @override
    def begin_record(self, world: State, belief: Particles, num_samples: int) -> Sketch:
        points = self._points(world, belief)
        empty = (jnp.full((self.max_steps + 1, *x.shape), jnp.nan, x.dtype) for x in points.values())
        return {name: record.at[0].set(points[name]) for name, record in zip(points, empty, strict=True)}

    @override
    def record(
        self,
        record: Sketch,
        step: Int[Array, ""],
        action: Action,
        events: StateEvents,
        world: State,
        belief: Particles,
    ) -> Sketch:
        points = self._points(world, belief)
        return {name: rows.at[step + 1].set(points[name]) for name, rows in record.items()}

    @override
    def arrays(self, record: Sketch, world: State, belief: Particles) -> dict[str, dict[str, Array]]:
        """The points of every step, `[max_steps + 1, 1 + NUM_DRAWN, P]`; NaN after the last one."""
        return {"sketch": record}

    def _points(self, world: State, belief: Particles) -> Sketch:
        states = jnp.concatenate([world[None], belief.quantiles(NUM_DRAWN)])
        return jax.vmap(self.sketch)(states)

    @override
    def summary(self, record: Sketch, world: State, belief: Particles) -> dict[str, Scalar]:
        assert belief.collapses is not None and belief.outside is not None
        return {COLLAPSES.name: belief.collapses, OUTSIDE.name: belief.outside}
