"""The dynamics model and the bonus of VIME in plain NumPy, with derivatives written out by hand."""

from dataclasses import dataclass

import numpy as np


def softplus(x):
    return np.log1p(np.exp(x))


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


@dataclass
class Model:
    """Two layers of Gaussian weights, of which the last rows are biases: mean, rho, mean, rho."""

    parameters: list[np.ndarray]
    prior: float
    likelihood: float
    num_batches: float

    def loss(self, noise, inputs, targets):
        """KL(posterior, prior) / num_batches less the mean log likelihood of the draws, and its gradient."""
        value, gradient = self.error(noise, inputs, targets)
        for k in (0, 2):
            mean, rho = self.parameters[k], self.parameters[k + 1]
            deviation = softplus(rho)
            kl = np.log(self.prior / deviation) + (deviation**2 + mean**2) / (2 * self.prior**2) - 0.5
            value += kl.sum() / self.num_batches
            gradient[k] += mean / self.prior**2 / self.num_batches
            slope = deviation / self.prior**2 - 1 / deviation
            gradient[k + 1] += slope * sigmoid(rho) / self.num_batches
        return value, gradient

    def error(self, noise, inputs, targets):
        """Minus the log likelihood, summed over rows and outputs; mean of the draws; and its gradient."""
        num_draws = len(noise[0])
        value, gradient = 0.0, [np.zeros_like(p) for p in self.parameters]
        for draw in range(num_draws):
            first, second = noise[0][draw], noise[1][draw]
            x = np.c_[inputs, np.ones(len(inputs))]
            hidden, hidden_deviation = self.layer(0, x, first)
            h = np.c_[np.maximum(hidden, 0.0), np.ones(len(inputs))]
            output, output_deviation = self.layer(2, h, second)
            difference = output - targets
            value += np.sum(0.5 * (difference / self.likelihood) ** 2)
            value += difference.size * np.log(self.likelihood * np.sqrt(2 * np.pi))
            upstream = difference / self.likelihood**2
            back = self.backward(2, gradient, h, second, output_deviation, upstream)
            upstream = back[:, :-1] * (hidden > 0)
            self.backward(0, gradient, x, first, hidden_deviation, upstream)
        return value / num_draws, [g / num_draws for g in gradient]

    def layer(self, k, x, noise):
        deviation = np.sqrt(x**2 @ softplus(self.parameters[k + 1]) ** 2)
        return x @ self.parameters[k] + deviation * noise, deviation

    def backward(self, k, gradient, x, noise, deviation, upstream):
        """Add to the gradient of a layer, and return the derivatives with respect to its inputs."""
        mean, rho = self.parameters[k], self.parameters[k + 1]
        by_variance = upstream * noise / (2 * deviation)
        gradient[k] += x.T @ upstream
        gradient[k + 1] += (x**2).T @ by_variance * 2 * softplus(rho) * sigmoid(rho)
        return upstream @ mean.T + 2 * x * (by_variance @ (softplus(rho) ** 2).T)

    def inverse_curvature(self):
        deviations = [softplus(self.parameters[k]) for k in (1, 3)]
        rhos = [self.parameters[k] for k in (1, 3)]
        by_rho = [
            d**2 * (1 + np.exp(r)) ** 2 / (2 * np.exp(2 * r)) for d, r in zip(deviations, rhos, strict=True)
        ]
        return [deviations[0] ** 2, by_rho[0], deviations[1] ** 2, by_rho[1]]

    def stepped(self, noise, inputs, targets, step):
        """The model after a Newton step on one transition."""
        _, gradient = self.error(noise, inputs, targets)
        terms = zip(self.parameters, gradient, self.inverse_curvature(), strict=True)
        parameters = [p - step * h * g for p, g, h in terms]
        return Model(parameters, self.prior, self.likelihood, self.num_batches)

    def kl(self, other):
        """KL divergence from another model, weight by weight."""
        total = 0.0
        for k in (0, 2):
            mean, deviation = self.parameters[k], softplus(self.parameters[k + 1])
            mean2, deviation2 = other.parameters[k], softplus(other.parameters[k + 1])
            ratio = (deviation**2 + (mean - mean2) ** 2) / (2 * deviation2**2)
            total += np.sum(np.log(deviation2 / deviation) + ratio - 0.5)
        return total

    def information_gain(self, noise, inputs, targets, step):
        _, gradient = self.error(noise, inputs, targets)
        terms = zip(gradient, self.inverse_curvature(), strict=True)
        return step**2 * sum(np.sum(g**2 * h) for g, h in terms)


def path_bonuses(model, noise, inputs, targets, step, largest):
    """The bonuses of a path, not normalised: the last step has that of the step before it.

    `noise` has the draws of each step.
    """
    gains = [
        np.clip(model.information_gain(draws, x[None], y[None], step), 0.0, largest)
        for draws, x, y in zip(noise, inputs, targets, strict=True)
    ]
    if len(gains) > 1:
        gains[-1] = gains[-2]
    return np.array(gains)


def returns(rewards, discount):
    """Discounted returns of one path."""
    total, out = 0.0, []
    for reward in rewards[::-1]:
        total = reward + discount * total
        out.append(total)
    return np.array(out[::-1])


def advantages(rewards, values, discount, trace_decay):
    """Generalised advantages of one path, after which the value is 0."""
    after = [*values[1:], 0.0]
    errors = [r + discount * v2 - v for r, v, v2 in zip(rewards, values, after, strict=True)]
    out = []
    for t in range(len(errors)):
        out.append(sum((discount * trace_decay) ** k * e for k, e in enumerate(errors[t:])))
    return np.array(out)


def baseline_features(observations):
    """Features of the linear baseline for one path."""
    clipped = np.clip(observations, -10, 10)
    time = np.arange(len(clipped))[:, None] / 100
    return np.hstack([clipped, clipped**2, time, time**2, time**3, np.ones_like(time)])
