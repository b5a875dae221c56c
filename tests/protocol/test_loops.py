"""What a user calls in a loop compiles nothing after the first pass, whatever kind of number it is given."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.acquisition.bayesian_optimisation import BayesianOptimisation
from bojax.acquisition.thompson import ThompsonSampling
from bojax.engine.build import build
from bojax.envs.gymnasium import GymnasiumEnv
from bojax.envs.gymnasium_vector import GymnasiumVectorEnv
from bojax.envs.settings import Chain, MountainCar
from bojax.models.bayesian_linear_regression import (
    BayesianLinearRegression,
    log_marginal_likelihood,
    maximise_evidence,
)
from bojax.models.estimators import BayesianLinearRegressor, GaussianProcessRegressor
from bojax.models.evidence import relearn
from bojax.models.gaussian_process import GaussianProcess
from bojax.problems.field_belief import FieldBelief
from tests.compiling import COMPILATION

KINDS = (
    float,
    np.float32,
    np.float64,
    round,
    np.int64,
    np.asarray,
    jnp.asarray,
    lambda v: np.asarray([v])[0],
)
"""Kinds of numbers that an objective may return."""

DESIGN = np.random.default_rng(0).normal(size=(12, 3))
KEY = jax.random.key(0)

_compiled = itertools.count()


def _count(event, *_, **__):
    if event == COMPILATION:
        next(_compiled)


jax.monitoring.register_event_duration_secs_listener(_count)


def gaussian_process():
    gp = GaussianProcess.fit("rbf", 0.1, [0.0, 1.0], [0.0, 1.0], capacity=40)

    def step(number, y):
        held = gp.update([y], y, 0.1 + number).extend([number, 2.0], [y, 0.0], [True, False], [0.2, 0.3])
        held.predict([number])
        held.predict_gradient([number])
        held.sample(jax.random.fold_in(KEY, number), [number, 1.0], 2)
        held.log_marginal_likelihood()
        GaussianProcess.fit("rbf", 0.1 + number, [number, 1.0], [y, 1.0])
        relearn(held, jax.random.fold_in(KEY, number), num_starts=2, num_steps=2)

    return step


def linear_regression():
    blocks = BayesianLinearRegression.prior(3, 1.0, 2.0, block=100)

    def step(number, y):
        features = list(DESIGN[number % 12])
        blocks.update(features, y, step_in_block=number).flush()
        model = blocks.update(features, y, sample_weight=y).update_batch(DESIGN, DESIGN[:, 0] + number)
        model.predict([features])
        BayesianLinearRegression.fit(DESIGN, DESIGN[:, 1] + number, 1.0 + number, y + 1)
        log_marginal_likelihood(DESIGN, DESIGN[:, 1], 1.0 + number, y + 1)
        maximise_evidence(DESIGN, DESIGN[:, 1] + number)

    return step


def estimators():
    gp, line = GaussianProcessRegressor(num_starts=2, num_steps=2), BayesianLinearRegressor()

    def step(number, y):
        gp.fit(DESIGN + number, DESIGN[:, 0]).predict([[y, y, 1.0]], return_std=True)
        line.fit(DESIGN + number, DESIGN[:, 0]).predict([[y, y, 1.0]])

    return step


def optimisation(acquisition="ei"):
    sizes = {"capacity": 40, "num_candidates": 16, "num_initial": 2, "refine_steps": 2}
    search = BayesianOptimisation("rbf", acquisition, 1e-3, [0.0], [1.0], relearn_every=2, **sizes)
    states = [search.init(KEY)]

    def step(number, y):
        x = search.ask(states[-1])
        given = (x, np.asarray(x), x.tolist())[number % 3]
        states.append(search.tell(states[-1], given, y))
        search.best(states[-1])
        search.predict(states[-1], [y])
        search.score(states[-1], [y])
        search.sample(jax.random.fold_in(KEY, number), states[-1], [y], 2)

    return step


def belief():
    posterior = GaussianProcess.prior("rbf", 0.1, 80, 2)
    zero = jnp.zeros((), jnp.int32)
    beliefs = [FieldBelief(jnp.zeros(3), posterior, zero, jnp.zeros(41, jnp.int32), KEY, 2)]

    def step(number, y):
        posterior = beliefs[-1].posterior.extend([[number, float(y)], [2.0, 1.0]], [y, 1.0])
        pose = ([y, 0.0, 1.0], np.asarray([1.0, 0.0, number]), jnp.zeros(3))[number % 3]
        beliefs.append(beliefs[-1].after(posterior, pose))

    return step


def environments():
    car, chain = (GymnasiumEnv(build(each())) for each in (MountainCar, Chain))
    cars = GymnasiumVectorEnv(build(MountainCar()), num_envs=2)

    def step(number, y):
        for env in (car, chain, cars):
            env.reset(seed=number)
        car.step([y])
        chain.step(int(y) % 2)
        cars.step([[y], [y]])

    return step


LOOPS = {
    "Gaussian process": gaussian_process,
    "linear regression": linear_regression,
    "estimators": estimators,
    "Bayesian optimisation": optimisation,
    "Thompson sampling": lambda: optimisation(ThompsonSampling(16)),
    "belief": belief,
    "environments": environments,
}


@pytest.mark.filterwarnings("ignore::UserWarning")  # short searches end anywhere
@pytest.mark.parametrize("name", LOOPS)
def test_a_second_pass_compiles_nothing(name, usual_jax):
    jax.config.update("jax_enable_x64", True)
    step, numbers = LOOPS[name](), itertools.count()
    counts = []
    for _ in range(2):
        for kind in KINDS:
            number = next(numbers)
            step(number, kind(0.1 * number + 1.0))
        counts.append(next(_compiled))
    assert counts[0] > 0 and counts[1] == counts[0] + 1, f"{counts[1] - counts[0] - 1} programs"
