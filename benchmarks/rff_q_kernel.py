"""An episode of RFF-Q on mountain car as one kernel of a GPU, beside the engine's program.

In the engine, a step is some 24 kernels, each of which waits for the one before. Here a lane is one program
of a kernel written in Pallas: weights and frequencies stay in registers for all steps of the episode, and
the random numbers are drawn before. `bojax` does not use it.

Without a GPU, the kernel is interpreted, and only compared with a loop of JAX:

    python benchmarks/rff_q_kernel.py --runs 2 --steps 10
"""

import argparse
import math
import time
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from timing import median_seconds, on_gpu

from bojax.engine.build import build
from bojax.envs.settings import MountainCar
from bojax.experiments.settings import Learning
from bojax.learning.settings import RFFQ, RandomFourierFeatures
from bojax.numerics.lanes import LANES
from bojax.numerics.pallas import imported, launch
from bojax.problems.pomdp.mountain_car import HIGH, LOW


class Step:
    """A step of RFF-Q on mountain car, in operations that a kernel has, too."""

    def __init__(self, run, num_angles: int):
        env, learner = run.env, run.learner
        self.power, self.gravity, self.goal = (float(x) for x in (env.power, env.gravity, env.goal_position))
        self.discount, self.rate = float(learner.discount), float(learner.learning_rate)
        self.epsilon, self.num_actions = float(learner.epsilon), learner.num_actions
        self.num_angles = num_angles

    def values(self, features, weights, position, velocity, actions):
        """Q of several actions, `[J]`."""
        (f0, f1, fa), (c, s) = features, weights
        angles = self._of_state(f0, f1, position, velocity) - jnp.arctan2(s, c)
        angles = angles[None, :] + _unit(actions, -1.0, 1.0)[:, None] * fa[None, :]
        return jnp.sum(jnp.sqrt(c * c + s * s)[None, :] * jnp.cos(angles), axis=1) / math.sqrt(
            self.num_angles
        )

    def __call__(self, features, weights, position, velocity, is_random, place, before, after):
        """Weights, position, velocity, action and whether the goal is reached after a step.

        Args:
            features: Frequencies of both observations and of the action, `[F]` each, padded by zeros.
            weights: Weights of the cosines and of the sines, `[F]` each.
            position: The position.
            velocity: The velocity.
            is_random: Whether the action is random, given as a number below 0.
            place: Number of the random action.
            before: Candidates of the action, `[J]`, padded by NaN.
            after: Candidates in the next state, `[J]`, padded by NaN.
        """
        (f0, f1, fa), (c, s) = features, weights
        number = jax.lax.iota(jnp.int32, before.shape[0])
        is_action, lowest = number < self.num_actions, -jnp.inf
        q = jnp.where(is_action, self.values(features, weights, position, velocity, before), lowest)
        best = jnp.min(jnp.where(q == jnp.max(q), number, before.shape[0]))
        chosen = jnp.where(is_random < self.epsilon, place, best)
        action = jnp.sum(jnp.where(number == chosen, before, 0.0))
        moved = velocity + (action * self.power - self.gravity * jnp.cos(3.0 * position))
        moved = jnp.minimum(jnp.maximum(moved, LOW[1]), HIGH[1])
        there = jnp.minimum(jnp.maximum(position + moved, LOW[0]), HIGH[0])
        moved = jnp.where((there == LOW[0]) & (moved < 0.0), 0.0, moved)
        is_goal = there >= self.goal
        most = jnp.max(jnp.where(is_action, self.values(features, weights, there, moved, after), lowest))
        target = jnp.where(is_goal, 1.0, self.discount * most)
        angles = self._of_state(f0, f1, position, velocity) + _unit(action, -1.0, 1.0) * fa
        is_feature = jax.lax.iota(jnp.int32, c.shape[0]) < self.num_angles
        amplitude = jnp.where(is_feature, jnp.full(c.shape, self.num_angles**-0.5, c.dtype), 0.0)
        cosines, sines = amplitude * jnp.cos(angles), amplitude * jnp.sin(angles)
        norm = jnp.sum(cosines * cosines + sines * sines)
        step = self.rate / norm * (target - jnp.sum(cosines * c + sines * s))
        return (c + step * cosines, s + step * sines), there, moved, action, is_goal

    def _of_state(self, f0, f1, position, velocity):
        return f0 * _unit(position, LOW[0], HIGH[0]) + f1 * _unit(velocity, LOW[1], HIGH[1])


def _unit(x, low: float, high: float):
    return (x - low) * (1.0 / (high - low))


def draws_of(key, steps: int, num_actions: int, padded: int):
    """The random numbers of an episode: of the choice, `[T, 2]`, and both sets of candidates, `[T, J]`."""
    u = jax.random.uniform(key, (steps, 2 + 2 * num_actions), jnp.float32)
    actions = jnp.pad(
        2.0 * u[:, 2:].reshape(steps, 2, num_actions) - 1.0, ((0, 0), (0, 0), (0, padded - num_actions))
    )
    return u[:, :2], actions[:, 0], actions[:, 1]


def as_scan(step: Step, features, weights, start, choice, before, after):
    """An episode as a loop of JAX; weights and the rows of all steps."""

    def body(carry, drawn):
        weights, position, velocity, is_over = carry
        (is_random, u), *candidates = drawn
        place = (u * step.num_actions).astype(jnp.int32)
        new = step(features, weights, position, velocity, is_random, place, *candidates)
        after, there, moved, action, is_goal = new
        new = jax.tree.map(lambda a, b: jnp.where(is_over, b, a), (after, there, moved), carry[:3])
        row = jnp.stack([new[1], new[2], jnp.where(is_over, 0.0, action)])
        return (*new, is_over | is_goal), row

    drawn = (choice[:, 0], choice[:, 1]), before, after
    (weights, *_), rows = jax.lax.scan(
        body, (weights, start, jnp.zeros_like(start), jnp.asarray(False)), drawn
    )
    return (*weights, rows)


