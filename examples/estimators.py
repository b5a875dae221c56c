"""Models with the interface of scikit-learn, on NumPy arrays."""

import numpy as np

from bojax.models.estimators import BayesianLinearRegressor, GaussianProcessRegressor

rng = np.random.default_rng(0)
X = rng.uniform(-2.0, 2.0, (60, 1))
y = np.sin(2.0 * X[:, 0]) + 0.1 * rng.normal(size=60)

gp = GaussianProcessRegressor().fit(X, y)
mean, std = gp.predict([[0.5]], return_std=True)
print("Gaussian process:", mean, std)
print("score of the process:", gp.score(X, y))  # R^2

line = BayesianLinearRegressor().fit(X, y)
mean, std = line.predict([[0.5]], return_std=True)
print("line:", mean, std)
print("score of the line:", line.score(X, y))
