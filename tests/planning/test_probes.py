"""Problems whose answer is known."""

import jax
import jax.numpy as jnp
import pytest
from jaxtyping import Array, Float, Key

from bojax.motions.base import Pose
from bojax.problems.pose import Outcome, PoseProblem
from tests.planning.samples import f64, gps_abt, kcbts, kernel_trajectories, path_of, plan, sbo
from tests.tiers import by_tier


class Target(PoseProblem):
    """The reward is how close a path ends to a target: one peak over the actions."""

    position_noise: Float[Array, ""]
    heading_noise: Float[Array, ""]
    target: Float[Array, "2"]
    max_steps: int = 1

    def start(self, key: Key[Array, ""]) -> Pose:
        del key
        return jnp.zeros_like(self.target, shape=(3,))

    def outcome(self, start: Pose, path: Float[Array, "S 3"]) -> Outcome:
        del start
        distance = jnp.sqrt(jnp.sum((path[-1, :2] - self.target) ** 2))
        no = jnp.zeros((), bool)
        return Outcome(-distance, no, no, no, _end(path))


class Detour(PoseProblem):
    """Left pays 1 at once; right pays nothing at first and 10 with the second action."""

    position_noise: Float[Array, ""]
    heading_noise: Float[Array, ""]
    max_steps: int = 2

    def start(self, key: Key[Array, ""]) -> Pose:
        del key
        return jnp.zeros_like(self.position_noise, shape=(3,))

    def outcome(self, start: Pose, path: Float[Array, "S 3"]) -> Outcome:
        end = path[-1]
        is_first = jnp.sum(jnp.abs(start[:2])) == 0.0
        greedy = jnp.where(end[1] > 0.1, 1.0, 0.0)
        patient = jnp.where((start[1] < -0.1) & (end[1] < start[1]), 10.0, 0.0)
        no = jnp.zeros((), bool)
        return Outcome(jnp.where(is_first, greedy, patient), no, no, no, _end(path))


def _end(path):
    return jnp.asarray(path.shape[0] - 1, jnp.int32)


START = (0.0, 0.0, 0.0)
PARAMS = {"ahead": (0.0, 0.0, 0.0), "left": (0.5, 0.4, 0.3), "right": (-0.8, -0.2, 0.6)}


@pytest.mark.parametrize("params", PARAMS.values(), ids=PARAMS)
@pytest.mark.parametrize("acquisition", by_tier(["ucb", "log-ei"], normal=["log-ei"]))
def test_kcbts_finds_the_one_peak(acquisition, params):
    # 30 actions out of a box of three dimensions; the ends of random paths miss by 0.2 on average.
    target = path_of(kernel_trajectories(), f64(params))[-1, :2]
    problem = Target(f64(0.0), f64(0.0), target)
    planner = kcbts(acquisition, depth=1, iterations=60, max_actions=30)
    misses = [-float(plan(planner, jax.random.key(seed), problem, f64(START)).reward) for seed in range(5)]
    assert max(misses) < 0.1


def test_gps_abt_finds_the_one_peak():
    target = path_of(kernel_trajectories(num_segments=2), f64((0.5, 0.4)))[-1, :2]
    problem = Target(f64(0.0), f64(0.0), target)
    result = plan(gps_abt(depth=1, iterations=120, exploration=0.1), jax.random.key(0), problem, f64(START))
    assert float(result.reward) > -0.1


@pytest.mark.parametrize("make", by_tier([sbo, kcbts], normal=[sbo]), ids=["sbo", "kcbts"])
def test_two_steps_ahead_the_greedy_action_is_wrong(make):
    problem = Detour(f64(0.0), f64(0.0))
    for seed in range(3):
        greedy = plan(make(depth=1), jax.random.key(seed), problem, f64(START))
        patient = plan(make(depth=2, iterations=120), jax.random.key(seed), problem, f64(START))
        assert greedy.path[-1, 1] > 0.1
        assert greedy.value == 1.0
        assert patient.path[-1, 1] < -0.1
        assert patient.value > 5.0
