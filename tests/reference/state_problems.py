"""State problems in plain NumPy, one state at a time, written as the published definitions read.

A step is a mean, a standard deviation and a reward; an observation is a mean and a standard deviation.
"""

import itertools
from math import atan2, ceil, cos, exp, hypot, pi, sin, sqrt

import numpy as np


def beam(x, y):
    """Number of the beam, from 1, that covers the angle in (0, 2 pi]."""
    angle = atan2(y, x)
    return ceil(8.0 * (angle if angle > 0.0 else angle + 2.0 * pi) / (2.0 * pi))


def readings(number, mean, noise, other_mean, other_noise):
    """Means and standard deviations of eight beams."""
    means, noises = np.full(8, float(other_mean)), np.full(8, float(other_noise))
    means[number - 1], noises[number - 1] = mean, noise
    return means, noises


def cross(a, b):
    """The third component of the cross product."""
    return a[0] * b[1] - a[1] * b[0]


class VdpTag:
    """VDPTag2.jl with barriers."""

    segments = tuple(((0.2 * x, 0.2 * y), (2.8 * x, 2.8 * y)) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)))

    def crossing(self, start, move):
        """The least share of a move that ends on a barrier; None if it meets none."""
        found = []
        for p, r in self.segments:
            if (rxs := cross(r, move)) != 0.0:
                q = (start[0] - p[0], start[1] - p[1])
                if 0.0 <= cross(q, r) / rxs < 1.0 and 0.0 <= cross(q, move) / rxs <= 1.0:
                    found.append(cross(q, r) / rxs)
        return min(found, default=None)

    def step(self, state, action):
        """Mean and standard deviation of the next state."""
        move = np.array([0.5 * cos(action[0]), 0.5 * sin(action[0])])
        share = self.crossing(state[:2], move)
        agent = state[:2] + (1.0 if share is None else share) * move
        target = state[2:]
        for _ in range(5):
            target = runge_kutta(lambda p: np.array([2 * (p[0] - p[0] ** 3 / 3 - p[1]), p[0] / 2]), target)
        return np.concatenate([agent, target]), np.array([0.0, 0.0, 0.05, 0.05])

    def reward(self, state, action, following):
        """Reward and termination."""
        tagged = hypot(*(following[2:] - following[:2])) < 0.1
        return (100.0 if tagged else -1.0) - 5.0 * action[1], tagged

    def observation(self, action, following):
        """Means and standard deviations of an observation."""
        x, y = following[2:] - following[:2]
        return readings(beam(x, y), hypot(x, y), 0.1 if action[1] else 5.0, 1.0, 5.0)


def runge_kutta(velocity, x, step=0.1):
    """One step of the classical method of order 4."""
    a = velocity(x)
    b = velocity(x + step / 2 * a)
    c = velocity(x + step / 2 * b)
    d = velocity(x + step * c)
    return x + step * (a + 2 * b + 2 * c + d) / 6


class LightDark:
    """SimpleLightDark of the published experiments."""

    def step(self, state, action):
        """Mean and standard deviation of the next state."""
        return np.clip(state + action, -60, 60), np.zeros(1)

    def reward(self, state, action, following):
        """Reward and termination."""
        if action[0] == 0:
            return (100.0 if state[0] == 0 else -100.0), True
        return -1.0, False

    def observation(self, action, following):
        """Mean and standard deviation of an observation."""
        return following, abs(following - 10.0) + 1e-4

    def values(self):
        """Value of each position with states observed: the shortest way to 0 by breadth-first search."""
        distance, edge = {0: 0}, [0]
        while edge:
            following = edge
            edge = []
            for position in range(-60, 61):
                reached = {max(-60, min(60, position + move)) for move in (-10, -1, 1, 10)}
                if position not in distance and reached & set(following):
                    edge.append(position)
            distance |= {position: distance[following[0]] + 1 for position in edge}
        return {s: 100 * 0.95**n - (1 - 0.95**n) / 0.05 for s, n in distance.items()}


