"""Tree search over beliefs with double progressive widening: what PFT-DPW, POMCPOW and path-dpw share.

Sunberg and Kochenderfer, Online algorithms for POMDPs with continuous state, action, and observation spaces
(ICAPS 2018), Algorithms 1 to 3, without recursion: descend, expand, back up.
"""

import abc
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, Num

from bojax.numerics.choices import Choice, one_of
from bojax.numerics.lanes import any_lane, in_own_kernel, largest_in_lanes, write_row
from bojax.numerics.simulation_keys import random_index, simulation_key, takes_simulation_keys
from bojax.planning.proposals import Proposal
from bojax.planning.tree import ROOT, UNVISITED, Belief, Growth, Index, Tree, row, upper_bound
from bojax.planning.widening import Widening
from bojax.problems.actions import Discrete
from bojax.problems.state_model import Action, State, StateModel

RECOMMENDATIONS = "value", "visits"
"""Rules by which a search recommends an action: the highest value, or the most visits."""

Model = Any
"""What is searched: a state problem, or any module with its `actions` and `discount`."""

Leaf = Any
"""What the value of a belief is estimated from: a tree of arrays."""


Draw = Callable[
    [
        Key[Array, ""],
        Tree,
        State,
        Action,
        Int[Array, "B"],
        Bool[Array, ""],
    ],
    tuple[Belief, Bool[Array, ""], Float[Array, "B"]],
]
"""Draws the observation that `expand` draws with the same key.

The arguments are this key, the tree, the state, the action, the belief nodes of its branches, padded with
`UNVISITED`, and whether to count the draw. Returned are the beliefs of the tree, with the draw counted;
whether a branch has this observation; and how often the observation of each branch was drawn.
"""


class Expansion(eqx.Module):
    """A new branch."""

    belief: Belief  # what the tree stores for its belief node
    reward: Float[Array, ""]  # reward of the action
    is_terminal: Bool[Array, ""]  # whether the episode ends with it
    leaf: Leaf  # what the value of its belief is estimated from


