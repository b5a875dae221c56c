"""The linear model of EMU-Q: values, exploration rewards and TD targets (thesis, Section 5.6).

Each method states what Algorithm 6 computes, and then the options: other readings of terminal states, and the
deviations of the author's published code.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Box
from bojax.learning.features import FeatureSpec, StateActionFeatures
from bojax.learning.memory import Memory, StoredRewards
from bojax.learning.policy import Ties, best_action
from bojax.models.bayesian_linear_regression import BayesianLinearRegression
from bojax.numerics.choices import Choice, one_of
from bojax.numerics.linalg import matmul

Q, U = 0, 1  # columns of the mean of the weights


class EMUQState(eqx.Module):
    """The state of `EMUQ`."""

    features: StateActionFeatures  # feature map phi of this run
    posterior: BayesianLinearRegression  # posterior of the weights of Q and U, which share one covariance S
    memory: Memory  # all transitions
    candidates: Action  # actions over which the policy maximises, `[J, ...]`
    samples: Action  # actions over which the exploration reward averages, `[K, ...]`
    stored: StoredRewards | None  # exploration rewards for refits; None if they are recomputed

    def phi(self, observation: Observation, actions: Action) -> Float[Array, "J M"]:
        """Features of several actions in a state."""
        return jax.vmap(lambda action: self.features(observation, action))(actions)


class EMUQModel(eqx.Module):
    """The part of `EMUQ` that computes what Algorithm 6 does from the posterior of the weights."""

    features: FeatureSpec
    prior_precision: Float[Array, ""]
    noise_precision: Float[Array, ""]
    discount: Float[Array, ""]
    u_discount: Float[Array, ""] | None
    draw_actions: Literal["once", "always"] = eqx.field(static=True)
    reward_order: Literal["before", "after"] = eqx.field(static=True)
    terminal_q: Choice = eqx.field(converter=one_of("zero", "bootstrap"))
    terminal_u: Choice = eqx.field(converter=one_of("absorbing", "bootstrap", "zero"))
    optimistic_u: bool = eqx.field(static=True)
    has_noise: bool = eqx.field(static=True)
    mixes_transitions: bool = eqx.field(static=True)
    clips_u: bool = eqx.field(static=True)

    # Actions.

    def actions(self, key: Key[Array, ""], state: EMUQState) -> tuple[Action, Action]:
        """Candidates and samples: uniform draws, or those of the run with `draw_actions="once"`."""
        if not self._draws_anew(state):
            return state.candidates, state.samples
        space, number = state.features.actions, len(state.candidates)
        assert isinstance(space, Box)
        shape = (number + len(state.samples), *state.candidates.shape[1:])
        drawn = space.from_unit(jax.random.uniform(key, shape, state.candidates.dtype))
        return drawn[:number], drawn[number:]

    def ties(self, state: EMUQState) -> Ties:
        """How the policy breaks ties. Fresh draws are in random order, so that the first one may be taken."""
        return "first" if self._draws_anew(state) else "random"

    def _draws_anew(self, state: EMUQState) -> bool:
        return self.draw_actions == "always" and isinstance(state.features.actions, Box)

    # Values.

    def q_and_u(self, posterior: BayesianLinearRegression, phi: Float[Array, "J M"]) -> Float[Array, "J 2"]:
        """Q and U: phi'm_Q and phi'm_U."""
        # Both means share the features: one product with two columns.
        values = matmul(phi, posterior.mean)
        if not self.optimistic_u:
            return values
        variances = jnp.sum(phi * posterior.covariance_times(phi), axis=1)
        return values.at[:, U].multiply(self.u_factor(variances))

    def greedy_action(
        self,
        key: Key[Array, ""],
        state: EMUQState,
        observation: Observation,
        actions: Action,
        kappa: Float[Array, ""],
        ties: Ties,
    ) -> tuple[Action, Float[Array, "2"]]:
        """The action that maximises Q + kappa U (5.10), and its Q and U."""
        phi, mean = state.phi(observation, actions), state.posterior.mean
        if self.optimistic_u:
            values = self.q_and_u(state.posterior, phi)
            scores = values[:, Q] + kappa * values[:, U]
        else:
            # A single product: XLA fuses it with the features on a GPU, and does not store them.
            scores = matmul(phi, mean[:, Q] + kappa * mean[:, U])
        # Q and U of the chosen action alone, with its features computed again: to keep those of all
        # candidates would cost more than to compute one.
        action = actions[best_action(key, scores, ties)]
        return action, self.q_and_u(state.posterior, state.phi(observation, action[None]))[0]

    def u_factor(self, variances: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """With `optimistic_u`, the factor 1 - rho of U at features of the given variances; 1 in Algorithm 6.

        rho is 0 at the smallest variance and 1 where nothing was observed. The smallest variance of random
        Fourier features is an empirical formula of the published code.
        """
        if not self.optimistic_u:
            return jnp.ones_like(variances)
        lengthscale = getattr(self.features, "state_lengthscale", jnp.ones_like(self.discount))
        smallest = 1.0 / (lengthscale * (8.0 * self.noise_precision + self.prior_precision))
        rho = jnp.maximum((variances - smallest) / (1.0 / self.prior_precision - smallest), 0.0)
        return 1.0 - rho

    # Exploration rewards.

    @property
    def discount_of_u(self) -> Float[Array, ""]:
        """Discount of exploration rewards."""
        return self.discount if self.u_discount is None else self.u_discount

    def exploration_reward(self, variance: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """The exploration reward (5.12): the mean variance of Q at s' minus its maximum V_max = 1/alpha.

        With `has_noise` the variance includes the noise variance, 1/beta.
        """
        noise = 1.0 / self.noise_precision if self.has_noise else 0.0
        return variance + noise - 1.0 / self.prior_precision

    def clipped_u(self, u: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """With `clips_u`, U clipped to the returns that exploration rewards allow; otherwise U.

        An exploration reward is lowest at variance 0 and highest at V_max.
        """
        if not self.clips_u:
            return u
        variances = jnp.stack([jnp.zeros_like(self.prior_precision), 1.0 / self.prior_precision])
        low, high = self.exploration_reward(variances) / (1.0 - self.discount_of_u)
        return jnp.clip(u, low, high)

    def sample_variances(
        self,
        posterior: BayesianLinearRegression,
        phi: Float[Array, "N M"],
        variances: Float[Array, "N"],
        product: Float[Array, "M"],
        weight: Float[Array, ""],
    ) -> Float[Array, "K"]:
        """Variances of Q at s' with every sampled action, before the covariance is updated.

        With `reward_order="after"`, after it is updated. `phi` holds the features of (s, a), then those of s'
        with every sampled action; `variances` are theirs, `product` is the covariance times the first, and
        `weight` is 0 if the covariance is not going to be updated.
        """
        if self.reward_order == "after":
            # The update subtracts r r' from S, and so (phi'r)^2 from the variance at phi: the covariance
            # after it is not needed.
            row = posterior.row(phi[0], sample_weight=weight, product=product)
            variances = variances - matmul(phi, row) ** 2
        return variances[1:]

    def mean_variances(self, variances: Float[Array, "C K"], count: Int[Array, ""]) -> Float[Array, "C"]:
        """Mean over the K sampled actions of each of the first `count` transitions, for the refit.

        With `mixes_transitions` the mean is over the wrong axis: the published code reads the N x K
        variances, stored transition by transition, as K rows of N, and averages the columns.
        """
        capacity, number = variances.shape
        if not self.mixes_transitions or number == 1:
            return jnp.mean(variances, axis=1)
        # Row-major K x count, read column by column: entry (k, n) of that reading is number k count + n.
        index, action = jnp.arange(capacity, dtype=jnp.int32), jnp.arange(number, dtype=jnp.int32)
        place = index[:, None] + action[None, :] * count
        return jnp.mean(variances.ravel().at[place].get(mode="fill", fill_value=0.0), axis=1)

    # TD targets. Q of a terminal state is 0, and U is as if the state went on paying r_e for ever.

    def td_target(
        self,
        reward: Float[Array, ""],
        bonus: Float[Array, ""],
        next_values: Float[Array, "2"],
        terminated: Bool[Array, ""],
    ) -> Float[Array, "2"]:
        """The TD targets r + gamma Q(s', a') and r_e + gamma U(s', a') (5.14)."""
        # An absorbing state pays r_e in every step to come: r_e + gamma r_e / (1 - gamma) = r_e / (1 -
        # gamma).
        q = jnp.where(terminated & self.terminal_q.is_("zero"), 0.0, next_values[Q])
        forever = jnp.where(self.terminal_u.is_("absorbing"), bonus / (1.0 - self.discount_of_u), 0.0)
        u = jnp.where(terminated & ~self.terminal_u.is_("bootstrap"), forever, self.clipped_u(next_values[U]))
        return jnp.stack([reward + self.discount * q, bonus + self.discount_of_u * u], axis=-1)

    def q_discount(self, terminated: Bool[Array, "B"]) -> Float[Array, "B"]:
        """Factor of Q(s', a') in the TD target of Q."""
        continues = self.terminal_q.is_("bootstrap") | ~terminated
        return self.discount * continues.astype(self.discount.dtype)

    def u_terms(
        self, bonus: Float[Array, "B"], factor: Float[Array, "B"], terminated: Bool[Array, "B"]
    ) -> tuple[Float[Array, "B"], Float[Array, "B"]]:
        """Constant term of the TD target of U, and its factor of phi(s', a')'m_U."""
        is_absorbing = terminated & self.terminal_u.is_("absorbing")
        constant = jnp.where(is_absorbing, bonus / (1.0 - self.discount_of_u), bonus)
        ends = terminated & ~self.terminal_u.is_("bootstrap")
        return constant, jnp.where(ends, 0.0, self.discount_of_u * factor)
