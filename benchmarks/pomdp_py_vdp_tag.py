"""VDP Tag for POMCP of pomdp-py: 25 angles, each with and without a look, and readings rounded to .2."""

import importlib
import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
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


def _drift(x: float, y: float) -> tuple[float, float]:
    def velocity(x, y):
        return 2.0 * (x - x**3 / 3.0 - y), x / 2.0

    h = 0.1
    for _ in range(5):
        a = velocity(x, y)
        b = velocity(x + h / 2 * a[0], y + h / 2 * a[1])
        c = velocity(x + h / 2 * b[0], y + h / 2 * b[1])
        d = velocity(x + h * c[0], y + h * c[1])
        x += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
        y += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
    return x, y


def _move(x: float, y: float, angle: float) -> tuple[float, float]:
    dx, dy = 0.5 * math.cos(angle), 0.5 * math.sin(angle)
    share = 1.0
    for ux, uy in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
        cross = 2.8 * (ux * dy - uy * dx)
        if cross != 0.0:
            u = ((x - 0.2 * ux) * 2.8 * uy - (y - 0.2 * uy) * 2.8 * ux) / cross
            t = ((x - 0.2 * ux) * dy - (y - 0.2 * uy) * dx) / cross
            if 0.0 <= u < share and 0.0 <= t <= 1.0:
                share = u - 4.4e-16
    return x + share * dx, y + share * dy


class Transition(pomdp_py.TransitionModel):
    """The next state."""

    def sample(self, state, action):
        """A draw; a terminal state stays."""
        if state.is_over:
            return state
        (x, y), (left, up) = _drift(*state.target), state.agent
        agent = _move(left, up, action.angle)
        target = x + random.gauss(0.0, 0.05), y + random.gauss(0.0, 0.05)
        return State(agent, target, math.dist(agent, target) < 0.1)


class Readings(pomdp_py.ObservationModel):
    """The rounded readings of eight beams."""

    def sample(self, next_state, action):
        """A draw."""
        dx, dy = (t - a for t, a in zip(next_state.target, next_state.agent, strict=True))
        beam = math.ceil(8.0 * (math.atan2(dy, dx) % (2.0 * math.pi)) / (2.0 * math.pi)) - 1
        readings = [random.gauss(1.0, 5.0) for _ in range(8)]
        readings[beam] = random.gauss(math.hypot(dx, dy), 0.1 if action.look else 5.0)
        return Observation(tuple(math.floor(reading / 0.2) for reading in readings))


class Reward(pomdp_py.RewardModel):
    """The reward of a step."""

    def sample(self, state, action, next_state):
        """The reward; 0 after the end."""
        if state.is_over:
            return 0.0
        return (100.0 if next_state.is_over else -1.0) - 5.0 * action.look


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
