"""DORA in plain NumPy: tile coding with a dictionary, as in Sutton's tiles3, and the updates of Q and E."""

from dataclasses import dataclass, field

import numpy as np


def tuple_hash(numbers):
    """xxHash of a tuple of integers, with the constants of CPython for 32 bits."""
    most = 2**32 - 1
    total = 374761393
    for number in numbers:
        total = (total + number * 2246822519) & most
        total = ((total << 13) | (total >> 19)) & most
        total = (total * 2654435761) & most
    return (total + (len(numbers) ^ 374761393 ^ 3527539)) & most


@dataclass
class TileCoder:
    """Indices of tiles, handed out in the order of first use, and hashed once there are no more."""

    num_tilings: int
    size: int
    indices: dict = field(default_factory=dict)
    num_hashed: int = 0

    def __call__(self, x, action):
        steps = [int(np.floor(number * self.num_tilings)) for number in x]
        found = []
        for tiling in range(self.num_tilings):
            coordinates = [(q + tiling * (2 * d + 1)) // self.num_tilings for d, q in enumerate(steps)]
            found.append(self.index((tiling, *coordinates, action)))
        return found

    def index(self, tile):
        if tile not in self.indices:
            if len(self.indices) >= self.size:
                self.num_hashed += 1
                return tuple_hash(tile) % self.size
            self.indices[tile] = len(self.indices)
        return self.indices[tile]

    def features(self, x, action):
        """phi(s, a): 1 at the indices of the tiles."""
        phi = np.zeros(self.size)
        phi[self(x, action)] = 1.0
        return phi


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


@dataclass
class DORA:
    """One transition at a time; the next action is that of the transitions that are observed."""

    coder: TileCoder
    scale: np.ndarray
    num_actions: int
    w_q: np.ndarray
    discount: float = 0.99
    e_discount: float = 0.99
    learning_rate: float = 0.1
    e_learning_rate: float = 0.5
    xi: float = 1.0
    e_values: str = "sigmoid"
    derivative: str = "at-e"

    def __post_init__(self):
        self.w_e = np.zeros_like(self.w_q)
        self.alpha = self.learning_rate / self.coder.num_tilings
        self.alpha_e = self.e_learning_rate / self.coder.num_tilings

    def features(self, s):
        """phi of a state with every action, one row each."""
        return np.stack([self.coder.features(self.scale * s, a) for a in range(self.num_actions)])

    def e(self, z):
        return sigmoid(z) if self.e_values == "sigmoid" else 1.0 + z

    def slope(self, e, terminated):
        if self.e_values == "linear":
            return 1.0
        if self.derivative == "at-e" and not terminated:
            return sigmoid(e) * (1.0 - sigmoid(e))
        return e * (1.0 - e)

    def q_and_e(self, s):
        phi = self.features(s)
        return phi @ self.w_q, self.e(phi @ self.w_e)

    def observe(self, s, a, r, s2, terminated, a2, scale=1.0):
        phi = self.features(s)[a]
        q, e = phi @ self.w_q, self.e(phi @ self.w_e)
        q_target, e_target = 0.0, 0.0
        if not terminated:
            next_q, next_e = self.q_and_e(s2)
            q_target, e_target = self.discount * next_q.max(), self.e_discount * next_e[a2]
        self.w_e += self.alpha_e * (e_target - e) * self.slope(e, terminated) * phi
        bonus = np.log(1.0 - self.alpha_e) / np.log(self.e(phi @ self.w_e))
        self.w_q += self.alpha * (r + self.xi * scale * bonus + q_target - q) * phi
