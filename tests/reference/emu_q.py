"""EMU-Q in plain NumPy, line by line: Algorithm 6 as corrected, and what the author's published code does.

Both take their features and the actions that they look at from outside, so that they can be given the same.
"""

from collections.abc import Callable

import numpy as np

Array = np.ndarray


class Algorithm6:
    """EMU-Q as the thesis has it, with a' = pi(s') in the targets and no value past an absorbing state.

    There, Q is 0, and U as if the state went on paying its exploration reward for ever.

    Attributes:
        phi: The features of states and actions, `phi(states [N, D], actions [N, A]) -> [N, M]`.
        candidates: Gives the actions of an argmax, `[J, A]`.
        samples: Gives the actions of the mean in the exploration reward, `[K, A]`.
    """

    def __init__(
        self,
        phi: Callable[[Array, Array], Array],
        num_features: int,
        candidates: Callable[[], Array],
        samples: Callable[[], Array],
        alpha: float = 0.1,
        beta: float = 1.0,
        gamma: float = 0.99,
        u_gamma: float | None = None,
        clips_u: bool = False,
        kappa: float = 1.0,
        max_sweeps: int = 30,
        tolerance: float = 0.1,
    ):
        self.phi, self.candidates, self.samples = phi, candidates, samples
        self.alpha, self.beta, self.gamma, self.kappa = alpha, beta, gamma, kappa * alpha
        self.u_gamma, self.clips_u = gamma if u_gamma is None else u_gamma, clips_u
        self.max_sweeps, self.tolerance = max_sweeps, tolerance
        self.s = np.eye(num_features) / alpha
        self.t_q, self.t_u = np.zeros(num_features), np.zeros(num_features)
        self.m_q, self.m_u = np.zeros(num_features), np.zeros(num_features)

    def q(self, phi: Array) -> Array:
        return phi @ self.m_q

    def u(self, phi: Array) -> Array:
        return phi @ self.m_u

    def next_u(self, phi: Array) -> Array:
        """U of next states in targets. Every r_e is between -1/alpha and 0, which bounds their sum."""
        u = self.u(phi)
        return np.clip(u, -1.0 / self.alpha / (1.0 - self.u_gamma), 0.0) if self.clips_u else u

    def pairs(self, states: Array, actions: Array) -> Array:
        """Features of every state with every action, state by state."""
        return self.phi(np.repeat(states, len(actions), axis=0), np.tile(actions, (len(states), 1)))

    def policy(self, states: Array, actions: Array | None = None) -> Array:
        actions = self.candidates() if actions is None else actions
        phi = self.pairs(states, actions)
        scores = (self.q(phi) + self.kappa * self.u(phi)).reshape(len(states), len(actions))
        return actions[np.argmax(scores, axis=1)]

    def variances(self, states: Array) -> Array:
        """phi'S phi of every state with every sampled action, `[N, K]`."""
        phi = self.pairs(states, self.samples())
        return np.sum((phi @ self.s) * phi, axis=1).reshape(len(states), -1)

    def exploration_reward(self, states: Array) -> Array:
        return self.variances(states).mean(axis=1) - 1.0 / self.alpha

    def step(self, s: Array, a: Array, r: float, s_next: Array, is_absorbing: bool) -> None:
        s, a, s_next = s[None], a[None], s_next[None]
        a_next = self.policy(s_next)
        r_e = self.exploration_reward(s_next)[0]
        phi, phi_next = self.phi(s, a)[0], self.phi(s_next, a_next)[0]
        y_q = r + self.gamma * (0.0 if is_absorbing else self.q(phi_next))
        forever = r_e / (1.0 - self.u_gamma)
        y_u = r_e + self.u_gamma * (forever if is_absorbing else self.next_u(phi_next))
        self.learn(phi, y_q, y_u)

    def learn(self, phi: Array, y_q: float, y_u: float) -> None:
        self.s = self.downdated(phi)
        self.t_q = self.t_q + self.beta * phi * y_q
        self.t_u = self.t_u + self.beta * phi * y_u
        self.m_q, self.m_u = self.s @ self.t_q, self.s @ self.t_u

    def downdated(self, phi: Array) -> Array:
        sphi = self.s @ phi
        return self.s - self.beta * np.outer(sphi, sphi) / (1.0 + self.beta * phi @ sphi)

    def end_episode(self, s: Array, a: Array, r: Array, s_next: Array, is_absorbing: Array) -> None:
        phi = self.phi(s, a)
        for _ in range(self.max_sweeps):
            phi_next = self.phi(s_next, self.policy(s_next))
            self.t_q = self.beta * phi.T @ (r + self.gamma * np.where(is_absorbing, 0.0, self.q(phi_next)))
            before, self.m_q = self.m_q, self.s @ self.t_q
            if np.linalg.norm(self.m_q - before) <= self.tolerance:
                break
        phi_next = self.phi(s_next, self.policy(s_next))
        r_e = self.exploration_reward(s_next)
        for _ in range(self.max_sweeps):
            u_next = np.where(is_absorbing, r_e / (1.0 - self.u_gamma), self.next_u(phi_next))
            self.t_u = self.beta * phi.T @ (r_e + self.u_gamma * u_next)
            before, self.m_u = self.m_u, self.s @ self.t_u
            if np.linalg.norm(self.m_u - before) <= self.tolerance:
                break


