"""EMU-Q: exploration by minimising the uncertainty of Q values (thesis, Section 5.6, Algorithm 6)."""

from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key
from typing_extensions import override

from bojax.config.limits import ENTRIES
from bojax.envs.base import Action, Observation
from bojax.envs.spaces import Box, Space
from bojax.learning.actions import even_actions, refined_action
from bojax.learning.base import Episode, ExplorationState, Learner, Transition
from bojax.learning.emu_q_model import EMUQState, Q, U
from bojax.learning.memory import Memory, StoredRewards, emptied
from bojax.learning.refit import Refit
from bojax.models.bayesian_linear_regression import BayesianLinearRegression
from bojax.numerics.lanes import lane_by_lane_on_cpu


class EMUQ(Refit, Learner):
    """EMU-Q with the corrections of the printed algorithm, or with the deviations of the published code.

    The exploration reward of a transition (5.12) is the mean variance phi'S phi of Q at the next state, less
    its maximum V_max = 1/alpha, so that it is never above 0. The policy is argmax Q + kappa U, with kappa in
    units of 1/V_max (p. 136 of the PDF: kappa = 1/V_max). In lines 10-11 of Algorithm 6, a' is pi(s'), which
    the printed algorithm leaves out. With (5.22) in gain form, the vectors t of lines 10-12 are not needed.

    Settings: `bojax.learning.settings.EMUQ` and `EMUQPublished`.
    """

    # The covariances of more lanes do not fit into a core's cache.
    lanes_on_cpu: ClassVar[int] = 8

    kappa: Float[Array, ""]
    num_actions: int = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)
    refine_steps: int = eqx.field(static=True)
    refit_rewards: Literal["recomputed", "stored"] = eqx.field(static=True)
    block: int = eqx.field(static=True)

    # Algorithm 6.

    @override
    def check_spaces(self, observation_space: Space, action_space: Space) -> None:
        self.features.check_spaces(observation_space, action_space)
        ENTRIES.check(self.features.count(observation_space, action_space) ** 2, "learner.features")

    @override
    def fitted(self, observation_space: Space, action_space: Space) -> "EMUQ":
        features = self.features.fitted(observation_space, action_space, self.prior_precision.dtype)
        return eqx.tree_at(lambda learner: learner.features, self, features)

    @override
    def init(
        self, key: Key[Array, ""], observation_space: Space, action_space: Space, capacity: int
    ) -> EMUQState:
        """Line 3: S = I/alpha and m_Q = m_U = 0."""
        key_features, key_candidates, key_samples = jax.random.split(key, 3)
        dtype = self.prior_precision.dtype
        features = self.features.draw(key_features, observation_space, action_space, dtype)
        posterior = BayesianLinearRegression.prior(
            features.num_features, self.prior_precision, self.noise_precision, num_targets=2, block=self.block
        )
        candidates = even_actions(key_candidates, self.num_actions, action_space)
        samples = even_actions(key_samples, self.num_samples, action_space)
        # At least one row: an empty array cannot be spread over devices.
        capacity = max(1, 0 if self.refit == "none" else capacity)
        memory = Memory.empty(capacity, observation_space.example, candidates[0], dtype)
        stored = StoredRewards.empty(capacity, dtype) if self.refit_rewards == "stored" else None
        return EMUQState(features, posterior, memory, candidates, samples, stored)

    @override
    def act(
        self, key: Key[Array, ""], state: EMUQState, observation: Observation, exploration: ExplorationState
    ) -> tuple[Action, Float[Array, ""]]:
        """Line 6: argmax Q + kappa U over the candidates (5.10)."""
        # A test has scale 0: then kappa is 0, and the policy is argmax Q.
        key_draw, key_ties = jax.random.split(key)
        kappa = exploration.scale * self.exploration_weight
        candidates, _ = self.actions(key_draw, state)
        ties = self.ties(state)
        action, values = self.greedy_action(key_ties, state, observation, candidates, kappa, ties)
        expected = values[Q]
        space = state.features.actions
        if self.refine_steps and isinstance(space, Box):

            def scores(actions: Action) -> Float[Array, "J"]:
                values = self.q_and_u(state.posterior, state.phi(observation, actions))
                return values[:, Q] + kappa * values[:, U]

            # The spacing that as many candidates would have on a regular grid.
            spacing = (space.high - space.low) / len(candidates) ** (1.0 / space.num_dims)
            action = refined_action(scores, action, space, spacing, self.refine_steps)
            expected = self.q_and_u(state.posterior, state.phi(observation, action[None]))[0, Q]
        return action, expected

    @override
    def observe(
        self,
        key: Key[Array, ""],
        state: EMUQState,
        transition: Transition,
        exploration: ExplorationState,
        step_in_block: Int[Array, ""],
    ) -> EMUQState:
        """Lines 8 to 12."""
        features, posterior = state.features, state.posterior
        candidates, samples = self.actions(key, state)
        kappa = exploration.scale * self.exploration_weight
        # A weight of 0 in place of a branch: the posterior of a lane that does not learn stays the same.
        weight = exploration.is_learning.astype(kappa.dtype)

        # Line 8, the exploration reward (5.12). One product with the covariance serves line 8, whose
        # variances are at s', and line 9, whose gain is at (s, a).
        phi = features(transition.observation, transition.action)
        phi_samples = jnp.concatenate([phi[None], state.phi(transition.next_observation, samples)])
        variances, product = posterior.variances_and_product(phi_samples)
        bonus = self.exploration_reward(
            jnp.mean(self.sample_variances(posterior, phi_samples, variances, product, weight))
        )

        # The TD targets of lines 10 and 11, with a' = pi(s').
        _, values = self.greedy_action(key, state, transition.next_observation, candidates, kappa, "first")
        target = self.td_target(transition.reward, bonus, values, transition.terminated)

        # Lines 9 to 12, the covariance and both means, in gain form: with k the gain of (5.22), m = S t
        # becomes m += k (target - phi'm), so that neither t nor a product with the new S is needed.
        posterior = posterior.update(
            phi, target, sample_weight=weight, product=product, step_in_block=step_in_block
        )
        state = eqx.tree_at(lambda s: s.posterior, state, posterior)
        if state.stored is None:
            return state
        return eqx.tree_at(lambda s: s.stored, state, state.stored.add(bonus, exploration.is_learning))

    @override
    def end_episode(
        self, key: Key[Array, ""], state: EMUQState, episode: Episode, exploration: ExplorationState
    ) -> EMUQState:
        """Lines 14 to 17; the covariance does not change."""
        if self.refit == "none":
            return state
        state = eqx.tree_at(lambda s: s.memory, state, state.memory.add(episode, exploration.is_learning))
        # A CPU refits one lane after the other: their numbers of sweeps and of transitions differ.
        kappa = exploration.scale * self.exploration_weight
        mean = lane_by_lane_on_cpu(Refit.refitted, self, key, state, kappa, exploration.is_learning)
        return eqx.tree_at(lambda s: s.posterior.mean, state, mean)

    # The other methods of a learner.

    @property
    @override
    def lanes_on_gpu(self) -> int:
        # With 500 features, a refit with variances took 91 MB a run, and one without 30 MB.
        return 200 if self.optimistic_u else 800

    @property
    @override
    def exploration_weight(self) -> Float[Array, ""]:
        """`kappa` / V_max."""
        return self.kappa * self.prior_precision

    @override
    def flush(self, state: EMUQState) -> EMUQState:
        return eqx.tree_at(lambda s: s.posterior, state, state.posterior.flush())

    @override
    def policy_state(self, state: EMUQState) -> EMUQState:
        where = lambda s: (s.memory, s.stored)  # noqa: E731
        return eqx.tree_at(
            where, state, (emptied(state.memory), emptied(state.stored)), is_leaf=lambda leaf: leaf is None
        )

    @override
    def values(
        self, state: EMUQState, observation: Observation, action: Action
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        values = self.q_and_u(state.posterior, state.features(observation, action)[None])[0]
        return values[Q], values[U]
