"""Tabular Q-learning and value iteration in plain NumPy, one transition at a time."""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class QLearning:
    """Q, U and counts; `kind` says what is learned from a transition."""

    kind: str  # "exploration-values", "additive" or "epsilon-greedy"
    num_states: int
    num_actions: int
    discount: float
    learning_rate: float
    weight: float = 0.0  # kappa, xi or epsilon
    initial_q: float = 0.0
    initial_u: float = 0.0
    reward_kind: str = "first-visit"
    bootstrap: str = "greedy-q"
    terminal_u: str = "masked"
    q: np.ndarray = field(init=False)
    u: np.ndarray = field(init=False)
    counts: np.ndarray = field(init=False)

    def __post_init__(self):
        shape = self.num_states, self.num_actions
        self.q = np.full(shape, self.initial_q)
        self.u = np.full(shape, self.initial_u)
        self.counts = np.zeros(shape)

    def exploration_reward(self, s, a, s2):
        if self.reward_kind == "first-visit":
            return 0.0 if self.counts[s, a] == 0 else -1.0
        return sum(1.0 / np.sqrt(1.0 + n) for n in self.counts[s2]) / self.num_actions - 1.0

    def observe(self, s, a, r, s2, terminated, exploration=1.0):
        bonus = self.exploration_reward(s, a, s2)
        next_q, next_u = self.q[s2].max(), self.u[s2].max()
        if self.kind == "exploration-values" and self.bootstrap != "max":
            best = np.argmax(self.q[s2] + self.weight * exploration * self.u[s2])
            next_u = self.u[s2, best]
            if self.bootstrap == "policy":
                next_q = self.q[s2, best]
        if terminated:
            next_q = 0.0
            if self.terminal_u == "masked":
                next_u = 0.0
        if self.kind == "additive":
            r = r + self.weight * exploration * bonus
        self.q[s, a] += self.learning_rate * (r + self.discount * next_q - self.q[s, a])
        if self.kind == "exploration-values":
            self.u[s, a] += self.learning_rate * (bonus + self.discount * next_u - self.u[s, a])
        self.counts[s, a] += 1


def value_iteration(probability, next_state, reward, terminated, discount, tolerance=1e-12):
    """Q of the best policy, from `[S, A, K]` branches."""
    q = np.zeros(probability.shape[:2])
    while True:
        value = np.where(terminated, 0.0, q.max(axis=1)[next_state])
        new = (probability * (reward + discount * value)).sum(axis=2)
        if np.max(np.abs(new - q)) < tolerance:
            return new
        q = new


def hitting_time(probability, next_state, terminated, policy, start):
    """Mean steps to the end from `start`, by solving the linear equations of a policy `[S, A]`."""
    num_states = probability.shape[0]
    goes_on = np.zeros((num_states, num_states))
    for s in range(num_states):
        for a in range(probability.shape[1]):
            for k in range(probability.shape[2]):
                if not terminated[s, a, k]:
                    goes_on[s, next_state[s, a, k]] += policy[s, a] * probability[s, a, k]
    return np.linalg.solve(np.eye(num_states) - goes_on, np.ones(num_states))[start]