class BeliefTreeSearch(eqx.Module):
    """The search of a tree of beliefs; a final class defines beliefs and how they are simulated.

    Every iteration descends from the root, at each belief node to the action that maximises
    Q + c sqrt(ln N / n), and on to a draw among the branches of that action, until progressive widening adds
    an action or a branch. Branches are drawn uniformly, or, where equal observations share a branch, in
    proportion to how often they were drawn. Random numbers are functions of the key, the
    iteration and the level. Loops have as many turns as the deepest lane of a batch needs: batch with
    `vmap(axis_name=LANES)`.
    """

    gains_from_graphs: ClassVar[bool] = True
    """Makes the engine run the loops of searches as CUDA graphs on a GPU, where launches are their limit."""

    exploration: Float[Array, ""]  # the factor c
    # Rule by which actions are added; of a discrete space all actions exist at once
    action_widening: Widening
    observation_widening: Widening  # rule by which branches are added
    proposal: Proposal  # how a new action is chosen
    # Whether the plan is the action with the highest "value" or with the most "visits"
    recommendation: Choice = eqx.field(converter=one_of(*RECOMMENDATIONS))
    iterations: int = eqx.field(static=True)  # simulations a plan
    depth: int = eqx.field(static=True)  # actions to the horizon
    # Capacity of a belief node; ignored for a discrete space. Widening stops there
    max_actions: int = eqx.field(static=True)
    # Capacity of an action node; with 1, a tree plans on one foreseen observation
    max_branches: int = eqx.field(static=True)

    @abc.abstractmethod
    def root(self, key: Key[Array, ""], problem: Model, belief: Belief) -> Belief:
        """What the tree stores for the root."""

    @abc.abstractmethod
    def states(self, key: Key[Array, ""], belief: Belief) -> Float[Array, "N D"]:
        """The state that each iteration starts with; empty if only beliefs are simulated."""

    def first(self, key: Key[Array, ""], problem: Model, belief: Belief) -> Num[Array, "P"] | None:
        """Parameters of the first action of the root; None to propose it as the others."""
        return None

    def score_unvisited(self, visits: Float[Array, ""]) -> Float[Array, ""]:
        """Score of an action without a visit, at a node with `visits`; infinity by default."""
        return jnp.asarray(jnp.inf, visits.dtype)

    def draw_of(self, problem: Model) -> Draw | None:
        """How observations are drawn if equal ones share a branch; None if every observation has its own."""
        return None

    def follow(
        self,
        key: Key[Array, ""],
        problem: Model,
        tree: Tree,
        state: State,
        action: Action,
        branch: Index,
        is_followed: Bool[Array, ""],
    ) -> tuple[Belief, State, Float[Array, ""], Bool[Array, ""]]:
        """Pass along an existing branch, to the belief node `branch`, with the state of the simulation.

        Returns the beliefs of the tree, unchanged unless `is_followed`, the next state, the reward, and
        whether the simulation has ended. By default, these are the reward and the end of the simulation that
        added the branch, and nothing else changes.
        """
        reward, is_terminal = row(tree.outcome, branch)
        return tree.beliefs, state, reward, is_terminal > 0.0

    @abc.abstractmethod
    def expand(
        self, key: Key[Array, ""], problem: Model, tree: Tree, state: State, node: Index, action: Action
    ) -> Expansion:
        """A new branch of an action at the belief node `node`."""

    @abc.abstractmethod
    def leaf_at(self, tree: Tree, state: State, node: Index) -> Leaf:
        """What a value is estimated from at `node`, as in `Expansion`, where the horizon is reached."""

    @abc.abstractmethod
    def value_of(
        self, key: Key[Array, ""], problem: Model, leaf: Leaf, remaining: Int[Array, ""]
    ) -> Float[Array, ""]:
        """The value of a belief from which `remaining` actions are left; 0 of them at the horizon."""

    @property
    def by_value(self) -> bool | Array:
        """Whether to recommend the action with the highest value, not the one with the most visits."""
        return self.recommendation.is_("value")

    def search(self, key: Key[Array, ""], problem: Model, belief: Belief) -> Tree:
        """The tree after all iterations."""
        key = simulation_key(key) if takes_simulation_keys(partial(_drawn, problem)) else key
        key_root, key_states, key_first, key_search = jax.random.split(key, 4)
        space = problem.actions
        num_actions = space.count if isinstance(space, Discrete) else self.max_actions
        example = jax.eval_shape(space.sample, key_first)
        first = self.first(key_first, problem, belief)
        root = self.root(key_root, problem, belief)
        tree = Tree.rooted(
            root,
            self.iterations,
            num_actions,
            jax.tree.leaves(root)[0].dtype,
            num_branches=self.max_branches,
            parameters=jnp.zeros(example.shape, example.dtype),
            num_totals=2 if self.proposal.target is None else 4,
        )
        states = self.states(key_states, belief)
        for_actions = self.action_widening.thresholds(num_actions)
        if isinstance(space, Discrete):
            for_actions = jnp.zeros_like(for_actions)
        rules = _Rules(for_actions, self.observation_widening.thresholds(self.max_branches))

        def iterate(i: Int[Array, ""], tree: Tree) -> Tree:
            return self._iterate(problem, rules, first, tree, jax.random.fold_in(key_search, i), states[i], i)

        return jax.lax.fori_loop(0, self.iterations, iterate, tree)

    def _iterate(
        self,
        problem: Model,
        rules: "_Rules",
        first: Num[Array, "P"] | None,
        tree: Tree,
        key: Key[Array, ""],
        state: State,
        i: Int[Array, ""],
    ) -> Tree:
        key_descent, key_proposal, key_expansion, key_leaf = jax.random.split(key, 4)
        tree, end = self._descend(problem, rules, tree, key_descent, state, i + 1)
        if self.draw_of(problem) is not None:  # the key of the draw whose observation was new
            *_, key_expansion = _level_keys(jax.random.clone(key_descent), end.level)

        # A lane whose descent has ended at the horizon or with the episode computes this too; the result is
        # masked, as in a batch a branch would be computed in every lane.
        parameters = self._propose(problem, first, tree, key_proposal, end)
        action = problem.actions.decode(parameters)
        expansion = self.expand(key_expansion, problem, tree, end.state, end.node, action)
        at_horizon = self.leaf_at(tree, end.state, end.node)
        leaf = jax.tree.map(lambda new, old: jnp.where(end.is_expanded, new, old), expansion.leaf, at_horizon)
        is_over = end.is_expanded & expansion.is_terminal
        remaining = jnp.where(end.is_expanded & ~is_over, self.depth - 1 - end.level, 0)
        future = self.value_of(key_leaf, problem, leaf, remaining)
        gain = expansion.reward + jnp.where(is_over, 0.0, problem.discount * future)

        # XLA copies all beliefs, or the children of all nodes, in every iteration if old ones are read by
        # what need not precede the write of the new one. So the writes wait for the return, by a condition
        # that is never true. (Reading from the grown tree instead is slower in a batch.)
        waits = (i < 0) & (gain > 0.0)
        num_nodes, num_actions = tree.children.shape
        growth = Growth(
            index=i + 1,
            belief=jax.tree.map(lambda leaf: jnp.where(waits, jnp.zeros_like(leaf), leaf), expansion.belief),
            outcome=jnp.stack([expansion.reward, expansion.is_terminal.astype(gain.dtype)]),
            credited=end.actions,
            added=self._back_up(problem.discount, tree, end, expansion.reward, gain, future),
            node=end.node,
            slot=jnp.where(end.is_expanded & end.is_new_action & ~waits, end.slot, num_actions),
            action=jnp.where(end.is_expanded, end.action, num_nodes),
            branch=end.branch,
            parameters=parameters,
        )
        return tree.grown(growth)

    def _descend(
        self, problem: Model, rules: "_Rules", tree: Tree, key: Key[Array, ""], state: State, new: Index
    ) -> tuple[Tree, "_Descent"]:
        """Descend from the root until an action or a branch is added, or the simulation ends.

        `new` is the index of the action node that may be added.
        """
        nowhere, draw = tree.totals.shape[0], self.draw_of(problem)

        def is_active(carry: tuple[Belief, _Descent]) -> Bool[Array, ""]:
            return any_lane(in_own_kernel(carry[1].is_active, carry[1].turn))

        def next_level(carry: tuple[Belief, _Descent]) -> tuple[Belief, _Descent]:
            beliefs, at = carry
            key_branch, key_follow, key_draw = _level_keys(key, at.turn)
            children = row(tree.children, at.node)
            totals = tree.totals_of(children)
            slot = self._select(rules, totals)
            visits = row(totals[:, 0], slot)
            action_node = row(children, slot)
            is_new_action = action_node == UNVISITED
            taken = jnp.where(is_new_action, new, action_node)
            parameters = tree.parameters_of(action_node)
            action = problem.actions.decode(parameters)
            grown = eqx.tree_at(lambda tree: tree.beliefs, tree, beliefs)
            num_allowed = jnp.sum(rules.for_branches <= visits, dtype=jnp.int32)
            if draw is not None:
                branches = tree.branches_of(action_node)
                num_branches = jnp.sum(branches != UNVISITED, dtype=jnp.int32)
                draws = num_allowed > num_branches
                is_counted = at.is_active & draws
                beliefs, is_known, counts = draw(key_draw, grown, at.state, action, branches, is_counted)
                grown = eqx.tree_at(lambda tree: tree.beliefs, tree, beliefs)
                adds = draws & ~is_known
                branch = row(branches, _by_count(key_branch, counts))
            else:
                # There is a branch for each threshold that the earlier visits have reached.
                num_branches = jnp.sum(rules.for_branches <= visits - 1.0, dtype=jnp.int32)
                adds = num_allowed > num_branches
                branch = tree.branches_of(action_node, random_index(key_branch, num_branches))
            is_followed = at.is_active & ~adds
            beliefs, state, reward, ended = self.follow(
                key_follow, problem, grown, at.state, action, branch, is_followed
            )
            level = at.level + is_followed.astype(jnp.int32)
            # Where the descent ends, the node, the state and the level stay as they were at the expansion.
            return beliefs, _Descent(
                turn=at.turn + 1,
                level=level,
                node=jnp.where(is_followed, branch, at.node),
                state=jnp.where(is_followed, state, at.state),
                slot=jnp.where(at.is_active, slot, at.slot),
                action=jnp.where(at.is_active, taken, at.action),
                parameters=jnp.where(at.is_active, parameters, at.parameters),
                branch=jnp.where(at.is_active, num_branches, at.branch),
                is_new_action=jnp.where(at.is_active, is_new_action, at.is_new_action),
                is_active=is_followed & ~ended & (level < self.depth),
                is_expanded=jnp.where(at.is_active, adds, at.is_expanded),
                is_at_horizon=at.is_at_horizon | (is_followed & ~ended & (level == self.depth)),
                actions=write_row(at.actions, at.turn, jnp.where(at.is_active, taken, nowhere)),
                rewards=write_row(at.rewards, at.turn, jnp.where(is_followed, reward, 0.0)),
            )

        zero, no = jnp.zeros((), jnp.int32), jnp.asarray(False)
        start = _Descent(
            turn=zero,
            level=zero,
            node=zero + ROOT,
            state=state,
            slot=zero,
            action=zero,
            parameters=jnp.zeros_like(tree.parameters_of(zero)),
            branch=zero,
            is_new_action=no,
            is_active=~no,
            is_expanded=no,
            is_at_horizon=no,
            actions=jnp.full((self.depth,), nowhere, jnp.int32),
            rewards=jnp.zeros((self.depth,), state.dtype),
        )
        beliefs, end = jax.lax.while_loop(is_active, next_level, (tree.beliefs, start))
        return eqx.tree_at(lambda tree: tree.beliefs, tree, beliefs), end

    def _select(self, rules: "_Rules", totals: Float[Array, "A T"]) -> Int[Array, ""]:
        """The action of the highest upper confidence bound, among those that exist or may be added now."""
        visits = totals[:, 0]
        at_node = jnp.sum(visits)
        bounds = upper_bound(visits, totals[:, 1], at_node, self.exploration)
        score = jnp.where(visits > 0.0, bounds, self.score_unvisited(at_node))
        return jnp.argmax(jnp.where(rules.for_actions <= at_node, score, -jnp.inf)).astype(jnp.int32)

    def _propose(
        self,
        problem: Model,
        first: Num[Array, "P"] | None,
        tree: Tree,
        key: Key[Array, ""],
        end: "_Descent",
    ) -> Num[Array, "P"]:
        """The parameters of the action that the descent has ended with: a new one, or one of the tree."""
        space = problem.actions
        if isinstance(space, Discrete):
            return end.slot[None].astype(end.parameters.dtype)
        totals = tree.totals_of(row(tree.children, end.node))
        proposed = self.proposal(key, space, tree, end.node, totals)
        if first is not None:
            proposed = jnp.where((end.node == ROOT) & (end.slot == 0), first, proposed)
        # The loop has read the parameters. If they were read here, the fusions that use them would read them
        # again while they are written, for which XLA copies those of all actions twice in every iteration.
        return jnp.where(end.is_new_action, proposed, end.parameters)

    def _back_up(
        self,
        discount: Float[Array, ""],
        tree: Tree,
        end: "_Descent",
        new_reward: Float[Array, ""],
        gain: Float[Array, ""],
        future: Float[Array, ""],
    ) -> Float[Array, "H T"]:
        """What `end.actions` are credited with: each action's own reward and all later ones.

        `new_reward` and `gain` are the reward and the return of the new branch, `future` is the value of a
        belief at the horizon.
        """
        num_levels = largest_in_lanes(end.turn)
        last = jnp.where(end.is_expanded, end.level, self.depth)

        def level_above(k: Int[Array, ""], carry):
            returns, later = carry
            level = num_levels - 1 - k
            reward = jnp.where(level == last, gain, end.rewards[level])
            later = jnp.where(level > last, 0.0, reward + discount * later)
            return write_row(returns, level, later), later

        # A lane that has reached the horizon has as many levels as any.
        start = jnp.zeros_like(end.rewards), jnp.where(end.is_at_horizon, future, 0.0)
        returns, _ = jax.lax.fori_loop(0, num_levels, level_above, start)
        added = [jnp.ones_like(returns), returns]
        if self.proposal.target is not None:
            levels = jnp.arange(self.depth, dtype=jnp.int32)
            rewards = jnp.where(levels == last, new_reward, end.rewards)
            target = returns if self.proposal.target == "return" else rewards
            # Welford: squares of deviations, since a sum of squares would cancel in float32.
            visits, _, total, _ = tree.totals.at[end.actions].get(mode="clip").T
            before = jnp.where(visits > 0.0, total / jnp.maximum(visits, 1.0), target)
            after = (total + target) / (visits + 1.0)
            added += [target, (target - before) * (target - after)]
        return jnp.stack(added, axis=-1)


