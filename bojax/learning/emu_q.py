"""EMU-Q: exploration by minimising the uncertainty of Q values (thesis, Section 5.6, Algorithm 6)."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Box, Discrete, Space
from bojax.learning.actions import even_actions
from bojax.learning.balance import Ties, best_action
from bojax.learning.base import Balance, Episode, Experience, Learner
from bojax.learning.features import FeatureSpec, StateActionFeatures
from bojax.learning.memory import Memory
from bojax.learning.refit import Q, U, refit
from bojax.models.bayesian_linear_regression import BayesianLinearRegression
from bojax.numerics.linalg import matmul


class EMUQState(eqx.Module):
    """What EMU-Q knows.

    Attributes:
        features: The map phi of this run.
        posterior: The weights of Q and U, with one covariance S.
        memory: All transitions.
        candidates: Actions among which the policy chooses, `[J, ...]`.
        samples: Actions over which the exploration reward averages, `[K, ...]`.
    """

    features: StateActionFeatures
    posterior: BayesianLinearRegression
    memory: Memory
    candidates: Action
    samples: Action


class EMUQ(Learner):
    """EMU-Q with the corrections of the printed algorithm, or as the author's published code has it.

    The exploration reward of a transition (5.12) is the mean variance phi'S phi of Q at the next state, less
    V_max = 1/alpha, its greatest value: so it is never above 0. The policy is argmax Q + kappa U, with kappa
    in units of 1/V_max (p. 136 of the PDF: kappa = 1/V_max). With (5.22) in gain form the targets need not
    be rebuilt after a refit, as lines 10-12 of Algorithm 6 would have to; a' in its lines 10-11 is
    pi(s'), which is missing there. A time limit bootstraps, an absorbing state does not.

    Attributes:
        features: Which features.
        prior_precision: Precision of every weight, alpha.
        noise_precision: Precision of the targets, beta.
        discount: Discount of rewards per step, gamma.
        kappa: Weight of exploration, in units of 1/V_max = alpha.
        num_actions: Candidates of the argmax, where actions are continuous.
        num_samples: Actions of the mean in the exploration reward, where they are continuous.
        draw_actions: Candidates and samples drawn `once` for a run (evenly, by a scrambled Halton sequence),
            or `always` anew (uniformly, as the published code does).
        refine_steps: Steps that refine the best candidate; each tries a move up and down every dimension,
            half as long as the step before.
        reward_order: Exploration reward `before` the covariance has seen the transition (Algorithm 6), or
            `after` it (published code).
        terminal_q: Q of an absorbing state: `zero`, or what the model says (`bootstrap`, published code).
        terminal_u: U of an absorbing state: `absorbing`, r_e / (1 - gamma), as if it went on paying r_e for
            ever; `bootstrap` (published code); or `zero`, with which dying explores best.
        optimistic_u: Whether U is pulled to 0 where nothing was seen, U (1 - rho) with rho the variance
            between its least and greatest value (published code; the thesis has nothing of it).
        has_noise: Whether the variance in the exploration reward holds 1/beta too (published code).
        refit: At the end of an episode: `sweeps` of targets and means over all transitions, `direct`
            solution of the linear equations that the sweeps converge to, or `none`.
        max_sweeps: Most sweeps, or most policies whose equations are solved.
        tolerance: Change of the weights (Euclidean norm) at which sweeps stop.
        mixes_transitions: Whether the refit's exploration rewards are averaged over the wrong axis, as in
            the published code.
        block: Steps between two flushes of the covariance.
        refit_block: Transitions whose features are in memory at a time during a refit.
    """

    features: FeatureSpec
    prior_precision: Float[Array, ""]
    noise_precision: Float[Array, ""]
    discount: Float[Array, ""]
    kappa: Float[Array, ""]
    tolerance: Float[Array, ""]
    num_actions: int = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)
    draw_actions: Literal["once", "always"] = eqx.field(static=True)
    refine_steps: int = eqx.field(static=True)
    reward_order: Literal["before", "after"] = eqx.field(static=True)
    terminal_q: Literal["zero", "bootstrap"] = eqx.field(static=True)
    terminal_u: Literal["absorbing", "bootstrap", "zero"] = eqx.field(static=True)
    optimistic_u: bool = eqx.field(static=True)
    has_noise: bool = eqx.field(static=True)
    refit: Literal["sweeps", "direct", "none"] = eqx.field(static=True)
    max_sweeps: int = eqx.field(static=True)
    mixes_transitions: bool = eqx.field(static=True)
    block: int = eqx.field(static=True)
    refit_block: int = eqx.field(static=True)

    @property
    def exploration_weight(self) -> Float[Array, ""]:
        """See `Learner`: kappa / V_max."""
        return self.kappa * self.prior_precision

    @property
    def lanes_on_cpu(self) -> int:
        """See `Learner`: more covariances than these leave the cache of a core."""
        return 8

    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> EMUQState:
        """See `Learner`."""
        key_features, key_candidates, key_samples = jax.random.split(key, 3)
        dtype = self.prior_precision.dtype
        features = self.features.draw(key_features, observation_space, action_space, dtype)
        candidates = even_actions(key_candidates, self.num_actions, action_space)
        if isinstance(observation_space, Discrete):
            observation = jnp.zeros((), jnp.int32)
        else:
            observation = jnp.zeros_like(observation_space.low)
        # At least one row: an array without a number cannot be spread over devices.
        room = max(1, 0 if self.refit == "none" else capacity)
        return EMUQState(
            features=features,
            posterior=BayesianLinearRegression.prior(
                features.num_features,
                self.prior_precision,
                self.noise_precision,
                num_targets=2,
                block=self.block,
            ),
            memory=Memory.empty(room, observation, candidates[0], dtype),
            candidates=candidates,
            samples=even_actions(key_samples, self.num_samples, action_space),
        )

    def act(
        self, key: Key[Array, ""], state: EMUQState, observation: Observation, balance: Balance
    ) -> tuple[Action, Float[Array, ""]]:
        """See `Learner`: argmax Q + kappa U over the candidates (5.10)."""
        key_draw, key_ties = jax.random.split(key)
        candidates, _ = self.draw(key_draw, state)
        x = state.features.state(observation)
        phi = self._joined(state, x, candidates)
        values = self._values(state, phi)
        kappa = balance.exploration * self.exploration_weight
        best = best_action(key_ties, values[:, Q], values[:, U], kappa, self._ties(state))
        action, expected = candidates[best], values[best, Q]
        if self.refine_steps and isinstance(state.features.actions, Box):
            action = self._refined(state, x, candidates, action, balance)
            expected = self._values(state, self._joined(state, x, action[None]))[0, Q]
        return action, expected

    def observe(
        self,
        key: Key[Array, ""],
        state: EMUQState,
        experience: Experience,
        balance: Balance,
        slot: Int[Array, ""],
    ) -> EMUQState:
        """See `Learner`: lines 8 to 12 of Algorithm 6, from one product with the covariance."""
        candidates, samples = self.draw(key, state)
        posterior = state.posterior
        phi = state.features(experience.observation, experience.action)
        x = state.features.state(experience.next_observation)
        num_samples = len(samples)
        phi_both = self._joined(state, x, jnp.concatenate([samples, candidates]))
        phi_next = phi_both[num_samples:]
        rows = jnp.concatenate([phi[None], phi_both if self.optimistic_u else phi_both[:num_samples]])
        products = posterior.covariance_times(rows)
        variances = jnp.sum(rows * products, axis=1)
        weight = balance.is_learning.astype(variances.dtype)

        next_values = matmul(phi_next, posterior.mean)
        if self.optimistic_u:
            next_values = next_values.at[:, U].multiply(self.trust(variances[1 + num_samples :]))
        kappa = balance.exploration * self.exploration_weight
        best = jnp.argmax(next_values[:, Q] + kappa * next_values[:, U])
        if self.reward_order == "after":
            row = posterior.row(phi, sample_weight=weight, product=products[0])
            variances = variances - matmul(rows, row) ** 2
        bonus = self.bonus(jnp.mean(variances[1 : 1 + num_samples]))
        target = self._targets(experience.reward, bonus, next_values[best], experience.terminated)
        posterior = posterior.update(phi, target, sample_weight=weight, product=products[0], slot=slot)
        return eqx.tree_at(lambda s: s.posterior, state, posterior)

    def consolidate(self, state: EMUQState) -> EMUQState:
        """See `Learner`: flush the covariance."""
        return eqx.tree_at(lambda s: s.posterior, state, state.posterior.flush())

    def end_episode(
        self, key: Key[Array, ""], state: EMUQState, episode: Episode, balance: Balance
    ) -> EMUQState:
        """See `Learner`: lines 14 to 17 of Algorithm 6; the covariance stays."""
        if self.refit == "none":
            return state
        state = eqx.tree_at(lambda s: s.memory, state, state.memory.add(episode, balance.is_learning))
        kappa = balance.exploration * self.exploration_weight
        mean = refit(self, key, state, kappa, balance.is_learning)
        return eqx.tree_at(lambda s: s.posterior.mean, state, mean)

    def values(
        self, state: EMUQState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """See `Learner`."""
        values = self._values(state, state.features(observation, action)[None])[0]
        return values[Q], values[U]

    def without_memory(self, state: EMUQState) -> EMUQState:
        """See `Learner`."""
        memory = jax.tree.map(lambda rows: jnp.zeros_like(rows[:1] if rows.ndim else rows), state.memory)
        return eqx.tree_at(lambda s: s.memory, state, memory)

    # Actions.

    def draw(self, key: Key[Array, ""], state: EMUQState) -> tuple[Action, Action]:
        """Candidates and samples: those of the run, or fresh ones."""
        if self.draw_actions == "once" or not isinstance(state.features.actions, Box):
            return state.candidates, state.samples
        number = len(state.candidates)
        shape = (number + len(state.samples), *state.candidates.shape[1:])
        drawn = state.features.actions.from_unit(jax.random.uniform(key, shape, state.candidates.dtype))
        return drawn[:number], drawn[number:]

    def _ties(self, state: EMUQState) -> Ties:
        """Fresh candidates are in no order: then the first of the best is as random as any."""
        is_fresh = self.draw_actions == "always" and isinstance(state.features.actions, Box)
        return "first" if is_fresh else "random"

    def _refined(self, state, x, candidates, action, balance) -> Action:
        """The best move along a coordinate, each half as long as the last; first the candidates' spacing."""
        kappa = balance.exploration * self.exploration_weight
        space = state.features.actions
        width = (space.high - space.low) / len(candidates) ** (1.0 / space.num_dims)

        def improve(i, action):
            step = (width * 0.5**i)[None, :] * jnp.concatenate(
                [jnp.eye(space.num_dims), -jnp.eye(space.num_dims), jnp.zeros((1, space.num_dims))]
            ).astype(action.dtype)
            around = jnp.clip(action[None, :] + step, space.low[None, :], space.high[None, :])
            values = self._values(state, self._joined(state, x, around))
            return around[jnp.argmax(values[:, Q] + kappa * values[:, U])]

        return jax.lax.fori_loop(0, self.refine_steps, improve, action)

    # Values.

    def _joined(self, state: EMUQState, x: Float[Array, "P"], actions: Action) -> Float[Array, "J M"]:
        features = state.features
        return jax.vmap(lambda action: features.join(x, features.action(action)))(actions)

    def _values(self, state: EMUQState, phi: Float[Array, "J M"]) -> Float[Array, "J 2"]:
        """Q and U."""
        values = matmul(phi, state.posterior.mean)
        if not self.optimistic_u:
            return values
        variances = jnp.sum(phi * state.posterior.covariance_times(phi), axis=1)
        return values.at[:, U].multiply(self.trust(variances))

    def trust(self, variances: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """1 - rho, with rho from 0 at the least variance to 1 where nothing was seen: a factor of U.

        The least variance of random Fourier features is an empirical figure of the published code.
        """
        lengthscale = getattr(self.features, "state_lengthscale", jnp.ones((), self.discount.dtype))
        least = 1.0 / (lengthscale * (8.0 * self.noise_precision + self.prior_precision))
        return 1.0 - jnp.maximum((variances - least) / (1.0 / self.prior_precision - least), 0.0)

    def bonus(self, variance: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """The exploration reward (5.12)."""
        noise = 1.0 / self.noise_precision if self.has_noise else 0.0
        return variance + noise - 1.0 / self.prior_precision

    def _targets(self, reward, bonus, next_values, terminated) -> Float[Array, "*N 2"]:
        """R + gamma Q(s', a') and r_e + gamma U(s', a')."""
        q, u = next_values[..., Q], next_values[..., U]
        if self.terminal_q == "zero":
            q = jnp.where(terminated, 0.0, q)
        if self.terminal_u == "zero":
            u = jnp.where(terminated, 0.0, u)
        elif self.terminal_u == "absorbing":
            u = jnp.where(terminated, bonus / (1.0 - self.discount), u)
        return jnp.stack([reward + self.discount * q, bonus + self.discount * u], axis=-1)