class DirectRefit(Algorithm6):
    """Algorithm 6 with the equations of each policy solved at the end of an episode, in place of sweeps.

    All policies of a refit maximise over the same candidates. They end with the first one that comes again,
    or when the weights stay the same, or change no less than with the policy before for the second time.
    """

    def end_episode(self, s: Array, a: Array, r: Array, s_next: Array, is_absorbing: Array) -> None:
        phi = self.phi(s, a)
        gain = self.beta * self.s @ phi.T

        def solution(phi_next: Array, constant: Array, gamma: float) -> Array:
            discount = np.where(is_absorbing, 0.0, gamma)
            return np.linalg.solve(
                np.eye(len(self.s)) - gain @ (discount[:, None] * phi_next), gain @ constant
            )

        actions, changes, seen = self.candidates(), [], []
        for _ in range(self.max_sweeps):
            a_next = self.policy(s_next, actions)
            if any(np.array_equal(a_next, before) for before in seen):
                break
            seen.append(a_next)
            before, self.m_q = self.m_q, solution(self.phi(s_next, a_next), r, self.gamma)
            changes.append(np.linalg.norm(self.m_q - before))
            growths = np.sum(np.diff(changes) >= 0.0)
            if changes[-1] <= self.tolerance or growths == 2:
                break
        self.policies, self.growths = len(changes), growths
        r_e = self.exploration_reward(s_next)
        forever = np.where(is_absorbing, r_e / (1.0 - self.u_gamma), r_e)
        phi_next = self.phi(s_next, self.policy(s_next, actions))
        self.m_u = solution(phi_next, forever, self.u_gamma)
        for _ in range(self.max_sweeps if self.clips_u else 0):
            u_next = np.where(is_absorbing, 0.0, self.next_u(phi_next))
            before, self.m_u = self.m_u, gain @ (forever + self.u_gamma * u_next)
            if np.linalg.norm(self.m_u - before) <= self.tolerance:
                break


class StoredRewards(Algorithm6):
    """Algorithm 6 without line 16: an episode ends with the exploration rewards of line 8."""

    def __init__(self, *args, **settings):
        super().__init__(*args, **settings)
        self.rewards = []

    def step(self, s: Array, a: Array, r: float, s_next: Array, is_absorbing: bool) -> None:
        self.rewards.append(super().exploration_reward(s_next[None])[0])
        super().step(s, a, r, s_next, is_absorbing)

    def exploration_reward(self, states: Array) -> Array:
        return super().exploration_reward(states) if len(states) == 1 else np.array(self.rewards)


class PublishedCode(Algorithm6):
    """What the published code does: SPEC of its quirks in one place.

    The variance holds the noise; U goes to 0 where nothing was seen; Q is updated before the exploration
    reward is computed, U with the trust of before; absorbing states bootstrap; the exploration rewards of an
    episode's end are averaged over the wrong axis. Its features have half the norm (given from outside).
    """

    def __init__(self, *args, lengthscale: float, **settings):
        super().__init__(*args, **settings)
        self.least = 1.0 / (lengthscale * (8.0 * self.beta + self.alpha))

    def u(self, phi: Array) -> Array:
        variance = np.sum((phi @ self.s) * phi, axis=-1)
        rho = np.maximum((variance - self.least) / (1.0 / self.alpha - self.least), 0.0)
        return (phi @ self.m_u) * (1.0 - rho)

    def variances(self, states: Array) -> Array:
        return super().variances(states) + 1.0 / self.beta

    def exploration_reward(self, states: Array) -> Array:
        variances = self.variances(states)
        mixed = variances.ravel().reshape(-1, len(states))  # meant as [K, N], but it is [N, K]
        return mixed.mean(axis=0) - 1.0 / self.alpha

    def step(self, s: Array, a: Array, r: float, s_next: Array, is_absorbing: bool) -> None:
        s, a, s_next = s[None], a[None], s_next[None]
        a_next = self.policy(s_next)
        phi, phi_next = self.phi(s, a)[0], self.phi(s_next, a_next)[0]
        y_q, u_next = r + self.gamma * self.q(phi_next), self.u(phi_next)
        before, self.s = self.s, self.downdated(phi)
        r_e = self.exploration_reward(s_next)[0]  # of one state, nothing is mixed
        self.s = before
        self.learn(phi, y_q, r_e + self.gamma * u_next)

    def end_episode(self, s: Array, a: Array, r: Array, s_next: Array, is_absorbing: Array) -> None:
        super().end_episode(s, a, r, s_next, np.zeros(len(r), dtype=bool))