def _level_keys(key: Key[Array, ""], level: Int[Array, ""]) -> Key[Array, "3"]:
    """Keys of a level of a descent: of the choice of a branch, of the step along it, and of a draw."""
    return jax.random.split(jax.random.fold_in(key, level), 3)


def _by_count(key: Key[Array, ""], counts: Float[Array, "B"]) -> Int[Array, ""]:
    """An index with a probability proportional to its count; 0 if all counts are zero."""
    ends = jnp.cumsum(counts)
    chosen = jax.random.uniform(key, (), ends.dtype) * ends[-1]
    # Rounding may make `chosen` equal to the sum, and the index one too large.
    last = jnp.maximum(jnp.sum(counts > 0, dtype=jnp.int32) - 1, 0)
    return jnp.minimum(jnp.sum(ends <= chosen, dtype=jnp.int32), last)


class _Rules(NamedTuple):
    """Visits after which a belief node may have each action, and an action node each branch."""

    for_actions: Float[Array, "A"]
    for_branches: Float[Array, "B"]


class _Descent(eqx.Module):
    """A descent from the root."""

    turn: Int[Array, ""]  # turns of the loop, the same in all lanes
    level: Int[Array, ""]  # number of branches followed
    node: Int[Array, ""]  # belief node reached
    state: Float[Array, "D"]  # state of the simulation there
    slot: Int[Array, ""]  # position of the action chosen there
    action: Int[Array, ""]  # its action node
    parameters: Num[Array, "P"]  # the parameters of that action node
    branch: Int[Array, ""]  # number of branches of that action
    is_new_action: Bool[Array, ""]  # whether the action has no visit yet
    is_active: Bool[Array, ""]  # whether the descent goes on
    is_expanded: Bool[Array, ""]  # whether it has ended with a new branch
    is_at_horizon: Bool[Array, ""]  # whether it has ended at a belief node without actions, at the horizon
    # Action node chosen at each level; past the end for levels that were not reached
    actions: Int[Array, "H"]
    rewards: Float[Array, "H"]  # reward of the branch followed at each level


def _drawn(problem: Model, key: Key[Array, ""]) -> Any:
    """What a state problem draws in a search."""
    if not isinstance(problem, StateModel):
        return None
    of_state, of_action, of_step, of_reading = jax.random.split(key, 4)
    state, action = problem.initial(of_state), problem.actions.decode(problem.actions.sample(of_action))
    after, *rest = problem.step(of_step, state, action)
    return rest, problem.observe(of_reading, state, action, after)
