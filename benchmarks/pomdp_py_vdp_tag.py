"""VDP Tag for POMCP of pomdp-py: 25 angles, each with and without a look, and readings rounded to .2."""

import importlib
import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import vdp_tag_scalars
from typing_extensions import override

pomdp_py: Any = importlib.import_module("pomdp_py")  # it has no types


class State(pomdp_py.State):
    """Positions of the agent and the target; the target was tagged if `is_over`."""

    def __init__(self, agent, target, is_over=False):
        self.agent, self.target, self.is_over = agent, target, is_over

    @override
    def __eq__(self, other):
        return (self.agent, self.target) == (other.agent, other.target)

    @override
    def __hash__(self):
        return hash((self.agent, self.target))


class Action(pomdp_py.Action):
    """An angle and a look."""

    def __init__(self, angle, look):
        self.angle, self.look = angle, look

    @override
    def __eq__(self, other):
        return (self.angle, self.look) == (other.angle, other.look)

    @override
    def __hash__(self):
        return hash((self.angle, self.look))


class Observation(pomdp_py.Observation):
    """Rounded readings."""

    def __init__(self, readings):
        self.readings = readings

    @override
    def __eq__(self, other):
        return self.readings == other.readings

    @override
    def __hash__(self):
        return hash(self.readings)


ACTIONS = [Action(2.0 * math.pi * k / 25, look) for k in range(25) for look in (False, True)]


class Transition(pomdp_py.TransitionModel):
    """The next state."""

    def sample(self, state, action):
        """A draw; a terminal state stays."""
        if state.is_over:
            return state
        return State(*vdp_tag_scalars.step(state.agent, state.target, action.angle))


class Readings(pomdp_py.ObservationModel):
    """The rounded readings of eight beams."""

    def sample(self, next_state, action):
        """A draw."""
        readings = vdp_tag_scalars.readings(next_state.agent, next_state.target, action.look)
        return Observation(tuple(math.floor(reading / 0.2) for reading in readings))


class Reward(pomdp_py.RewardModel):
    """The reward of a step."""

    def sample(self, state, action, next_state):
        """The reward; 0 after the end."""
        if state.is_over:
            return 0.0
        return vdp_tag_scalars.reward(next_state.is_over, action.look)


class Random(pomdp_py.RolloutPolicy):
    """Random actions."""

    def rollout(self, state, history=None):
        """A random action."""
        return random.choice(ACTIONS)

    def get_all_actions(self, state=None, history=None):
        """All actions."""
        return ACTIONS


def planner(iterations: int, depth: int, num_particles: int) -> Callable[[int], Any]:
    """A function of a seed that plans once for the initial belief."""
    targets = np.random.default_rng(0).uniform(-4.0, 4.0, (num_particles, 2)).tolist()
    policy = Random()
    problem = policy, Transition(), Readings(), Reward()

    def plan(seed: int) -> Any:
        random.seed(seed)
        belief = pomdp_py.Particles([State((0.0, 0.0), tuple(target)) for target in targets])
        agent = pomdp_py.Agent(belief, *problem)
        solver = pomdp_py.POMCP(
            max_depth=depth,
            discount_factor=0.95,
            num_sims=iterations,
            exploration_const=100.0,
            rollout_policy=policy,
        )
        return solver.plan(agent)

    return plan
