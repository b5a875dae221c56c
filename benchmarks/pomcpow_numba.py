"""POMCPOW on VDP Tag as loops compiled by Numba for one core, after POMCPOW.jl: the peer of bench_pomdp.py.

A branch keeps all simulated steps, in a linked list, and draws from them by weight, as published. Actions,
observations and noise are drawn by NumPy's generator.
"""

from math import atan2, ceil, cos, exp, hypot, log, pi, sin, sqrt

import numpy as np
from numba import njit  # pyright: ignore[reportMissingImports]

MAX_ACTIONS, MAX_BRANCHES = 64, 12
ACTION_K, ACTION_ALPHA, BRANCH_K, BRANCH_ALPHA = 30.0, 1 / 30, 5.0, 1 / 100
EXPLORATION, DISCOUNT = 110.0, 0.95


@njit
def drift(x, y):
    """The target's next position without noise: five steps of RK4."""
    h = 0.1
    for _ in range(5):
        x1, y1 = 2.0 * (x - x**3 / 3.0 - y), x / 2.0
        a, b = x + h / 2 * x1, y + h / 2 * y1
        x2, y2 = 2.0 * (a - a**3 / 3.0 - b), a / 2.0
        a, b = x + h / 2 * x2, y + h / 2 * y2
        x3, y3 = 2.0 * (a - a**3 / 3.0 - b), a / 2.0
        a, b = x + h * x3, y + h * y3
        x4, y4 = 2.0 * (a - a**3 / 3.0 - b), a / 2.0
        x += h / 6 * (x1 + 2 * x2 + 2 * x3 + x4)
        y += h / 6 * (y1 + 2 * y2 + 2 * y3 + y4)
    return x, y


@njit
def move(x, y, angle):
    """The agent's next position; barriers are four segments on the half axes."""
    dx, dy = 0.5 * cos(angle), 0.5 * sin(angle)
    share = 1.0
    for k in range(4):
        ux, uy = (1.0, 0.0, -1.0, 0.0)[k], (0.0, 1.0, 0.0, -1.0)[k]
        cross = 2.8 * (ux * dy - uy * dx)
        if cross != 0.0:
            u = ((x - 0.2 * ux) * 2.8 * uy - (y - 0.2 * uy) * 2.8 * ux) / cross
            t = ((x - 0.2 * ux) * dy - (y - 0.2 * uy) * dx) / cross
            if 0.0 <= u < share and 0.0 <= t <= 1.0:
                share = u - 4.4e-16
    return x + share * dx, y + share * dy


@njit
def step(state, action, after):
    """Write the next state into `after`; the reward, and whether the target is tagged."""
    after[0], after[1] = move(state[0], state[1], action[0])
    x, y = drift(state[2], state[3])
    after[2], after[3] = x + 0.05 * np.random.randn(), y + 0.05 * np.random.randn()
    tagged = hypot(after[2] - after[0], after[3] - after[1]) < 0.1
    return (100.0 if tagged else -1.0) - 5.0 * action[1], tagged


@njit
def beam_of(state):
    """The target's beam and distance."""
    dx, dy = state[2] - state[0], state[3] - state[1]
    angle = atan2(dy, dx)
    if angle <= 0.0:
        angle += 2.0 * pi
    return min(int(ceil(8.0 * angle / (2.0 * pi))) - 1, 7), hypot(dx, dy)


@njit
def likelihood(state, look, observation):
    """The density of an observation over that of eight beams without a target."""
    beam, distance = beam_of(state)
    noise = 0.1 if look > 0.0 else 5.0
    z, empty = (observation[beam] - distance) / noise, (observation[beam] - 1.0) / 5.0
    return exp(-0.5 * (z * z - empty * empty)) * 5.0 / noise


@njit
def draw_action(action):
    """A random angle, and a look with probability 1/2."""
    action[0] = 2.0 * pi * np.random.rand()
    action[1] = 1.0 if np.random.rand() < 0.5 else 0.0


