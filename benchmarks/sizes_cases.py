"""What bench_sizes.py measures: the sizes of each curve, and the seconds of one size."""

import contextlib
import io
import itertools
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import emu_q_timings
import field_timings
import jax
import jax.numpy as jnp
import kcbts_timings
import numpy as np
from bench_sizes import CURVES
from timing import Row, median_seconds, time_runs

from bojax.acquisition.bayesian_optimisation import BayesianOptimisation
from bojax.acquisition.functions import LogExpectedImprovement
from bojax.cli.main import main as bojax
from bojax.engine.build import build
from bojax.envs.spaces import Box
from bojax.experiments.settings import Planning
from bojax.learning.base import ExplorationState
from bojax.learning.settings import EMUQ, RandomFourierFeatures
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import RBF, Matern52
from bojax.planning.settings import KCBTS, PFTDPW, POMCPOW, GaussianProcessProposal
from bojax.problems import particles
from bojax.problems.pomdp.settings import LightDarkNd, VdpTag
from bojax.surveys.league.fields import SQUARE
from bojax.surveys.mission import Mission

jax.config.update("jax_enable_x64", True)

Seconds = tuple[float, float]
"""Seconds of compilation, and of the measured work."""


@dataclass(frozen=True)
class Case:
    """A curve: what is measured, at which sizes, and how; `measure` takes a size and a number of repeats."""

    what: str
    sizes: Sequence[int]
    measure: Callable[[int, int], Seconds]


def of_program(program: Callable[..., Any], repeats: int, prepare: Callable | None = None) -> Seconds:
    """Seconds of a compiled function of the number of a run."""
    return _of_row(time_runs("", program, 1, 1, 1, repeats, prepare))


def of_host(function: Callable[[], Any], repeats: int) -> Seconds:
    """Seconds of a function that compiles what it needs; the first call counts as compilation."""
    first, seconds = median_seconds(function, 1), median_seconds(function, repeats)
    return max(first - seconds, 0.0), seconds


def _of_row(row: Row) -> Seconds:
    return row.compile_seconds, row.seconds


def optimisation(size: int, repeats: int) -> Seconds:
    """30 evaluations of a paraboloid in as many dimensions as the size."""
    learner = BayesianOptimisation(
        kernel=Matern52(jnp.asarray(0.5)),
        acquisition=LogExpectedImprovement(0.0),
        noise_variance=1e-4,
        low=-jnp.ones(size),
        high=jnp.ones(size),
        capacity=30,
    )

    def run(index):
        return learner.maximise(
            jax.random.fold_in(jax.random.key(0), index), lambda _, x: -jnp.sum(x**2), 30
        )[1]

    return of_program(run, repeats)


def greedy_action(size: int, repeats: int) -> Seconds:
    """200 decisions of EMU-Q, refined by pattern search, in as many dimensions of the action as the size."""
    settings = EMUQ(features=RandomFourierFeatures(num_features=300), refine_steps=8)
    learner: Any = build(settings, "float32")
    unit = jnp.ones(max(size, 4), jnp.float32)
    observations, actions = Box(-unit[:4], unit[:4]), Box(-unit[:size], unit[:size])
    exploring = ExplorationState(jnp.ones((), jnp.float32), jnp.asarray(True))

    def run(index):
        key = jax.random.fold_in(jax.random.key(0), index)
        state = learner.init(key, observations, actions, 1)

        def decide(x, key):
            action, value = learner.act(key, state, x, exploring)
            return jnp.cos(x + action[0] + value), action

        return jax.lax.scan(decide, unit[:4], jax.random.split(key, 200))[1]

    return of_program(run, repeats)


def emu_q_steps(size: int, repeats: int) -> Seconds:
    """200 online steps of EMU-Q."""
    return _of_row(emu_q_timings.steps_row(_learning(size, repeats), 1, "EMU-Q"))


def emu_q_refit(size: int, repeats: int) -> Seconds:
    """The direct refit of 1,000 transitions with 3 policies."""
    return _of_row(emu_q_timings.refit_row(_learning(size, repeats), 1, "direct"))


def _learning(features: int, repeats: int) -> Namespace:
    given = {"features": features, "repeats": repeats, "runs": 1, "steps": 200, "transitions": 1000}
    return Namespace(sweeps=3, dtype="float32", seed=0, **given)


def parking_runs(size: int, repeats: int) -> Seconds:
    """The command `bojax run parking`, 3 plans a run; the first time fills the cache of programs."""
    silent = io.StringIO()
    with (
        tempfile.TemporaryDirectory() as place,
        contextlib.redirect_stdout(silent),
        contextlib.redirect_stderr(silent),
    ):
        folders = itertools.count()

        def command() -> None:
            quick = "planner.iterations=10 problem.max_steps=3 record.runs=0"
            words = f"run parking {quick} --runs {size}".split()
            code = bojax([*words, "--out", str(Path(place) / str(next(folders)))])
            if code:
                raise RuntimeError(f"bojax run: exit code {code}")

        return of_host(command, 1)