class SubHunt:
    """SubHunt.jl; a state is (x, y, target x, target y, direction, aware)."""

    directions = ((0, 1), (1, 0), (0, -1), (-1, 0))

    def __init__(self, size=20):
        self.size = size

    def inside(self, value):
        """A coordinate on the grid."""
        return max(1, min(self.size, value))

    def outcomes(self, state, action):
        """Probabilities of the next states, "kill" among them."""
        x, y, target_x, target_y, direction, aware = state
        found = {}
        kill = 0.0
        if action == 5 and hypot(target_x - x, target_y - y) <= 2.0:
            kill = found["kill"] = 0.6 if aware else 1.0
        if action < 4:
            x, y = (self.inside(c + 3 * d) for c, d in zip((x, y), self.directions[action], strict=True))
        ahead = self.directions[direction]
        left, right = self.directions[direction - 1], self.directions[(direction + 1) % 4]
        for turn, probability in ((ahead, 0.5), (left, 0.25), (right, 0.25)):
            place = (
                self.inside(c + a + b) for c, a, b in zip((target_x, target_y), ahead, turn, strict=True)
            )
            following = (x, y, *place, direction, 1 if action == 4 else aware)
            found[following] = found.get(following, 0.0) + probability * (1.0 - kill)
        return {following: p for following, p in found.items() if p > 0.0}

    def is_over(self, state):
        """Whether the target is dead, or has reached the edge that it heads for."""
        if state == "kill":
            return True
        return (state[3], state[2], state[3], state[2])[state[4]] == (self.size if state[4] < 2 else 1)

    def observation(self, action, following):
        """Means and standard deviations of an observation."""
        x, y = following[2] - following[0], following[3] - following[1]
        if action[0] == 4:
            return readings(beam(x, y), hypot(x, y), 0.5, 20.0, 0.5)
        if hypot(x, y) <= 3.0:
            return readings(beam(x, y), hypot(x, y), 0.5, 3.0, 5.0)
        return readings(1, 3.0, 5.0, 3.0, 5.0)

    def values(self):
        """Value of each action at each state with states observed, for a small grid."""
        cells = range(1, self.size + 1)
        states = list(itertools.product(cells, cells, cells, cells, range(4), range(2)))
        value = dict.fromkeys([*states, "kill"], 0.0)

        def of_action(state, action):
            return sum(
                p * (100.0 if s == "kill" else 0.0 if self.is_over(s) else 0.99 * value[s])
                for s, p in self.outcomes(state, action).items()
            )

        for _ in range(self.size):
            value |= {state: max(of_action(state, action) for action in range(6)) for state in states}
        return {state: [of_action(state, action) for action in range(6)] for state in states}


class PomdpLander:
    """The lunar lander of Lim, Tomlin and Sunberg."""

    def step(self, state, action):
        """Mean and standard deviation of the next state."""
        x, z, theta, v_x, v_z, omega = state
        lateral, thrust, offset = action
        force_x = cos(theta) * lateral - sin(theta) * thrust
        force_z = cos(theta) * thrust + sin(theta) * lateral
        velocities = (v_x + 0.4 * force_x, v_z + 0.4 * (force_z - 9.0), omega - 0.4 * offset * lateral / 10.0)
        mean = np.array([x + 0.4 * v_x, z + 0.4 * v_z, theta + 0.4 * omega, *velocities])
        return mean, np.array([0, 0, 0, 0.1, 0.1, 0.01])

    def reward(self, state, action, following):
        """Reward and termination."""
        if abs(following[0]) >= 15.0 or abs(following[2]) >= 0.5:
            return -1000.0, True
        if following[1] <= 1.0:
            return 100.0 - abs(following[0]) - following[4] ** 2, True
        return -0.8, False

    def observation(self, action, following):
        """Mean and standard deviations of an observation."""
        mean = [following[1] / cos(following[2]), following[5], following[3]]
        return np.array(mean), np.array([1.0, 0.01, 0.1])