@njit
def rollout(state, num_steps):
    """Return of random actions."""
    total, weight = 0.0, 1.0
    at, after, action = state.copy(), np.empty(4), np.empty(2)
    for _ in range(num_steps):
        draw_action(action)
        reward, ended = step(at, action, after)
        total += weight * reward
        weight *= DISCOUNT
        if ended:
            break
        at[:] = after
    return total


@njit
def plan(seed, particles, iterations, depth):
    """The action of the highest mean return: angle and look."""
    np.random.seed(seed)
    num = iterations + 1
    num_actions, visits = np.zeros(num, np.int64), np.zeros(num)  # of belief nodes
    children = np.zeros((num, MAX_ACTIONS), np.int64)
    action_visits, values = np.zeros(num), np.zeros(num)
    actions, num_branches = np.zeros((num, 2)), np.zeros(num, np.int64)
    branches = np.zeros((num, MAX_BRANCHES), np.int64)
    observations, weights = np.zeros((num, 8)), np.zeros(num)
    # Simulated steps: state, reward and termination; each refers to the one before it in its branch.
    steps = np.zeros((iterations * depth, 6))
    step_weights, before = np.zeros(iterations * depth), np.full(iterations * depth, -1)
    last = np.full(num, -1)
    num_steps = num_action_nodes = 0
    num_beliefs = 1
    state, after = np.empty(4), np.empty(4)
    path, nodes, rewards = np.empty(depth, np.int64), np.empty(depth, np.int64), np.empty(depth)
    for _ in range(iterations):
        state[:] = particles[np.random.randint(particles.shape[0])]
        node = level = 0
        later, ended = 0.0, False
        while not ended and level < depth:
            if num_actions[node] <= ACTION_K * visits[node] ** ACTION_ALPHA:
                children[node, num_actions[node]] = num_action_nodes
                draw_action(actions[num_action_nodes])
                num_actions[node] += 1
                num_action_nodes += 1
            best, chosen = -np.inf, 0
            logarithm = log(max(visits[node], 1.0))
            for k in range(num_actions[node]):
                a = children[node, k]
                score = np.inf
                if action_visits[a] > 0:
                    score = values[a] + EXPLORATION * sqrt(logarithm / action_visits[a])
                if score > best:
                    best, chosen = score, a
            reward, ended = step(state, actions[chosen], after)
            is_new = num_branches[chosen] <= BRANCH_K * action_visits[chosen] ** BRANCH_ALPHA
            if is_new:
                child = num_beliefs
                num_beliefs += 1
                branches[chosen, num_branches[chosen]] = child
                num_branches[chosen] += 1
                beam, distance = beam_of(after)
                for k in range(8):
                    observations[child, k] = 1.0 + 5.0 * np.random.randn()
                noise = 0.1 if actions[chosen, 1] > 0.0 else 5.0
                observations[child, beam] = distance + noise * np.random.randn()
            else:
                child = branches[chosen, np.random.randint(num_branches[chosen])]
            weight = likelihood(after, actions[chosen, 1], observations[child])
            weights[child] += weight
            steps[num_steps, :4] = after
            steps[num_steps, 4], steps[num_steps, 5] = reward, 1.0 if ended else 0.0
            step_weights[num_steps], before[num_steps] = weight, last[child]
            last[child] = num_steps
            num_steps += 1
            path[level], nodes[level] = chosen, node
            if is_new:
                rewards[level] = reward
                if not ended:
                    later = rollout(after, depth - 1 - level)
                level += 1
                break
            left, drawn = np.random.rand() * weights[child], last[child]
            while before[drawn] >= 0:
                left -= step_weights[drawn]
                if left < 0.0:
                    break
                drawn = before[drawn]
            state[:] = steps[drawn, :4]
            rewards[level], ended = steps[drawn, 4], steps[drawn, 5] > 0.0
            node = child
            level += 1
        for k in range(level - 1, -1, -1):
            later = rewards[k] + DISCOUNT * later
            a = path[k]
            action_visits[a] += 1
            values[a] += (later - values[a]) / action_visits[a]
            visits[nodes[k]] += 1
    best = children[0, 0]
    for k in range(num_actions[0]):
        if values[children[0, k]] > values[best]:
            best = children[0, k]
    return actions[best, 0], actions[best, 1], values[best]
