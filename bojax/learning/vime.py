"""VIME: rewards for information gain about the dynamics (Houthooft et al., NeurIPS 2016), learned by TRPO."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, Key, Scalar
from typing_extensions import override

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Box, Discrete, Space
from bojax.learning.advantages import LinearBaseline, discounted_sums, td_errors
from bojax.learning.base import Episode, ExplorationState, Learner
from bojax.learning.memory import EpisodeBatch, ReplayPool, Standardisation, emptied
from bojax.learning.networks import PolicyNetwork
from bojax.learning.trpo import TRPO, Samples
from bojax.models.bayesian_network import BayesianNetwork
from bojax.numerics.lanes import any_lane
from bojax.results.schema import Column, Table

_CHUNK = 256  # number of transitions whose gradients are computed at once

_LEAST_DEVIATION = 1e-4
"""Added to the standard deviations that divide observations and actions, in units of half a range."""


class VIMEState(eqx.Module):
    """The state of `VIME`."""

    observations: Space  # space of observations
    actions: Space  # space of actions
    policy: PolicyNetwork  # network of the policy
    baseline: LinearBaseline  # baseline of the returns
    model: BayesianNetwork  # posterior of the dynamics model
    optimiser: optax.OptState  # state of Adam for the model
    pool: ReplayPool  # transitions of the finished iterations
    batch: EpisodeBatch  # episodes of the current iteration
    medians: Float[Array, "Q"]  # medians of the bonuses of the last Q iterations; 0 where fewer have finished
    iterations: Int[Array, ""]  # number of finished iterations


class VIME(Learner):
    """TRPO on rewards r + eta D, with D the information gain about a model of the dynamics.

    The model is a Bayesian neural network from (s, a) to s'. D of a transition is twice the KL divergence
    between the posteriors after and before a Newton step on it, clipped, and divided by the mean over the
    last iterations of the medians of D.

    Episodes are collected until they have `iteration_steps` steps together, all with one policy. Then an
    iteration takes place: the bonuses of its steps, by the model as it is; a step of TRPO with advantages
    less a linear baseline; a fit of the baseline to the returns without bonuses; and updates of the model
    with transitions drawn from a pool of all. As in the published code (openai/vime, with rllab), there is
    no bonus in the first iteration, the last step of an episode takes the bonus of the step before it, and
    returns end with an episode, whatever ended it.

    Deviations from that code:

    - Observations and continuous actions are mapped to [-1, 1] by their declared bounds; that code maps
      actions only, and the thesis says that states are normalised. Discrete ones are one-hot.
    - A row of the pool is a transition; in that code, it is a step of a path, and the next row may belong to
      the next path.
    - The standard deviations that divide the model's inputs and outputs are increased by 1e-4 instead of
      1e-8, with which single precision overflows where a component hardly changes.
    - A policy update that violates the bound is discarded; that code keeps the last one that it tried.

    As long as all rewards are 0, eta has no effect, since advantages are standardised.

    Settings: `bojax.learning.settings.VIME`.
    """

    # Iteration time and memory grow with the number of lanes.
    lanes_on_cpu: ClassVar[int] = 16

    discount: Float[Array, ""]
    eta: Float[Array, ""]
    trace_decay: Float[Array, ""]
    max_kl: Float[Array, ""]
    damping: Float[Array, ""]
    backtrack_ratio: Float[Array, ""]
    initial_deviation: Float[Array, ""]
    prior_deviation: Float[Array, ""]
    likelihood_deviation: Float[Array, ""]
    num_batches: Float[Array, ""]
    model_learning_rate: Float[Array, ""]
    gain_step: Float[Array, ""]
    max_bonus: Float[Array, ""]
    min_pool: Float[Array, ""]
    policy_units: tuple[int, ...] = eqx.field(static=True)
    cg_steps: int = eqx.field(static=True)
    backtracks: int = eqx.field(static=True)
    iteration_steps: int = eqx.field(static=True)
    longest_episode: int = eqx.field(static=True)
    model_units: int = eqx.field(static=True)
    model_updates: int = eqx.field(static=True)
    model_batch: int = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)
    num_medians: int = eqx.field(static=True)
    pool_size: int = eqx.field(static=True)
    block: int = eqx.field(static=True)

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        return self.eta

    @override
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> VIMEState:
        key_policy, key_model = jax.random.split(key)
        dtype = self.eta.dtype
        observation, action = observation_space.example, action_space.example
        size = observation_space.num_units
        policy = PolicyNetwork.draw(key_policy, size, self.policy_units, action_space, self.initial_deviation)
        sizes = size + action_space.num_units, self.model_units, size
        model = BayesianNetwork.draw(key_model, sizes, self.prior_deviation)
        # With D and A the sizes of observations and actions, a lane keeps 2 D + A numbers a row of the pool,
        # and 2 D + A + 3 a row of the batch: in single precision 1.2 MB for 100 episodes of 500 steps on
        # mountain car, and 5.6 MB on the hopper. An iteration needs about 20 MB more for each lane. At least
        # one row: an empty array cannot be spread over devices.
        pool_size = max(1, min(self.pool_size, capacity))
        batch_size = max(1, min(self.iteration_steps + self.longest_episode - 1, capacity))
        if batch_size > _CHUNK:  # whole chunks: a remainder would be a program of its own
            batch_size = -(-batch_size // _CHUNK) * _CHUNK
        return VIMEState(
            observations=observation_space,
            actions=action_space,
            policy=policy,
            baseline=LinearBaseline.zero(size, dtype),
            model=model,
            optimiser=self._optimiser.init(eqx.filter(model, eqx.is_array)),
            pool=ReplayPool.empty(pool_size, observation, action),
            batch=EpisodeBatch.empty(batch_size, observation, action, dtype),
            medians=jnp.zeros((self.num_medians,), dtype),
            iterations=jnp.zeros((), jnp.int32),
        )

    @override
    def act(
        self, key: Key[Array, ""], state: VIMEState, observation: Observation, exploration: ExplorationState
    ) -> tuple[Action, Float[Array, ""]]:
        """A draw from the policy; its most probable action if it neither explores nor learns."""
        distribution = state.policy(self._vectors(state.observations, observation))
        is_random = exploration.is_learning | (exploration.scale > 0.0)
        action = jnp.where(is_random, distribution.sample(key), distribution.mode())
        if isinstance(space := state.actions, Box):
            action = space.from_unit(0.5 * (action + 1.0))
        return action, self.values(state, observation, action)[0]

    @override
    def end_episode(
        self, key: Key[Array, ""], state: VIMEState, episode: Episode, exploration: ExplorationState
    ) -> VIMEState:
        """Collect the episode, and run an iteration if there are enough steps."""
        batch = state.batch.add(episode, self.longest_episode, exploration.is_learning)
        state = eqx.tree_at(lambda s: s.batch, state, batch)
        is_due = exploration.is_learning & (batch.memory.count >= self.iteration_steps)
        weight = exploration.scale * self.eta
        # `vmap` batches the branches of a condition twice, but a function that is jitted there once.
        iterate = jax.jit(lambda: self._iterate(key, state, weight, is_due))
        # An iteration costs as much as many episodes: none is computed if no lane of the device needs it. If
        # any does, all compute one, and `is_due` masks it: a batch is slower where episodes end at different
        # times.
        return jax.lax.cond(any_lane(is_due), iterate, lambda: state)

    @override
    def policy_state(self, state: VIMEState) -> VIMEState:
        return eqx.tree_at(lambda s: (s.pool, s.batch), state, emptied((state.pool, state.batch)))

    @property
    @override
    def columns(self) -> Table:
        return (Column("iterations", "int32", "", "updates of the policy"),)

    @override
    def summary(self, state: VIMEState) -> dict[str, Scalar]:
        return {"iterations": state.iterations}

    @override
    def values(
        self, state: VIMEState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The return that the baseline predicts for the state at the start of an episode, and 0."""
        inputs = self._vectors(state.observations, observation[None])
        value = state.baseline.predict(inputs, jnp.zeros((1,), jnp.int32))[0]
        return value, jnp.zeros_like(value)

    # An iteration.

    def _iterate(
        self, key: Key[Array, ""], state: VIMEState, weight: Float[Array, ""], is_due: Bool[Array, ""]
    ) -> VIMEState:
        """The state after an iteration if `is_due`, else unchanged."""
        # In the order of the published code: bonuses by the model as it was during these episodes, then the
        # policy, then the model. Rows past the count belong to an earlier batch and are masked throughout.
        key_bonus, key_model = jax.random.split(key)
        batch, memory = state.batch, state.batch.memory
        is_valid, is_last = batch.is_valid, batch.is_last
        bonus, medians = self._bonus(key_bonus, state)

        inputs = self._vectors(state.observations, memory.observations)
        rewards = jnp.where(is_valid, memory.rewards, 0.0)
        values = state.baseline.predict(inputs, batch.steps)
        errors = td_errors(rewards + weight * bonus, values, is_last, self.discount)
        # Returns are discounted sums of rewards without bonuses, advantages those of TD errors by gamma
        # lambda (generalised advantage estimation). One program computes both, as it takes seconds to
        # compile.
        returns, gains = jax.vmap(discounted_sums, in_axes=(0, None, 0))(
            jnp.stack([rewards, errors]),
            is_last,
            jnp.stack([self.discount, self.discount * self.trace_decay]),
        )
        baseline = LinearBaseline.fit(inputs, batch.steps, returns, is_valid)
        samples = Samples(inputs, self._drawn(state.actions, memory.actions), gains, is_valid)
        policy = self._trpo.improved(state.policy, _standardised(samples), is_due)

        # The model is fitted with this iteration's transitions already in the pool.
        pool = state.pool.add(memory, is_due)
        model, optimiser = self._fit(key_model, state, pool)
        is_trained = is_due & (pool.size.astype(self.min_pool.dtype) >= self.min_pool)

        # Selects of what is small. The pool and the batch mask their own writes: a select would copy them
        # whole.
        small = policy, baseline, medians, state.iterations + 1
        before = state.policy, state.baseline, state.medians, state.iterations
        policy, baseline, medians, iterations = optax.tree.where(is_due, small, before)
        model, optimiser = optax.tree.where(is_trained, (model, optimiser), (state.model, state.optimiser))
        return replace(
            state,
            policy=policy,
            baseline=baseline,
            model=model,
            optimiser=optimiser,
            pool=pool,
            batch=batch.emptied(is_due),
            medians=medians,
            iterations=iterations,
        )

    def _bonus(self, key: Key[Array, ""], state: VIMEState) -> tuple[Float[Array, "C"], Float[Array, "Q"]]:
        """The normalised bonus of each step of the batch, and the medians including this iteration's."""
        batch, memory = state.batch, state.batch.memory
        to_inputs, to_outputs = self._standardisations(state, state.pool)
        inputs, outputs = self._pairs(state, memory.observations, memory.actions, memory.next_observations)
        inputs, outputs = to_inputs(inputs, _LEAST_DEVIATION), to_outputs(outputs, _LEAST_DEVIATION)

        # Each step has noise of its own, by its row number. In chunks: a gradient of every weight for each of
        # thousands of steps at once would not fit into memory.
        def gain(row):
            number, inputs, outputs = row
            return state.model.information_gain(
                state.model.draw_noise(jax.random.fold_in(key, number), (self.num_samples,)),
                inputs,
                outputs,
                likelihood=self.likelihood_deviation,
                step=self.gain_step,
            )

        rows = jnp.arange(len(inputs), dtype=jnp.int32), inputs, outputs
        bonus = jnp.clip(jax.lax.map(gain, rows, batch_size=_CHUNK), 0.0, self.max_bonus)
        # As in the published code, the last step of an episode takes the bonus of the step before it.
        before = jnp.append(bonus[:1], bonus[:-1])
        bonus = jnp.where(batch.is_last & (batch.steps > 0), before, bonus)

        # A ring of the last medians, from iteration 1 on: there is no bonus in iteration 0, whose write is
        # past the end and dropped. Unused places are 0 and do not change the sum.
        iteration = state.iterations - 1
        place = jnp.where(iteration >= 0, iteration % self.num_medians, self.num_medians)
        medians = state.medians.at[place].set(_median(bonus, batch.is_valid), mode="drop")
        number = jnp.minimum(state.iterations, self.num_medians).astype(bonus.dtype)
        mean = jnp.sum(medians) / jnp.maximum(number, 1.0)
        has_bonus = batch.is_valid & (iteration >= 0) & (mean > 0.0)
        return jnp.where(has_bonus, bonus / jnp.where(mean > 0.0, mean, 1.0), 0.0), medians

    def _fit(
        self, key: Key[Array, ""], state: VIMEState, pool: ReplayPool
    ) -> tuple[BayesianNetwork, optax.OptState]:
        """The model and the optimiser after the updates of an iteration, with batches from the pool."""
        # All rows and all noise are drawn before the loop, which then contains arithmetic alone.
        key_rows, key_noise = jax.random.split(key)
        shape = self.model_updates, self.model_batch
        rows = pool.draw(key_rows, self.model_updates * self.model_batch)
        observations, actions = pool.observations[rows], pool.actions[rows]
        pairs = self._pairs(state, observations, actions, pool.next_observations[rows])
        standardisations = self._standardisations(state, pool)
        inputs, outputs = (
            to(part, _LEAST_DEVIATION).reshape(*shape, -1)
            for to, part in zip(standardisations, pairs, strict=True)
        )
        noise = state.model.draw_noise(key_noise, (self.model_updates, self.num_samples))

        def update(carry, batch):
            model, optimiser = carry
            gradient = jax.grad(BayesianNetwork.loss)(
                model,
                *batch,
                prior=self.prior_deviation,
                likelihood=self.likelihood_deviation,
                num_batches=self.num_batches,
            )
            with jax.numpy_dtype_promotion("standard"):  # optax adds integers of two widths
                change, optimiser = self._optimiser.update(gradient, optimiser)
            model = jax.tree.map(lambda x, d: x - self.model_learning_rate * d, model, change)
            return (model, optimiser), None

        return jax.lax.scan(update, (state.model, state.optimiser), (noise, inputs, outputs))[0]

    @property
    def _optimiser(self) -> optax.GradientTransformation:
        return optax.scale_by_adam()

    @property
    def _trpo(self) -> TRPO:
        return TRPO(self.max_kl, self.damping, self.backtrack_ratio, self.cg_steps, self.backtracks)

    # Observations and actions as vectors.

    def _vectors(self, space: Space, values: Observation | Action) -> Float[Array, "*N D"]:
        return space.inputs(values, self.eta.dtype)

    def _drawn(self, space: Space, actions: Action) -> Array:
        """Actions as the policy drew them."""
        return actions if isinstance(space, Discrete) else self._vectors(space, actions)

    def _pairs(
        self, state: VIMEState, observations: Observation, actions: Action, next_observations: Observation
    ) -> tuple[Float[Array, "N I"], Float[Array, "N O"]]:
        """Inputs and outputs of the model for some transitions, not standardised."""
        before, after = (self._vectors(state.observations, x) for x in (observations, next_observations))
        return jnp.concatenate([before, self._vectors(state.actions, actions)], axis=1), after

    def _standardisations(
        self, state: VIMEState, pool: ReplayPool
    ) -> tuple[Standardisation, Standardisation]:
        """The standardisations of inputs and of outputs; s and s' have the statistics of s."""
        rows, _ = self._pairs(state, pool.observations, pool.actions, pool.next_observations)
        inputs = Standardisation.of(rows, pool.is_filled)
        number = state.observations.num_units
        return inputs, Standardisation(inputs.mean[:number], inputs.deviation[:number])


def _standardised(samples: Samples) -> Samples:
    """Samples whose advantages have mean 0 and standard deviation 1."""
    centred = samples.advantages - samples.mean(samples.advantages)
    deviation = jnp.sqrt(samples.mean(centred**2))
    return eqx.tree_at(lambda s: s.advantages, samples, centred / (deviation + 1e-8))


def _median(values: Float[Array, "N"], is_valid: Bool[Array, "N"]) -> Float[Array, ""]:
    """Median of the valid values; at least one is valid."""
    ordered = jnp.sort(jnp.where(is_valid, values, jnp.inf))
    number = jnp.maximum(jnp.sum(is_valid, dtype=jnp.int32), 1)
    return 0.5 * (ordered[(number - 1) // 2] + ordered[number // 2])
