"""Continuous belief tree search as in Algorithms 3 and 4: a node's new actions come from its own GP."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import rankdata

from tests.reference.gaussian_process import NodeGP
from tests.reference.mcts import TreeSearch


@dataclass(kw_only=True)
class ContinuousBeliefTreeSearch(TreeSearch):
    """Algorithm 4; actions are parameter vectors out of a set of candidates."""

    kernel: Any  # of the node GPs
    acquisition: Any  # the h of (4.2)
    noise_variance: float  # of the node GPs
    max_actions: int  # A_max
    convergence: float  # the delta of Section 4.4; 0 for no such stop
    scaling: str  # "standardise", "rank" or "none"
    candidates: np.ndarray  # their parameters
    paths: Any  # of the candidates
    num_initial: int  # first actions of a node that are random
    initial: Any  # the random candidate of each iteration

    def has_untried(self, v):
        return len(v.children) < self.max_actions and not self.has_converged(v)

    def has_converged(self, v):
        """||theta_{i-1} - theta_i|| < delta for any two actions in a row."""
        if self.convergence == 0.0:
            return False
        thetas = self.candidates[[child.action for child in v.children]]
        return bool(np.any(np.linalg.norm(np.diff(thetas, axis=0), axis=1) < self.convergence))

    def new_action(self, v, i):
        """Lines 3-4 of Algorithm 3."""
        if len(v.children) < self.num_initial:
            action = self.initial[i]
        else:
            action = self.maximise_acquisition(v)
        return action, self.paths[action]

    def maximise_acquisition(self, v):
        rewards = self.scale(np.array([child.reward for child in v.children]))
        mean, variance = self.gp(v).predict(rewards, self.candidates)
        best = rewards.max(initial=-np.inf)
        return np.argmax(self.acquisition(mean, np.sqrt(variance), best))

    def scale(self, rewards):
        if self.scaling == "none" or len(rewards) == 0:
            return rewards
        if self.scaling == "rank":
            return (2.0 * rankdata(rewards) - 1.0) / len(rewards) - 1.0
        mean, std = rewards.mean(), rewards.std()
        return (rewards - mean) / (std if std > 1e-6 * abs(mean) else 1.0)

    def learn(self, v, child):
        """Line 6 of Algorithm 3: rewards stay with the children, the GP gets the action."""
        self.gp(v).append(self.candidates[child.action])

    def gp(self, v):
        if not hasattr(v, "gp"):
            v.gp = NodeGP(self.kernel, self.noise_variance, self.max_actions, self.candidates.shape[1])
        return v.gp
