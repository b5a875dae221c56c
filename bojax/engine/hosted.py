"""A static group of learning runs whose environments are stepped in Python between jitted functions.

Every episode resets its environment with a seed derived from the key of the run. No state of the environment
is kept between episodes, so a checkpoint has the same content as for a compiled group.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key, PyTree
from typing_extensions import override

from bojax.engine.batch import Lanes, Leaves, Programs, Status, checked_advance
from bojax.envs.base import TimeStep
from bojax.experiments.base import Carry, Experiment
from bojax.experiments.episode import Choice, EpisodeState
from bojax.experiments.learning import LearningRun
from bojax.numerics.lanes import LANES


class PhasePrograms(NamedTuple):
    """The methods of a `Phase`, compiled for all lanes.

    The first three arguments of each are the lanes, the carry, and the number of the episode: 0 for training,
    from 1 for tests.
    """

    seed: Callable[..., Array]
    begin: Callable[..., EpisodeState]
    act: Callable[..., Choice]
    apply: Callable[..., EpisodeState]
    flush: Callable[..., EpisodeState]


class Hosted(Programs):
    """The programs of one static group of learning runs with a vector environment on the host."""

    _is_compiled = False

    def _open(self, run: LearningRun) -> None:
        self._num_tests, self._tests_learn, self._block = run.tests, run.learns_in_tests, run.learner.block
        self._env: Any = run.env
        self._dtype = run.learner.exploration_weight.dtype
        self._vector = self._env.make_vector(self.num_lanes)

    @override
    def advance(self, carry: Leaves, lanes: Lanes) -> tuple[Leaves, dict[str, dict[str, Array]], Status]:
        """`LearningRun.advance` of every lane: a training episode and its test episodes."""
        carry = jax.tree.unflatten(self._carry, carry)
        episode = self._run_episode(self._training, lanes, carry, carry.learner, 0)
        learner = self._end_episode(lanes, carry, episode)
        tests = []
        for number in range(1, self._num_tests + 1):
            test = self._run_episode(self._test, lanes, carry, learner, number)
            tests.append(self._test_row(lanes, carry, self._all(number), test))
            if self._tests_learn:
                learner = self._end_test(lanes, carry, self._all(number), test)
        rows = (
            {name: jnp.stack([test[name] for test in tests], axis=1) for name in tests[0]} if tests else None
        )
        carry, tables, status = self._close(lanes, carry, episode, learner, rows)
        return jax.tree.leaves(carry), tables, status

    def _run_episode(
        self, phase: PhasePrograms, lanes: Lanes, carry: Carry, learner: PyTree, number: int
    ) -> EpisodeState:
        """`bojax.experiments.phases.run_episode` with a vector environment on the host."""
        call = (lanes, carry, self._all(number))
        episode = phase.begin(*call, learner, self._reset(phase, *call))
        step = 0
        while np.asarray(episode.is_active).any():
            choice = phase.act(*call, episode, self._all(step))
            time_step = self._step(choice.action)
            episode = phase.apply(*call, episode, choice, time_step, self._all(step))
            step += 1
            if step % self._block == 0:
                episode = phase.flush(*call, episode)
        return phase.flush(*call, episode)

    @override
    def _prepare(self, run: Experiment) -> None:
        """Open the environments and create the programs of an episode, each compiled at its first call."""
        assert isinstance(run, LearningRun)
        self._open(run)
        self._carry = jax.tree.structure(self._carry_of(self._no_lanes()))
        self._training = self._phase_programs(lambda run, carry, number: run.training(carry))
        self._test = self._phase_programs(lambda run, carry, number: run.test(carry, number))
        self._end_episode = self._program(lambda run, carry, episode: run.end_episode(carry, episode))
        self._end_test = self._program(lambda run, carry, number, test: run.end_test(carry, number, test))
        self._test_row = self._program(lambda run, carry, number, test: run.test_row(carry, number, test))
        self._close = self._program(
            lambda run, carry, *rest: checked_advance(run, carry, *run.close(carry, *rest))
        )

    def _phase_programs(self, phase_of: Callable) -> PhasePrograms:
        def program(method: Callable) -> Callable:
            """A program that calls `method(phase, carry, *rest)`."""
            return self._program(
                lambda run, carry, number, *rest: method(phase_of(run, carry, number), carry, *rest)
            )

        return PhasePrograms(
            seed=program(lambda phase, carry: seed_of(phase.reset_key)),
            begin=program(
                lambda phase, carry, learner, observation: phase.begin(
                    learner, None, observation, ~carry.is_done
                )
            ),
            act=program(lambda phase, carry, episode, step: phase.act(_keys(phase, step)[0], episode)),
            apply=program(
                lambda phase, carry, episode, choice, time_step, step: phase.apply(
                    _keys(phase, step)[2], episode, choice, None, time_step, step % phase.learner.block, step
                )
            ),
            flush=program(lambda phase, carry, episode: phase.flush(episode)),
        )

    def _program(self, function: Callable) -> Callable:
        """A program that applies `function(run, *arrays)`, written for one lane, to every lane."""

        def batched(swept: PyTree, shared: PyTree, arrays: tuple) -> PyTree:
            def one(swept, arrays):
                return function(self._group.experiment(swept, shared), *arrays)

            return jax.vmap(one, axis_name=LANES)(swept, arrays)

        program = jax.jit(batched)
        return lambda lanes, *arrays: program(lanes.swept, self._shared, arrays)

    def _reset(self, phase: PhasePrograms, lanes: Lanes, carry: Carry, number: Array) -> Array:
        """Reset the environments and return their observations."""
        seeds = np.asarray(phase.seed(lanes, carry, number))
        observation, _ = self._vector.reset(seed=seeds.tolist())
        return self._put(observation)

    def _step(self, action: Array) -> TimeStep:
        """Step the environments and return their time steps."""
        observation, reward, terminated, truncated, info = self._vector.step(np.asarray(action))
        told = info.get("success", np.zeros(self.num_lanes, bool))
        reward, terminated = self._put(reward), self._put(terminated)
        return TimeStep(
            observation=self._put(observation),
            reward=reward,
            terminated=terminated,
            truncated=self._put(truncated),
            success=self._env.is_success(reward, terminated, self._put(told)),
        )

    def _put(self, values: Any) -> Array:
        """Put the values of all lanes on the devices, in the precision of the learner."""
        values = np.asarray(values)
        if values.dtype.kind == "f":
            values = values.astype(self._dtype)
        elif values.dtype.kind in "iu":
            values = values.astype(np.int32)
        return jax.device_put(values, self._sharding)

    def _all(self, number: int) -> Array:
        return self._put(np.full(self.num_lanes, number))


def seed_of(key: Key[Array, ""]) -> Array:
    """The seed with which an environment on the host is reset, a number of 31 bits."""
    return jax.random.bits(key, dtype=jnp.uint32) >> 1


def _keys(phase, step):
    return jax.random.wrap_key_data(phase.step_keys(step[None])[0])
