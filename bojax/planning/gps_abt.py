"""GPS-ABT: nodes choose actions by generalised pattern search (Seiler, Kurniawati, Singh, ICRA 2015)."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key
from typing_extensions import override

from bojax.motions.base import ContinuousMotions, Path
from bojax.numerics.lanes import write_row
from bojax.numerics.loops import short_loop
from bojax.planning.search import PlanDraws, Proposal, TreeSearch
from bojax.planning.tree import ROOT, UNVISITED, Index, Tree, upper_bound
from bojax.problems.base import Objective

CENTRE = 0  # index of the centre among the points of a stencil


class Stencils(eqx.Module):
    """The stencil trees of all nodes: G stencils of P = 2D + 1 points, a centre and two steps per dimension.

    Stencil v < N is the initial one of node v; stencil N + c was added together with node c. Points are
    actions. Their positions follow from centre and radius, and `member` holds those that have been simulated.
    """

    paths: Float[Array, "C S 3"]  # random paths for rollouts
    params: Float[Array, "N D"]  # parameters of the action that leads to each node
    centre: Float[Array, "G D"]  # centres in the box [-1, 1]^D
    radius: Float[Array, "G"]  # step lengths
    # Nodes that the points lead to; `UNVISITED` for points that have not been simulated
    member: Int[Array, "G P"]
    finer: Int[Array, "G P"]  # stencils that refine the points; `UNVISITED` for points without one

    def points(self, stencil: Int[Array, ""]) -> Float[Array, "P D"]:
        """Positions of the points of a stencil."""
        return _points(self.centre[stencil], self.radius[stencil])


class Walk(eqx.Module):
    """Result of the descent through a node's stencil tree along the points of highest mean return."""

    stencil: Int[Array, ""]  # the last stencil
    point: Int[Array, ""]  # its point of highest mean return
    has_unvisited: Bool[Array, ""]  # whether the last stencil has points that have not been simulated
    # Whether all its points have been simulated, and its best point may be refined
    may_refine: Bool[Array, ""]
    best_ucb: Int[Array, ""]  # child with the highest upper confidence bound among all points on the way
    most_visited: Int[Array, ""]  # most visited child among the best points on the way


class _Descent(eqx.Module):
    """The state of a descent through a node's stencil tree."""

    walk: Walk  # the result so far
    is_walking: Bool[Array, ""]  # whether the descent has not ended
    best_bound: Float[Array, ""]  # highest upper confidence bound
    most_visits: Float[Array, ""]  # number of visits of `Walk.most_visited`
    fewest_visits: Float[Array, ""]  # smallest number of visits of a best point


class StencilUpdate(eqx.Module):
    """Change of the stencils by a new action."""

    # The descent: the action belongs to its last stencil, unless it refines the best point of that
    walk: Walk
    params: Float[Array, "D"]  # parameters of the action
    point: Int[Array, ""]  # index of the action in the last stencil, or in the finer stencil
    centre: Float[Array, "D"]  # centre of the finer stencil
    radius: Float[Array, ""]  # radius of the finer stencil
    member: Int[Array, "P"]  # members of the finer stencil that have been simulated before