def as_kernel(step: Step, features, weights, start, choice, before, after, warps: int):
    """The same as one kernel."""
    pallas, _ = imported()
    steps, size = len(choice), features[0].shape[0]

    def kernel(f0, f1, fa, c, s, start, choice, before, after, c_out, s_out, rows):
        features = f0[:], f1[:], fa[:]

        def body(carry):
            t, weights, position, velocity, _ = carry
            place = (choice[t, 1] * step.num_actions).astype(jnp.int32)
            candidates = before[pallas.ds(t, 1), :][0], after[pallas.ds(t, 1), :][0]
            new = step(features, weights, position, velocity, choice[t, 0], place, *candidates)
            weights, position, velocity, action, is_goal = new
            rows[t, 0], rows[t, 1], rows[t, 2] = position, velocity, action
            return t + 1, weights, position, velocity, is_goal.astype(jnp.int32)

        first = jnp.int32(0), (c[:], s[:]), start[0], jnp.float32(0.0), jnp.int32(0)
        last = jax.lax.while_loop(lambda carry: (carry[0] < steps) & (carry[4] == 0), body, first)
        c_out[:], s_out[:] = last[1]

    shape = jax.ShapeDtypeStruct((size,), jnp.float32)
    results = [shape, shape, jax.ShapeDtypeStruct((steps, 3), jnp.float32)]
    args = (*features, *weights, start[None], choice, before, after)
    return tuple(launch(kernel, results, *args, name="rff_q_episode", warps=warps))


def main() -> None:
    """Compare the results and the times."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--features", type=int, default=300, help="random Fourier features (300)")
    parser.add_argument("--runs", type=int, nargs="+", default=[200, 1000], help="runs at once (200 1000)")
    parser.add_argument("--steps", type=int, default=500, help="steps of an episode (500)")
    parser.add_argument("--warps", type=int, default=4, help="warps of a lane in the kernel (4)")
    parser.add_argument("--repeats", type=int, default=7, help="repeats, of which the median is printed (7)")
    args = parser.parse_args()
    features = RandomFourierFeatures(action_lengthscale=10.0, num_features=args.features)
    # As in bench_emu_q: the car is too weak to leave the valley, so that episodes have full length
    learner = RFFQ(features=features, initial_weight=0.1)
    env = MountainCar(max_steps=args.steps, power=1e-5)
    run = build(Learning(dtype="float32", env=env, learner=learner, episodes=1), "float32")
    angles = args.features // 2
    step, padded = Step(run, angles), 1 << (angles - 1).bit_length()

    def prepare(index):
        key = jax.random.fold_in(jax.random.key(0), index)
        carry = run.init(key)
        state = carry.learner
        drawn = jnp.concatenate([state.features.state_frequencies, state.features.action_frequencies], axis=1)
        frequencies = tuple(jnp.pad(drawn[:angles].T, ((0, 0), (0, padded - angles))))
        weights = tuple(jnp.pad(w, (0, padded - angles)) for w in jnp.split(state.weights, 2))
        start = jax.random.uniform(key, (), jnp.float32, -0.6, -0.4)
        return carry, (key, frequencies, weights, start)

    def episode(way):
        def play(key, frequencies, weights, start):
            draws = draws_of(key, args.steps, step.num_actions, 16)
            return way(step, frequencies, weights, start, *draws)

        return jax.jit(jax.vmap(play))

    def engine(carry):
        carry, records = run.advance(carry)
        return carry.learner.weights, records.tables["steps"]["observation_0"]

    for runs in args.runs:
        carry, given = jax.block_until_ready(
            jax.jit(jax.vmap(prepare, axis_name=LANES))(jnp.arange(runs, dtype=jnp.int32))
        )
        ways = {
            "engine": (eqx.filter_jit(jax.vmap(engine, axis_name=LANES)), (carry,)),
            "scan": (episode(as_scan), given),
            "kernel": (episode(partial(as_kernel, warps=args.warps)), given),
        }
        results, seconds = {}, {}
        for name, (function, given_to) in ways.items():
            start = time.perf_counter()
            results[name] = jax.block_until_ready(function(*given_to))
            print(f"{runs} runs, {name}: first call {time.perf_counter() - start:.1f} s", flush=True)
            if on_gpu():
                seconds[name] = median_seconds(lambda f=function, g=given_to: f(*g), args.repeats)
                rate, ratio = runs * args.steps / seconds[name], seconds["engine"] / seconds[name]
                print(f"    {seconds[name]:.5f} s, {rate:,.0f} steps/s, x{ratio:.1f}")
        for name, a, b in zip(("cosines", "sines", "rows"), results["scan"], results["kernel"], strict=True):
            a, b = np.asarray(a), np.asarray(b)
            assert len(np.unique(b.reshape(runs, -1), axis=0)) == runs, "two runs gave the same result"
            error = np.abs(a - b).reshape(runs, -1).max(axis=1)
            spread = f"median {np.median(error):.1e}, largest {error.max():.1e}"
            print(f"    {name}: largest difference of a run to the loop: {spread}")


if __name__ == "__main__":
    main()
