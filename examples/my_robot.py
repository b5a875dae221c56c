"""Monitor a field with a robot of my own: plan a path, drive it, learn from the samples, plan again."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import bojax
from bojax.motions.base import place


def drive(path):
    """Stands for the robot: where it took samples, their values, and its pose at the end."""
    points = path[:, :2]
    return points, np.exp(-np.sum((points - 4.0) ** 2, axis=1)), path[-1]


jax.config.update("jax_enable_x64", True)
problem = bojax.part("monitoring", domain=(0.0, 0.0, 6.0, 6.0), field=None, max_steps=10)
planner = bojax.part("sbo", iterations=30, depth=2)
plan = eqx.filter_jit(planner.plan)
key = jax.random.key(0)
belief = problem.prior(key, problem.reset(key), planner.motions.num_samples)
belief = replace(belief, pose=jnp.asarray([1.0, 1.0, 0.8]))  # where the robot is: x, y in m, heading in rad
for step in range(10):
    path = place(plan(jax.random.fold_in(key, step), problem, belief).path, belief.pose)
    points, values, pose = drive(np.asarray(path))
    belief = belief.after(belief.posterior.extend(points, values), pose)

print("samples:", belief.posterior.count)
print("pose:", belief.pose)
mean, variance = belief.posterior.predict([[4.0, 4.0]])
print("field at the peak:", mean, "standard deviation:", jnp.sqrt(variance))
