"""Plan once: the first path that kCBTS would drive towards the parking spot."""

import equinox as eqx
import jax

import bojax
from bojax.motions.base import place

jax.config.update("jax_enable_x64", True)
problem, planner = bojax.part("parking"), bojax.part("kcbts", iterations=100)
key_start, key_reading, key_plan = jax.random.split(jax.random.key(0), 3)
world = problem.reset(key_start)  # the true pose: x, y in m, heading in rad
belief = problem.prior(key_reading, world, num_samples=10)  # of the planner: a noisy reading of the pose
plan = eqx.filter_jit(planner.plan)(key_plan, problem, belief)
print(place(plan.path, belief))  # ten poses along the path, [10, 3]
print(plan.value)  # mean simulated return of starting with this path
