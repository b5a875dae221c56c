"""GPS-ABT: a node's actions are points of a stencil tree (Seiler et al., ICRA 2015)."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.reference.mcts import TreeSearch

EDGE = 1.0 + 1e-9


class Stencil:
    """A centre and a step up and down in each dimension.

    Attributes:
        points: Places of the points: the centre, then up and down along each axis.
        nodes: For each point the node that its action leads to, None if it was not tried.
        finer: For each point the stencil that refines it, None if there is none.
    """

    def __init__(self, centre, radius):
        self.radius = radius
        self.points = [np.array(centre)]
        for axis in range(len(centre)):
            for sign in (1.0, -1.0):
                step = np.zeros(len(centre))
                step[axis] = sign * radius
                self.points.append(centre + step)
        self.nodes = [None] * len(self.points)
        self.finer = [None] * len(self.points)

    def is_inside(self, p):
        return np.abs(self.points[p]).max() <= EDGE

    def untried(self):
        return [p for p in range(len(self.points)) if self.is_inside(p) and self.nodes[p] is None]

    def tried(self):
        return [p for p in range(len(self.points)) if self.is_inside(p) and self.nodes[p] is not None]

    def best_point(self):
        """The point of highest mean return."""
        return max(self.tried(), key=lambda p: self.nodes[p].mean_return)

    def refined_at(self, p):
        """The stencil one level down.

        At the centre the radius halves. Another point becomes the centre of a stencil of the same radius,
        whose step back is the old centre; if that adds no new point, the radius halves there too.
        """
        if p != 0:
            moved = Stencil(self.points[p], self.radius)
            moved.nodes[0] = self.nodes[p]
            moved.nodes[_opposite(p)] = self.nodes[0]
            if moved.untried():
                return moved
        halved = Stencil(self.points[p], 0.5 * self.radius)
        halved.nodes[0] = self.nodes[p]
        return halved


def _opposite(p):
    """Points 1, 2 are up and down the first axis, 3, 4 the second, and so on."""
    return p + 1 if p % 2 == 1 else p - 1


@dataclass(kw_only=True)
class PatternSearch(TreeSearch):
    """Tree search over stencils, with the public toolkit's rules."""

    motions_path: Any  # the path of a parameter vector
    num_params: int  # dimension of the parameters
    order: Any  # for each iteration a random number for each point: untried points, highest first
    growth: float  # k; a node visited N times has fewer than ln N / ln k levels of refinement
    min_visits: int  # that every best point on the way needs before a refinement
    min_radius: float  # smallest radius that is refined
    initial_radius: float  # of a node's first stencil
    max_levels: int  # most stencils on one walk

    def walk(self, v):
        """Stencils from the first one of `v` down the best points, to untried points or to a leaf."""
        if not hasattr(v, "stencil"):
            v.stencil = Stencil(np.zeros(self.num_params), self.initial_radius)
        way = [v.stencil]
        while not way[-1].untried() and len(way) < self.max_levels:
            finer = way[-1].finer[way[-1].best_point()]
            if finer is None:
                break
            way.append(finer)
        return way

    def may_refine(self, v, way):
        return (
            len(way) < self.max_levels
            and all(s.nodes[s.best_point()].visits >= self.min_visits for s in way)
            and len(way) * math.log(self.growth) < math.log(max(v.visits, 1))
            and way[-1].radius > self.min_radius
        )

    def has_untried(self, v):
        way = self.walk(v)
        return bool(way[-1].untried()) or self.may_refine(v, way)

    def new_action(self, v, i):
        stencil = self.walk(v)[-1]
        if not stencil.untried():
            p = stencil.best_point()
            stencil.finer[p] = stencil.refined_at(p)
            stencil = stencil.finer[p]
        p = max(stencil.untried(), key=lambda p: self.order[i][p])
        self.new_point = stencil, p
        return stencil.points[p], self.motions_path(stencil.points[p])

    def learn(self, v, child):
        stencil, p = self.new_point
        stencil.nodes[p] = child

    def best_child(self, v):
        """The highest upper confidence bound of all points on the way."""
        log_n = math.log(v.visits)
        nodes = [stencil.nodes[p] for stencil in self.walk(v) for p in stencil.tried()]
        return max(nodes, key=lambda c: c.mean_return + self.exploration * math.sqrt(log_n / c.visits))

    def recommend(self, v0):
        """The toolkit's "robust" choice: the most visited of the best points on the way."""
        best = [stencil.nodes[stencil.best_point()] for stencil in self.walk(v0) if stencil.tried()]
        return max(best, key=lambda c: c.visits)
