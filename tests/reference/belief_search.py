"""PFT-DPW and POMCPOW as in Algorithms 1 to 3 of Sunberg and Kochenderfer (ICAPS 2018), recursive.

`draws` gives the random numbers and the simulated steps of an iteration, so that another program can use the
same. As in bojax: PFT ends branches with the observed termination; POMCPOW's branches keep reservoirs.
`POMCPOWWithLists` keeps all steps of a branch, as published. `JoinedPOMCPOW` has discrete observations.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(eq=False)
class Belief:
    """A belief node; `content` is a particle set, or what POMCPOW keeps of a branch."""

    content: Any
    reward: float = 0.0
    is_terminal: bool = False
    actions: list["Action"] = field(default_factory=list)

    @property
    def visits(self):
        return sum(action.visits for action in self.actions)


@dataclass(eq=False)
class Action:
    """An action node."""

    parameters: Any = None  # proposed at the first visit
    branches: list[Any] = field(default_factory=list)
    visits: int = 0
    total: float = 0.0
    rewards: list[float] = field(default_factory=list)
    returns: list[float] = field(default_factory=list)
    counts: list[int] | None = None  # how often the observation of each branch was drawn, where they repeat

    @property
    def mean(self):
        return self.total / self.visits


@dataclass
class Search:
    """What both planners share."""

    draws: Any  # random numbers, and the problem's steps
    exploration: float  # the factor c
    widening: Any  # k and alpha of the actions; None if all `num_actions` exist at once
    observation_widening: Any  # k and alpha of the branches
    depth: int  # actions to the horizon
    discount: float  # an action
    num_actions: int  # if they are finite
    max_branches: int  # most branches of an action

    def search(self, content, iterations):
        root = Belief(content)
        for i in range(iterations):
            self.draws.begin(i)
            self.simulate(root, self.draws.state(), 0, root)
        return root

    def simulate(self, b, state, level, root):
        if level == self.depth:
            return self.draws.leaf_value(*self.states_at(b, state), 0)
        a = self.action_prog_widen(b)
        if a.visits == 0:
            a.parameters = self.propose(b, a)
        action = self.draws.decode(a.parameters)
        child = self.old_child(a, state, action, level)
        if child is None:
            child, alive = self.new_branch(b, state, action, is_root=b is root)
            a.branches.append(child)
            total = reward = child.reward
            if not child.is_terminal:
                total += self.discount * self.draws.leaf_value(*alive, self.depth - 1 - level)
        else:
            state, reward, is_terminal = self.old_branch(child, state, action, level)
            total = reward
            if not is_terminal:
                total += self.discount * self.simulate(child, state, level + 1, root)
        a.visits += 1
        a.total += total
        a.rewards.append(reward)
        a.returns.append(total)
        return total

    def may_add_branch(self, a):
        k, alpha = self.observation_widening
        return len(a.branches) <= k * a.visits**alpha and len(a.branches) < self.max_branches

    def old_child(self, a, state, action, level):
        """The branch to follow; None to add one."""
        return None if self.may_add_branch(a) else a.branches[self.draws.branch(level, len(a.branches))]

    def action_prog_widen(self, b):
        if self.num_actions is not None:
            if not b.actions:
                b.actions = [Action() for _ in range(self.num_actions)]
        elif len(b.actions) <= self.widening[0] * b.visits ** self.widening[1]:
            b.actions.append(Action())
        return max(b.actions, key=lambda a: self.score(b, a))

    def score(self, b, a):
        if a.visits == 0:
            return self.score_unvisited(b)
        return a.mean + self.exploration * math.sqrt(math.log(b.visits) / a.visits)

    def propose(self, b, a):
        if self.num_actions is not None:
            return np.array([b.actions.index(a)])
        return self.draws.action()


class PFT(Search):
    """Belief nodes are pairs of states and whether each is alive."""

    def score_unvisited(self, b):
        return 0.0 if b.visits <= 1 else math.inf

    def new_branch(self, b, state, action, is_root):
        states, alive = b.content
        if not is_root:
            state = states[self.draws.particle(alive)]
        observation, ended = self.draws.observation(state, action)
        moved, rewards, terminated, likelihoods = self.draws.move(states, action, observation)
        weights = np.where(alive, likelihoods, 0.0)
        if weights.sum() == 0.0:
            weights = alive.astype(float)
        reward = weights @ rewards / weights.sum()
        left = alive & ~terminated
        weights = np.where(left, likelihoods, 0.0)
        if weights.sum() == 0.0:
            weights = left.astype(float)
        if weights.sum() == 0.0:
            return Belief((moved, left), reward, True), (moved, left)
        indices = self.resample(weights)
        after = moved[indices], left[indices]
        return Belief(after, reward, ended), after

    def resample(self, weights):
        """Low-variance resampling."""
        ends = np.cumsum(weights / weights.sum())
        points = (np.arange(len(weights)) + self.draws.resampling()) / len(weights)
        return np.searchsorted(ends, points, side="right")

    def states_at(self, b, state):
        return b.content

    def old_branch(self, child, state, action, level):
        return state, child.reward, child.is_terminal


class POMCPOW(Search):
    """Belief nodes are the observation, the sum of weights, and reservoirs of (state, reward, terminal)."""

    num_reservoirs = 4

    def score_unvisited(self, b):
        return math.inf

    def new_branch(self, b, state, action, is_root):
        next_state, reward, ended, observation, likelihood = self.new_step(state, action)
        content = observation, likelihood, [(next_state, reward, ended)] * self.num_reservoirs
        alive = next_state[None], np.array([not ended])
        return Belief(content, reward, ended), alive

    def new_step(self, state, action):
        return self.draws.new_step(state, action)

    def states_at(self, b, state):
        return state[None], np.array([True])

    def old_branch(self, child, state, action, level):
        observation, total, steps = child.content
        *step, likelihood = self.draws.next_step(level, state, action, observation)
        total += likelihood
        uniform, place = self.draws.places(level, self.num_reservoirs)
        steps = [
            tuple(step) if u * total < likelihood else old for u, old in zip(uniform, steps, strict=True)
        ]
        child.content = observation, total, steps
        return steps[place]


class JoinedPOMCPOW(POMCPOW):
    """With observations that repeat."""

    def old_child(self, a, state, action, level):
        if self.may_add_branch(a):
            self.drawn = self.draws.drawn(level, state, action)
            same = [i for i, each in enumerate(a.branches) if np.array_equal(each.content[0], self.drawn[3])]
            if not same:
                a.counts = [*(a.counts or []), 1]
                return None
            a.counts[same[0]] += 1
        return a.branches[self.draws.branch_by_count(level, np.array(a.counts, float))]

    def new_step(self, state, action):
        return self.drawn


class POMCPOWWithLists(POMCPOW):
    """As published: a branch keeps all simulated steps and their weights, and draws from them by weight."""

    def new_branch(self, b, state, action, is_root):
        next_state, reward, ended, observation, likelihood = self.new_step(state, action)
        content = observation, [likelihood], [(next_state, reward, ended)]
        return Belief(content, reward, ended), (next_state[None], np.array([not ended]))

    def old_branch(self, child, state, action, level):
        observation, weights, steps = child.content
        *step, likelihood = self.draws.next_step(level, state, action, observation)
        weights.append(likelihood)
        steps.append(tuple(step))
        return steps[self.draws.by_weight(weights)]