def parking_iterations(size: int, repeats: int) -> Seconds:
    """One plan of kCBTS on parking."""
    case = kcbts_timings.Case(0, Planning(planner=KCBTS(iterations=size)))
    return of_program(case.plan, repeats)


def belief_search(planner: Any, problem: Any, repeats: int) -> Seconds:
    """One plan for the initial belief of 1,000 particles."""
    search, problem = build(planner, "float32"), build(problem, "float32")

    def plan(run):
        keys = jax.random.split(jax.random.fold_in(jax.random.key(0), run))
        made = search.plan(keys[1], problem, particles.initial(problem, keys[0], 1000))
        return made.action, made.value

    return of_program(plan, repeats)


def pft_dimensions(size: int, repeats: int) -> Seconds:
    """300 iterations of PFT-DPW with actions proposed by a Gaussian process."""
    planner = PFTDPW(iterations=300, proposal=GaussianProcessProposal())
    return belief_search(planner, LightDarkNd(num_dims=size), repeats)


def pft_iterations(size: int, repeats: int) -> Seconds:
    """One plan of PFT-DPW on VDP Tag."""
    return belief_search(PFTDPW(iterations=size), VdpTag(), repeats)


def pomcpow_iterations(size: int, repeats: int) -> Seconds:
    """One plan of POMCPOW on VDP Tag."""
    return belief_search(POMCPOW(iterations=size), VdpTag(), repeats)


def field_observations(size: int, repeats: int) -> Seconds:
    """One plan of kCBTS on a field, with 30 iterations."""
    case = field_timings.Case(field_timings.settings("value", size, 30), 0, size)
    return of_program(case.plan, repeats, case.belief)


def gp_fit(size: int, repeats: int) -> Seconds:
    """`GaussianProcess.fit` and the prediction at 100 points."""
    rng = np.random.default_rng(0)
    x, queries = jnp.asarray(rng.uniform(size=(size, 2))), jnp.asarray(rng.uniform(size=(100, 2)))
    y = jnp.sin(6.0 * x).sum(axis=1)

    def fit(run):
        return GaussianProcess.fit(RBF(jnp.asarray(0.3)), 0.01, x, y + 0.0 * run).predict(queries)

    return of_program(fit, repeats)


def _mission(size: int) -> Mission:
    """A mission with as many measurements as the size."""
    rng = np.random.default_rng(0)
    x_min, y_min, x_max, y_max = SQUARE.bounds
    points = rng.uniform((x_min, y_min), (x_max, y_max), (size, 2))
    mission = Mission(SQUARE, 1e9, (x_min, y_min), spacing=1.0)
    mission.observe(points, rng.normal(size=size))
    return mission


def survey_map(size: int, repeats: int) -> Seconds:
    """The map of a mission at 1,000 points, from all measurements so far."""
    mission, rng = _mission(size), np.random.default_rng(1)
    points = rng.uniform(SQUARE.bounds[:2], SQUARE.bounds[2:], (1000, 2))
    return of_host(lambda: mission.predict(points), repeats)


def survey_stream(size: int, repeats: int) -> Seconds:
    """100 measurements, told one at a time, after as many as the size."""
    mission, rng = _mission(size), np.random.default_rng(1)

    def observe() -> None:
        for point in rng.uniform(SQUARE.bounds[:2], SQUARE.bounds[2:], (100, 2)):
            mission.observe(point[None], rng.normal(size=1))

    return of_host(observe, repeats)


_FUNCTIONS: dict[str, tuple[Callable[[int, int], Seconds], tuple[int, ...]]] = {
    "bo-dimensions": (optimisation, (1, 2, 4, 7)),
    "emu-q-dimensions": (greedy_action, (1, 2, 4, 7)),
    "pft-dimensions": (pft_dimensions, (2, 4, 7)),
    "emu-q-features": (emu_q_steps, (100, 200, 500, 1000, 2000)),
    "refit-features": (emu_q_refit, (100, 200, 500, 1000, 2000)),
    "runs": (parking_runs, (1, 10, 100, 1000, 10_000)),
    "cbts-iterations": (parking_iterations, (1000, 10_000, 100_000)),
    "pft-iterations": (pft_iterations, (1000, 10_000, 100_000)),
    "pomcpow-iterations": (pomcpow_iterations, (1000, 10_000, 100_000)),
    "field-observations": (field_observations, (192, 480, 1000, 2000)),
    "gp-observations": (gp_fit, (200, 500, 1000, 2000, 5000)),
    "survey-observations": (survey_map, (100, 300, 1000, 3000, 10_000)),
    "survey-stream": (survey_stream, (100, 300, 1000, 3000, 10_000)),
}

CASES = {
    name: Case((function.__doc__ or "").rstrip("."), sizes, function)
    for name, (function, sizes) in _FUNCTIONS.items()
}
"""The curves by name."""

if set(CASES) != set(CURVES):
    sys.exit("error: bench_sizes.py names other curves")
