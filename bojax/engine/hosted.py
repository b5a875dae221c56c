"""A static group whose environment steps on the host, while learner and bookkeeping are compiled.

An episode begins with a reset by a seed that follows from the run's key, so that nothing of the environment
has to be kept between episodes: a checkpoint is the same as that of a compiled group.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, PyTree

from bojax.engine.batch import BY_LANE, SAME, Compiled, Lanes, Status, outcome, total
from bojax.engine.groups import StaticGroup
from bojax.envs.base import TimeStep
from bojax.experiments.base import Carry
from bojax.experiments.learning import LearningRun
from bojax.numerics.lanes import LANES


class Hosted(Compiled):
    """The programs of one static group of learning runs, with a vector environment on the host."""

    def __init__(self, group: StaticGroup, mesh: Mesh, lanes_per_device: int, seed: int, *, snapshots: bool):
        self._mesh = mesh
        super().__init__(group, mesh, lanes_per_device, seed, snapshots=snapshots)
        run = group.experiment(jax.tree.map(jnp.asarray, group.swept_at(np.asarray(0))), self._shared)
        assert isinstance(run, LearningRun)
        self._num_tests, self._block = run.tests, run.learner.block
        self._open(run)

    def _open(self, run: LearningRun) -> None:
        self._env: Any = run.env
        self._dtype = run.learner.exploration_weight.dtype
        self._vector = self._env.make_vector(self.num_lanes)

    def advance(self, carry: Carry, lanes: Lanes) -> tuple[Carry, dict[str, dict[str, Array]], Status]:
        """One episode of every lane, with its tests."""
        trial = self._begin(lanes, carry, *self._reset(lanes, carry, 0))
        step = 0
        while np.asarray(trial.is_active).any():
            chosen = self._act(lanes, carry, trial, self._all(step))
            trial = self._learn(lanes, carry, trial, chosen, self._step(chosen[0]), self._all(step))
            step += 1
            if step % self._block == 0:
                trial = self._consolidate(lanes, trial)
        trial = self._consolidate(lanes, trial)
        learner = self._end(lanes, carry, trial)
        tests = [self._test(lanes, carry, learner, number + 1) for number in range(self._num_tests)]
        rows = (
            {name: jnp.stack([test[name] for test in tests], axis=1) for name in tests[0]} if tests else None
        )
        after, tables, is_done, steps = self._close(lanes, carry, trial, learner, rows, lanes.is_real)
        return after, tables, total(is_done, steps, lanes.is_real)

    def _compile_advance(self, compiled: Callable, specs: tuple, *inputs: Any) -> Any:
        """The pieces of an episode; each is compiled when it is first called."""
        del compiled, specs, inputs
        self._seeds = self._piece(_seeds)
        self._begin = self._piece(_begin)
        self._act = self._piece(_act)
        self._learn = self._piece(_learn)
        self._consolidate = self._piece(lambda run, trial: run.consolidate(trial))
        self._end = self._piece(lambda run, carry, trial: run.end_episode(carry, trial, run.balance(carry)))
        self._close = self._piece(_close)
        self._begin_test = self._piece(_begin_test)
        self._act_in_test = self._piece(_act_in_test)
        self._watch = self._piece(lambda run, trial, transition: run.take(trial, transition, None)[0])
        self._test_row = self._piece(lambda run, carry, trial: run.test_row(carry, trial))

    def _piece(self, function: Callable) -> Callable:
        """`function(run, *arrays)` of one lane, for every lane."""

        def batched(swept: PyTree, shared: PyTree, arrays: tuple) -> PyTree:
            def one(swept, arrays):
                return function(self._group.experiment(swept, shared), *arrays)

            return jax.vmap(one, axis_name=LANES)(swept, arrays)

        program = jax.jit(
            jax.shard_map(
                batched,
                mesh=self._mesh,
                in_specs=(BY_LANE, SAME, BY_LANE),
                out_specs=BY_LANE,
                check_vma=False,
            )
        )
        return lambda lanes, *arrays: program(lanes.swept, self._shared, arrays)

    def _test(self, lanes: Lanes, carry: Carry, learner: PyTree, number: int) -> dict[str, Array]:
        trial = self._begin_test(lanes, carry, *self._reset(lanes, carry, number))
        step = 0
        while np.asarray(trial.is_active).any():
            action = self._act_in_test(lanes, carry, learner, trial, self._all(step), self._all(number))
            trial = self._watch(lanes, trial, self._step(action))
            step += 1
        return self._test_row(lanes, carry, trial)

    def _reset(self, lanes: Lanes, carry: Carry, number: int) -> tuple[Array]:
        seeds = np.asarray(self._seeds(lanes, carry, self._all(number)))
        observation, _ = self._vector.reset(seed=seeds.tolist())
        return (self._put(observation),)

    def _step(self, action: Array) -> TimeStep:
        observation, reward, terminated, truncated, _ = self._vector.step(np.asarray(action))
        reward, terminated = self._put(reward), self._put(terminated)
        return TimeStep(
            observation=self._put(observation),
            reward=reward,
            terminated=terminated,
            truncated=self._put(truncated),
            success=self._env.is_success(reward, terminated),
        )

    def _put(self, values: Any) -> Array:
        """Something of every lane, on the devices, in the precision of the learner."""
        values = np.asarray(values)
        if values.dtype.kind == "f":
            values = values.astype(self._dtype)
        elif values.dtype.kind in "iu":
            values = values.astype(np.int32)
        return jax.device_put(values, self._by_lane)

    def _all(self, number: int) -> Array:
        return self._put(np.full(self.num_lanes, number))


def _seeds(run: LearningRun, carry, number):
    return jax.random.bits(run.reset_key(carry, number), dtype=jnp.uint32) >> 1


def _begin(run: LearningRun, carry, observation):
    return run.begin(carry, None, observation)


def _begin_test(run: LearningRun, carry, observation):
    return run.begin(carry, None, observation, is_test=True)


def _keys(run: LearningRun, carry, step, number):
    slot = step % run.learner.block
    return jax.random.wrap_key_data(run.keys(carry, step - slot, number)[slot])


def _act(run: LearningRun, carry, trial, step):
    key = _keys(run, carry, step, 0)[0]
    return run.learner.act(key, trial.learner, trial.observation, run.balance(carry))


def _act_in_test(run: LearningRun, carry, learner, trial, step, number):
    return run.learner.act(_keys(run, carry, step, number)[0], learner, trial.observation, run.exploiting)[0]


def _learn(run: LearningRun, carry, trial, chosen, transition, step):
    key, slot = _keys(run, carry, step, 0)[2], step % run.learner.block
    return run.go_on(key, trial, run.balance(carry), chosen, (None, transition), step, slot)


def _close(run: LearningRun, carry, trial, learner, tests, is_real):
    return outcome(run, carry, *run.close(carry, trial, learner, tests), is_real)