class LightDarkNd:
    """CollabLightDark of AGMCTS without obstacles."""

    def __init__(self, num_dims=2, num_agents=1):
        self.num_dims, self.num_agents = num_dims, num_agents
        self.goal = np.array([0.0] * (num_dims - 1) + [2.5])
        self.beacon = self.goal / 2 + np.array([2.5] + [0.0] * (num_dims - 1))

    def step(self, state, action):
        """Mean and standard deviation of the next state."""
        return state + action, np.full(len(state), 0.03)

    def reward(self, state, action, following):
        """Reward and termination."""
        distances = [float(np.linalg.norm(x - self.goal)) for x in np.split(following, self.num_agents)]
        ended = all(d < 0.2 for d in distances)
        paid = 0.0
        for d in distances:
            paid += -0.02 * d**2 - 2.0 * exp(-(((d - 1.0) / 0.2) ** 2) / 2)
            paid += 10.0 * exp(-((d / 0.1) ** 2) / 2) if ended else 0.0
        return paid / self.num_agents, ended

    def observation(self, action, following):
        """Means and standard deviations of an observation."""
        agents = np.split(following, self.num_agents)
        means = [x - before for x, before in zip(agents, [self.beacon, *agents], strict=False)]
        noises = []
        for mean in means:
            d = float(np.linalg.norm(mean))
            noises += [min(15.0, 0.01 * (d + d**8))] * self.num_dims
        return np.concatenate(means), np.array(noises)


class Lqg:
    """Two steps with identity matrices; a state ends with the number of steps taken."""

    def step(self, state, action):
        """Mean and standard deviation of the next state."""
        return np.array([*(state[:2] + action), state[2] + 1]), np.array([0.1, 0.1, 0.0])

    def reward(self, state, action, following):
        """Reward and termination."""
        cost = state[:2] @ state[:2] + action @ action
        if following[2] == 2:
            cost += following[:2] @ following[:2]
        return -cost, following[2] == 2

    def observation(self, action, following):
        """Mean and standard deviations of an observation."""
        return following[:2], np.full(2, 0.1)


def riccati(a, b, q, r, num_steps):
    """Gains K_t of the best actions -K_t x, and matrices P_t of the cost to go x'P_t x + constant."""
    matrices, gains = [q], []
    for _ in range(num_steps):
        p = matrices[0]
        gain = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
        gains.insert(0, gain)
        matrices.insert(0, q + gain.T @ r @ gain + (a - b @ gain).T @ p @ (a - b @ gain))
    return gains, matrices


def lqg_cost(mean, covariance, process, sensor, num_steps):
    """The least expected cost with identity matrices: of the mean, of estimation errors, and of the noise."""
    eye = np.eye(len(mean))
    gains, matrices = riccati(eye, eye, eye, eye, num_steps)
    cost = mean @ matrices[0] @ mean + np.trace(matrices[0] @ covariance)
    for t in range(num_steps):
        cost += np.trace(matrices[t + 1] @ process)
        cost += np.trace(gains[t].T @ (eye + matrices[t + 1]) @ gains[t] @ covariance)
        predicted = covariance + process
        covariance = predicted - predicted @ np.linalg.solve(predicted + sensor, predicted)
    return cost


def tiger_values(num_steps, reach=60):
    """Values and best actions by the difference n of what was heard, from -reach; action 1 opens a door."""
    n = np.arange(-reach, reach + 1)
    p = 1.0 / (1.0 + (0.15 / 0.85) ** n.astype(float))  # probability of the right side
    heard = 0.85 * p + 0.15 * (1.0 - p)
    opened = np.maximum(10.0 * p - 100.0 * (1.0 - p), 10.0 * (1.0 - p) - 100.0 * p)
    value = np.zeros(len(n))
    for _ in range(num_steps):
        up, down = np.append(value[1:], value[-1]), np.insert(value[:-1], 0, value[0])
        listening = -1.0 + 0.95 * (heard * up + (1.0 - heard) * down)
        opening = opened + 0.95 * value[reach]
        value = np.maximum(listening, opening)
    return n, value, opening > listening


def systematic(weights, offset, num):
    """Indices of systematic resampling with its uniform number given."""
    ends = np.cumsum(weights) / np.sum(weights)
    return [int(np.argmax((j + offset) / num < ends)) for j in range(num)]


def log_density(observation, mean, noise):
    """Logarithm of an independent Gaussian density."""
    return -0.5 * np.sum(((observation - mean) / noise) ** 2) - np.sum(np.log(noise * sqrt(2.0 * pi)))
