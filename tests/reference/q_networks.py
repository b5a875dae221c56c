"""Q-networks in plain NumPy: backpropagation by hand, Adam, and the losses of both methods."""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Network:
    """Layers `x -> W x + b` with rectified linear units between them."""

    weights: list
    biases: list

    @property
    def parameters(self):
        return [*self.weights, *self.biases]

    def copy(self):
        return Network([w.copy() for w in self.weights], [b.copy() for b in self.biases])

    def layers(self, x):
        """The inputs of every layer, and the outputs of the last one, for rows `x`."""
        inputs = [x]
        for number, (w, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = inputs[-1] @ w.T + b
            inputs.append(np.maximum(x, 0.0) if number < len(self.weights) - 1 else x)
        return inputs

    def __call__(self, x):
        return self.layers(x)[-1]

    def gradient(self, x, slope):
        """The gradient of the weights and biases, from that of the outputs."""
        inputs = self.layers(x)
        weights, biases = [], []
        for number in reversed(range(len(self.weights))):
            weights.insert(0, slope.T @ inputs[number])
            biases.insert(0, slope.sum(axis=0))
            slope = (slope @ self.weights[number]) * (inputs[number] > 0.0)
        return [*weights, *biases]


@dataclass
class Adam:
    """Adam (Kingma and Ba, 2015) with its usual constants, in place."""

    rate: float
    steps: int = 0
    moments: dict = field(default_factory=dict)

    def __call__(self, parameters, gradients):
        self.steps += 1
        for number, (value, slope) in enumerate(zip(parameters, gradients, strict=True)):
            m, v = self.moments.get(number, (np.zeros_like(value), np.zeros_like(value)))
            m, v = 0.9 * m + 0.1 * slope, 0.999 * v + 0.001 * slope**2
            self.moments[number] = m, v
            m, v = m / (1.0 - 0.9**self.steps), v / (1.0 - 0.999**self.steps)
            value -= self.rate * m / (np.sqrt(v) + 1e-8)


def follow(target, network, rate):
    for old, new in zip(target.parameters, network.parameters, strict=True):
        old += rate * (new - old)


@dataclass
class BootstrappedQ:
    """Heads with priors; `masks` says which heads learn from which transitions."""

    heads: list
    priors: list
    discount: float
    prior_scale: float
    learning_rate: float
    target_rate: float

    def __post_init__(self):
        self.targets = [head.copy() for head in self.heads]
        self.adam = [Adam(self.learning_rate) for _ in self.heads]

    def td_targets(self, r, x2, goes_on):
        """`[B, K]`."""
        q = [
            target(x2) + self.prior_scale * p(x2) for target, p in zip(self.targets, self.priors, strict=True)
        ]
        return np.stack([r + self.discount * goes_on * head.max(axis=1) for head in q], axis=1)

    def step(self, x, a, r, x2, goes_on, masks):
        targets, rows = self.td_targets(r, x2, goes_on), np.arange(len(x))
        for k, (head, prior) in enumerate(zip(self.heads, self.priors, strict=True)):
            q = head(x) + self.prior_scale * prior(x)
            slope = np.zeros_like(q)
            slope[rows, a] = masks[:, k] * (q[rows, a] - targets[:, k]) / len(x)
            self.adam[k](head.parameters, head.gradient(x, slope))
            follow(self.targets[k], head, self.target_rate)


@dataclass
class RND:
    """Q and U in one network, a predictor and a random network."""

    values: Network
    predictor: Network
    random: Network
    discount: float
    u_discount: float
    kappa: float
    learning_rate: float
    target_rate: float
    sums: list = field(default_factory=list)

    def __post_init__(self):
        self.target = self.values.copy()
        self.adam = Adam(self.learning_rate), Adam(self.learning_rate)

    def error(self, x):
        return np.mean((self.predictor(x) - self.random(x)) ** 2, axis=1)

    def observe(self, x2):
        before = self.sums[-1] if self.sums else 0.0
        self.sums.append(self.u_discount * before + self.error(x2[None])[0])

    def bonus(self, x2):
        return self.error(x2) / (np.std(self.sums) or 1.0)

    def td_targets(self, r, x2, goes_on):
        """Of Q and of U, `[B, 2]`."""
        q, u = np.split(self.target(x2), 2, axis=1)
        best = np.argmax(q + self.kappa * u, axis=1)
        return np.stack(
            [
                r + self.discount * goes_on * q.max(axis=1),
                self.bonus(x2) + self.u_discount * u[np.arange(len(x2)), best],
            ],
            axis=1,
        )

    def step(self, x, a, r, x2, goes_on):
        targets, rows = self.td_targets(r, x2, goes_on), np.arange(len(x))
        values = self.values(x)
        slope = np.zeros_like(values)
        for k in range(2):
            column = a + k * values.shape[1] // 2
            slope[rows, column] = (values[rows, column] - targets[:, k]) / len(x)
        difference = self.predictor(x2) - self.random(x2)
        gradient = self.predictor.gradient(x2, 2.0 * difference / difference.size)
        self.adam[0](self.values.parameters, self.values.gradient(x, slope))
        self.adam[1](self.predictor.parameters, gradient)
        follow(self.target, self.values, self.target_rate)
