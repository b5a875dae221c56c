"""Monte Carlo tree search as in Algorithm 2, with the corrections that bojax makes.

Corrected: every action gets its own reward plus all that follows; depth counts actions; the plan is the
action of the highest mean return; the root's visits count.
"""

import math
from dataclasses import dataclass, field
from typing import Any


@dataclass(eq=False)
class Node:
    """A belief, and the action that led to it from the parent's belief."""

    belief: Any
    parent: "Node | None" = None
    action: Any = None
    reward: float = 0.0
    is_terminal: bool = False
    index: int = 0  # number of the iteration that made the node, from 1
    children: list["Node"] = field(default_factory=list)
    visits: int = 0
    total_return: float = 0.0
    rollouts: list[float] = field(default_factory=list)  # discounted rewards of those that started here

    def __post_init__(self):
        self.depth = 0 if self.parent is None else self.parent.depth + 1

    @property
    def mean_return(self):
        return self.total_return / self.visits


@dataclass(kw_only=True)
class TreeSearch:
    """What Algorithms 2 and 4 share; a planner says how a node chooses its actions."""

    problem: Any  # `problem.drive(belief, path, draws)` gives (belief, reward, is_terminal)
    iterations: int  # simulations a plan
    depth: int  # actions to the horizon
    discount: float  # an action
    exploration: float  # kappa_MC
    rollout_paths: Any  # for each iteration the paths of its rollout, one for each action but the first
    draws: Any  # for each iteration what the problem draws for its actions, the new one first

    def search(self, belief):
        """The tree, by its root."""
        v0 = Node(belief)
        for i in range(self.iterations):
            vl = self.tree_policy(v0, i)
            r = self.roll_out(vl, i)
            self.back_up(vl, r)
        return v0

    def tree_policy(self, v, i):
        while v.depth < self.depth and not v.is_terminal:
            if self.has_untried(v):
                return self.expand(v, i)
            v = self.best_child(v)
        return v

    def expand(self, v, i):
        action, path = self.new_action(v, i)
        belief, reward, is_terminal = self.problem.drive(v.belief, path, self.draws[i][0])
        child = Node(belief, v, action, reward, is_terminal, index=i + 1)
        v.children.append(child)
        self.learn(v, child)
        return child

    def roll_out(self, v, i):
        """Discounted reward of random actions from `v` to the horizon, or to the end of the episode."""
        belief, is_terminal = v.belief, v.is_terminal
        r, weight = 0.0, 1.0
        paths = self.rollout_paths[i][: self.depth - v.depth]
        for path, draws in zip(paths, self.draws[i][1:], strict=False):
            if is_terminal:
                break
            belief, reward, is_terminal = self.problem.drive(belief, path, draws)
            r += weight * reward
            weight *= self.discount
        v.rollouts.append(r)
        return r

    def back_up(self, v, r):
        while v is not None:
            if v.parent is not None:
                r = v.reward + self.discount * r
            v.visits += 1
            v.total_return += r
            v = v.parent

    def best_child(self, vp):
        log_np = math.log(vp.visits)
        return max(
            vp.children, key=lambda vi: vi.mean_return + self.exploration * math.sqrt(log_np / vi.visits)
        )

    def recommend(self, v0):
        return max(v0.children, key=lambda v: v.mean_return)

    def has_untried(self, v):
        raise NotImplementedError

    def new_action(self, v, i):
        """An action of `v` that was not tried yet, and its path."""
        raise NotImplementedError

    def learn(self, v, child):
        """What else a node remembers of a new action."""


@dataclass(kw_only=True)
class DiscreteTreeSearch(TreeSearch):
    """Algorithm 2 over a finite set of paths; the order of untried actions is drawn beforehand."""

    paths: Any
    order: Any

    def has_untried(self, v):
        return len(v.children) < len(self.paths)

    def new_action(self, v, i):
        tried = {child.action for child in v.children}
        untried = [action for action in range(len(self.paths)) if action not in tried]
        action = max(untried, key=lambda a: self.order[i][a])
        return action, self.paths[action]

    def learn(self, v, child):
        # Of equally good children the one of the first action is best.
        v.children.sort(key=lambda vi: vi.action)