class PatternSearch(TreeSearch[ContinuousMotions]):
    """The pattern search of the public ABT toolkit, on the belief tree that all planners here share.

    At a node, unvisited points of a stencil are tried first, in random order. Otherwise the search descends
    to the point of highest mean return and into the stencil that refines it. A point without such a stencil
    is refined if every best point on the way has been visited `min_visits` times, the number of levels is
    below ln N / ln(growth) for a node visited N times, and the radius exceeds `min_radius`. If it is not
    refined, the action is the one with the highest upper confidence bound on the way, with a bonus of
    `exploration` sqrt(ln N / n). Refining the centre halves the radius; refining another point moves the
    centre there. Points outside the box are dropped; if a moved stencil has no new point inside the box, the
    radius is halved instead. The plan is the most visited of the best points on the descent from the root.

    Deviation: the toolkit simulates histories of particles; here a node holds a belief.

    Settings: `bojax.planning.settings.GpsAbt`.
    """

    motions: ContinuousMotions
    exploration: Float[Array, ""]
    growth: Float[Array, ""]
    min_visits: Float[Array, ""]
    min_radius: Float[Array, ""]
    initial_radius: Float[Array, ""]
    max_levels: int = eqx.field(static=True)
    num_rollout_paths: int = eqx.field(static=True)
    heuristic: Literal["rollout", "zero"] = eqx.field(static=True)
    objective: Objective = None

    @property
    @override
    def num_actions(self) -> int:
        """Number of actions that the tree stores for a node; the search itself reads the stencils."""
        return self.max_levels * (2 * self.motions.num_params + 1)

    @override
    def begin(self, key: Key[Array, ""], dtype) -> tuple[Stencils, PlanDraws]:
        key_paths, key_rollout, key_order = jax.random.split(key, 3)
        num_nodes, num_params = self.iterations + 1, self.motions.num_params
        num_points = 2 * num_params + 1
        unvisited = jnp.full((2 * num_nodes, num_points), UNVISITED, jnp.int32)
        memory = Stencils(
            paths=jax.vmap(self.motions.sample)(jax.random.split(key_paths, self.num_rollout_paths)),
            params=jnp.zeros((num_nodes, num_params), dtype),
            centre=jnp.zeros((2 * num_nodes, num_params), dtype),
            radius=jnp.broadcast_to(self.initial_radius, (2 * num_nodes,)),
            member=unvisited,
            finer=unvisited,
        )
        shape = (self.iterations, self.depth - 1)
        draws = PlanDraws(
            rollout=jax.random.randint(key_rollout, shape, 0, self.num_rollout_paths),
            untried=jax.random.uniform(key_order, (self.iterations, num_points), dtype),
        )
        return memory, draws

    @override
    def rollout(self, memory: Stencils, draws: PlanDraws) -> Float[Array, "H S 3"]:
        if self.heuristic == "zero":
            return memory.paths[:0]
        return super().rollout(memory, draws)

    @override
    def view(self, tree: Tree, memory: Stencils, node: Index) -> Walk:
        return self._walk(tree, memory, node)

    @override
    def select(self, view: Walk) -> Index:
        return jnp.where(view.has_unvisited | view.may_refine, UNVISITED, view.best_ucb)

    @override
    def propose(self, tree: Tree, memory: Stencils, node: Index, view: Walk, draws: PlanDraws) -> Proposal:
        # Either a point of the last stencil, or one of the finer stencil around its best point. Both are
        # computed and one is selected, since lanes differ.
        centre, radius, member = self._finer(memory, view.stencil, view.point)
        centre = jnp.where(view.may_refine, centre, memory.centre[view.stencil])
        radius = jnp.where(view.may_refine, radius, memory.radius[view.stencil])
        member = jnp.where(view.may_refine, member, memory.member[view.stencil])
        points = _points(centre, radius)
        is_new = _is_inside(points) & (member == UNVISITED)
        # A random new point: priorities are in [0, 1), and -1 loses against all of them.
        point = jnp.argmax(jnp.where(is_new, draws.untried, -1.0)).astype(jnp.int32)
        update = StencilUpdate(
            walk=view, params=points[point], point=point, centre=centre, radius=radius, member=member
        )
        return Proposal(path=self.motions.path(points[point]), index=tree.num_children(node), update=update)

    @override
    def learn(self, memory: Stencils, child: Index, proposal: Proposal, is_new: Bool[Array, ""]) -> Stencils:
        # Stencil N + child is written in every iteration, at an index that all lanes share, and is linked
        # from its parent only if it refines a point. Links that do not apply have an index past the end.
        update: StencilUpdate = proposal.update
        walk, added = update.walk, memory.params.shape[0] + child
        nowhere = memory.radius.shape[0]
        into_old = jnp.where(is_new & ~walk.may_refine, walk.stencil, nowhere)
        parent = jnp.where(is_new & walk.may_refine, walk.stencil, nowhere)
        return Stencils(
            paths=memory.paths,
            params=write_row(memory.params, child, update.params),
            centre=write_row(memory.centre, added, update.centre),
            radius=write_row(memory.radius, added, update.radius),
            member=write_row(memory.member, added, update.member.at[update.point].set(child))
            .at[into_old, update.point]
            .set(child, mode="drop"),
            finer=memory.finer.at[parent, walk.point].set(added, mode="drop"),
        )

    @override
    def recommend(self, tree: Tree, memory: Stencils) -> Index:
        """The most visited child, which the toolkit calls robust."""
        return self._walk(tree, memory, jnp.asarray(ROOT, jnp.int32)).most_visited

    @override
    def path_of(self, memory: Stencils, child: Index) -> Path:
        return self.motions.path(memory.params[child])

    @eqx.filter_jit  # traced and lowered once for the views of the root, of other nodes and for the plan
    def _walk(self, tree: Tree, memory: Stencils, node: Index) -> Walk:
        # A loop of `max_levels` steps, in which a descent that has ended keeps its state under masks: lanes
        # end at different levels. One pass finds all that `select`, `propose` and `recommend` need.
        dtype = tree.outcome.dtype
        visits_of_node = jnp.maximum(tree.totals[node][0], 1.0)

        def descend(level, descent: _Descent) -> _Descent:
            walk, is_walking = descent.walk, descent.is_walking
            stencil = walk.stencil
            is_inside = _is_inside(memory.points(stencil))
            # Points outside the box are never simulated: their mean return is minus infinity.
            member = jnp.where(is_inside, memory.member[stencil], UNVISITED)
            totals = tree.totals_of(member)
            visits, mean = totals[:, 0], tree.mean_return(member)
            # The descent ends at a stencil with unvisited points.
            has_unvisited = is_walking & jnp.any(is_inside & (member == UNVISITED))

            # The best action on the way by upper confidence bound, if this node neither adds nor refines one;
            # and the most visited of the best points, which is the plan at the root.
            bound = upper_bound(visits, totals[:, 1], visits_of_node, self.exploration)
            highest = jnp.argmax(bound)
            is_higher = is_walking & (bound[highest] > descent.best_bound)
            best = jnp.argmax(mean).astype(jnp.int32)
            is_most = is_walking & (member[best] != UNVISITED) & (visits[best] > descent.most_visits)
            fewest_visits = jnp.where(
                is_walking, jnp.minimum(descent.fewest_visits, visits[best]), descent.fewest_visits
            )

            # Follow the best point into the stencil that refines it. Where there is none, refine the point if
            # all conditions of the toolkit hold: here, levels < ln N / ln k is written without a division.
            finer = memory.finer[stencil, best]
            descends = is_walking & ~has_unvisited & (finer != UNVISITED)
            levels = jnp.asarray(level + 1, dtype)
            refines = (
                (is_walking & ~has_unvisited & ~descends)
                & (fewest_visits >= self.min_visits)
                & (levels * jnp.log(self.growth) < jnp.log(visits_of_node))
                & (memory.radius[stencil] > self.min_radius)
                & (levels < self.max_levels)
            )
            return _Descent(
                walk=Walk(
                    stencil=jnp.where(descends, finer, stencil),
                    point=jnp.where(is_walking, best, walk.point),
                    has_unvisited=walk.has_unvisited | has_unvisited,
                    may_refine=walk.may_refine | refines,
                    best_ucb=jnp.where(is_higher, member[highest], walk.best_ucb),
                    most_visited=jnp.where(is_most, member[best], walk.most_visited),
                ),
                is_walking=descends,
                best_bound=jnp.where(is_higher, bound[highest], descent.best_bound),
                most_visits=jnp.where(is_most, visits[best], descent.most_visits),
                fewest_visits=fewest_visits,
            )

        centre, no_child = jnp.asarray(CENTRE, jnp.int32), jnp.asarray(UNVISITED, jnp.int32)
        no = jnp.asarray(False)
        start = _Descent(
            walk=Walk(node, centre, no, no, no_child, no_child),
            is_walking=jnp.asarray(True),
            best_bound=jnp.asarray(-jnp.inf, dtype),
            most_visits=jnp.asarray(-1.0, dtype),
            fewest_visits=jnp.asarray(jnp.inf, dtype),
        )
        return short_loop(self.max_levels, descend, start).walk

    def _finer(
        self, memory: Stencils, stencil: Int[Array, ""], point: Int[Array, ""]
    ) -> tuple[Float[Array, "D"], Float[Array, ""], Int[Array, "P"]]:
        """Centre, radius and previously simulated members of the stencil that refines a point."""
        radius, member = memory.radius[stencil], memory.member[stencil]
        centre = memory.points(stencil)[point]
        index = jnp.arange(member.shape[0], dtype=jnp.int32)
        # Points 1 and 2 step up and down the first dimension, 3 and 4 the second: the opposite one returns.
        back = jnp.where(point % 2 == 1, point + 1, point - 1)
        known = jnp.where(index == CENTRE, member[point], UNVISITED)
        moved = jnp.where(index == back, member[CENTRE], known)
        # A moved stencil keeps its radius and shares two points with the old one: its own centre, and the old
        # centre opposite to the step. One without a new point inside the box would be useless.
        has_new = jnp.any(_is_inside(_points(centre, radius)) & (moved == UNVISITED))
        is_move = (point != CENTRE) & has_new
        return centre, jnp.where(is_move, radius, 0.5 * radius), jnp.where(is_move, moved, known)


def _points(centre: Float[Array, "D"], radius: Float[Array, ""]) -> Float[Array, "P D"]:
    eye = jnp.eye(centre.shape[0], dtype=centre.dtype)
    steps = jnp.stack([eye, -eye], axis=1).reshape(-1, centre.shape[0])
    return centre[None, :] + radius * jnp.concatenate([jnp.zeros_like(steps[:1]), steps])


def _is_inside(points: Float[Array, "P D"]) -> Bool[Array, "P"]:
    return jnp.max(jnp.abs(points), axis=-1) <= 1.0 + 1e-9
