"""Field monitoring: what the world does, what it pays, and that a planner's model of it is exact."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import bojax
from bojax.config.errors import ConfigError
from bojax.engine.build import build
from bojax.fields.closed_form import Bumps, Step
from bojax.models.gaussian_process import GaussianProcess
from bojax.models.kernels import Matern32, Scaled
from bojax.models.means import ConstantMean
from bojax.motions.base import place
from bojax.problems.field_belief import Samples
from bojax.problems.field_errors import error_weights
from bojax.problems.settings import Monitoring
from bojax.problems.vehicles.base import Exact
from bojax.problems.vehicles.settings import WheeledRobot
from tests.planning.samples import FIELD, OBJECTIVES, f64, field_belief, monitoring
from tests.reference.bridge import reference_belief, reference_problem
from tests.reference.monitoring import segments_touch_boxes
from tests.tiers import by_tier

NUM, SIZE = 400, 6
WALLED = monitoring()
PROBLEMS = {
    "walls": WALLED,
    "walls, stays": monitoring(after_collision="stop"),
    "no walls": monitoring(walls=None, target_area=None),
}
each_problem = pytest.mark.parametrize("name", PROBLEMS)

values_of = eqx.filter_jit(lambda field, points: field.values(points))
gradients_of = eqx.filter_jit(lambda field, points: field.gradients(points))
grid_of = eqx.filter_jit(lambda problem: problem.grid())
weigh = jax.jit(error_weights, static_argnums=2)
predict = eqx.filter_jit(lambda posterior, points: posterior.predict(points))


def keys_of(seed, num=NUM):
    return jax.random.split(jax.random.key(seed), num)


def drives(num=NUM, seed=0):
    """Free poses, and wild paths of a metre."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform([0.0, 0.0, 0.0], [3.0, 2.4, 2.0 * np.pi], (3 * num, 3))
    point = poses[:, :2]
    is_walled = segments_touch_boxes(point, point, np.asarray(WALLED.walls)).any(axis=1)
    poses = poses[~is_walled][:num]
    heading = np.cumsum(rng.uniform(-0.6, 0.6, (num, SIZE)), axis=1)
    steps = np.stack([np.cos(heading), np.sin(heading)], axis=-1) / SIZE
    return poses, np.concatenate([np.cumsum(steps, axis=1), heading[..., None]], axis=-1)


@jax.jit
def execute(problem, keys, poses, paths):
    def one(key, pose, path):
        world = problem.reset(key)
        world = type(world)(pose, world.collisions + 2, world.gradient + 0.5)
        return problem.execute(jax.random.fold_in(key, 1), world, path)

    return jax.vmap(one)(keys, poses, paths)


def executed(problem, seed=0):
    poses, paths = drives()
    found = execute(problem, keys_of(seed), f64(poses), f64(paths))
    return poses, np.asarray(jax.vmap(place)(f64(paths), f64(poses))), jax.tree.map(np.asarray, found)


@each_problem
def test_a_path_is_driven_until_walls_or_border_stop_the_robot(name):
    problem = PROBLEMS[name]
    reference = reference_problem(problem)
    poses, paths, (after, samples, events) = executed(problem)
    expected = [reference.follow(pose, path) for pose, path in zip(poses, paths, strict=True)]
    number, collided, exited = (np.array(part) for part in zip(*expected, strict=True))
    np.testing.assert_array_equal(events.is_driven, np.arange(SIZE) < number[:, None])
    np.testing.assert_array_equal(after.collisions, 2 + collided)
    np.testing.assert_array_equal(events.exited, exited)
    np.testing.assert_allclose(events.reward, -5.0 * collided - 4.0 * exited)
    assert not np.any(events.terminated)
    # Where it was stopped it stays, and there it is.
    with_start = np.concatenate([poses[:, None], paths], axis=1)
    last = with_start[np.arange(NUM), number]
    np.testing.assert_allclose(events.driven[:, -1], last, atol=1e-14)
    np.testing.assert_allclose(after.vehicle[:, :2], last[:, :2], atol=1e-14)
    turned = np.pi * (collided | exited) * (problem.after_collision == "turn")
    np.testing.assert_allclose(
        np.exp(1j * after.vehicle[:, 2]), np.exp(1j * (last[:, 2] + turned)), atol=1e-12
    )
    assert np.all(after.vehicle[:, 2] >= 0.0) and np.all(after.vehicle[:, 2] <= 2.0 * np.pi)
    np.testing.assert_array_equal(samples.pose, after.vehicle)
    assert exited.sum() > 50 and (name == "no walls") == (collided.sum() == 0)
    assert len(set(number)) == SIZE + 1


def test_a_margin_widens_the_border_and_nothing_else():
    inner = monitoring(walls=None, target_area=None)
    margin = dataclasses.replace(inner, margin=f64(0.4))
    wide = dataclasses.replace(inner, domain=inner.domain + f64([-0.4, -0.4, 0.4, 0.4]))
    _, _, (_, _, events) = executed(inner)
    _, _, (_, _, found) = executed(margin)
    _, _, (_, _, expected) = executed(wide)
    np.testing.assert_array_equal(found.driven, expected.driven)
    np.testing.assert_array_equal(found.exited, expected.exited)
    assert 0 < np.sum(found.exited) < np.sum(events.exited)
    np.testing.assert_array_equal(grid_of(margin), grid_of(inner))
    draw = jax.jit(lambda problem, keys: jax.vmap(problem.arena.random_pose)(keys))
    np.testing.assert_array_equal(*(draw(problem, keys_of(2)) for problem in (margin, inner)))


def test_samples_are_the_field_with_noise_where_the_robot_came():
    _, _, (after, samples, events) = executed(monitoring(noise=0.1))
    np.testing.assert_array_equal(samples.points, events.driven[..., :2])
    np.testing.assert_array_equal(samples.is_taken, events.is_driven)
    points = f64(samples.points.reshape(-1, 2))
    noise = (samples.values.ravel() - values_of(FIELD, points))[samples.is_taken.ravel()] / 0.1
    assert len(noise) > 1000 and stats.kstest(noise, "norm").pvalue > 1e-3
    slope = np.linalg.norm(gradients_of(FIELD, points), axis=-1).reshape(NUM, SIZE)
    np.testing.assert_allclose(after.gradient, 0.5 + np.sum(slope * samples.is_taken, axis=1), atol=1e-12)


def test_reaching_the_target_area_is_success_and_passing_through_counts():
    _, _, (_, _, events) = executed(WALLED)
    low, high = np.asarray(WALLED.target_area).reshape(2, 2)
    points = events.driven[..., :2]
    is_there = np.all((points >= low) & (points <= high), axis=-1) & events.is_driven
    np.testing.assert_array_equal(events.success, is_there.any(axis=1))
    assert 0 < events.success.sum() < NUM
    # A robot that starts there and is stopped at once has reached nothing.
    is_stuck = ~events.is_driven.any(axis=1) & np.all((points[:, 0] >= low) & (points[:, 0] <= high), axis=-1)
    assert is_stuck.any() and not events.success[is_stuck].any()
    assert not executed(PROBLEMS["no walls"])[2][2].success.any()


def test_random_starts_are_uniform_over_the_free_space():
    starts = np.asarray(jax.jit(jax.vmap(WALLED.reset))(keys_of(0, 8000)).vehicle)
    x, y, heading = starts.T
    walls = np.asarray(WALLED.walls)
    assert not np.any(segments_touch_boxes(starts[:, :2], starts[:, :2], walls))
    assert stats.kstest(heading, "uniform", (0.0, 2.0 * np.pi)).pvalue > 1e-3
    # In each cell of a grid as many as the cell has free area.
    edges = [0.0, 0.6, 1.2, 1.4, 2.2, 3.0], [0.0, 1.0, 1.5, 2.4]
    counts, *_ = np.histogram2d(x, y, edges)
    area = np.outer(np.diff(edges[0]), np.diff(edges[1]))
    area[2, [0, 2]] = 0.0
    assert np.all(counts[area == 0.0] == 0)
    is_free = area > 0.0
    expected = len(x) * area[is_free] / area[is_free].sum()
    assert stats.chisquare(counts[is_free], expected).pvalue > 1e-3


def test_a_start_is_found_where_little_is_free():
    crowded = monitoring(walls=((0.0, 0.0, 3.0, 1.1), (0.0, 1.25, 3.0, 2.4)))
    y = np.asarray(jax.jit(jax.vmap(crowded.reset))(keys_of(1, 500)).vehicle)[:, 1]
    assert np.all((y > 1.1) & (y < 1.25))


@jax.jit
def update(problem, belief, key, keys, paths):
    """The world after some paths driven one after the other, and the belief and samples after each."""

    def drive(carry, inputs):
        world, belief = carry
        key, path = inputs
        world, samples, _ = problem.execute(key, world, path)
        belief = problem.update(belief, path, samples)
        return (world, belief), (belief, samples)

    (world, _), after = jax.lax.scan(drive, (problem.reset(key), belief), (keys, paths))
    return world, [jax.tree.map(lambda leaf, at=at: leaf[at], after) for at in range(len(paths))]


PRIOR = monitoring(
    start=(0.9, 1.2, 0.0), kernel=Scaled(Matern32(f64(0.7)), f64(2.0)), mean=ConstantMean(f64(0.4))
)
"""A problem whose prior is not its default; the tests of its beliefs share a program."""


@pytest.fixture(scope="module")
def updated():
    """The prior of `PRIOR`, and what comes of it on four paths."""
    _, paths = drives(4, seed=3)
    prior = PRIOR.prior(jax.random.key(0), PRIOR.reset(jax.random.key(1)), SIZE)
    return prior, *update(PRIOR, prior, jax.random.key(2), keys_of(0, 4), f64(paths))


def test_the_belief_is_the_prior_conditioned_on_the_samples_taken(updated):
    problem, (prior, world, beliefs) = PRIOR, updated
    assert prior.posterior.count == 0 and prior.posterior.y.shape == (problem.max_steps * SIZE,)
    np.testing.assert_array_equal(prior.pose, [0.9, 1.2, 0.0])
    x, y = np.zeros((0, 2)), np.zeros(0)
    queries = np.random.default_rng(0).uniform(0.0, 2.4, (30, 2))
    for step, (belief, samples) in enumerate(beliefs):
        x = np.concatenate([x, samples.points[samples.is_taken]])
        y = np.concatenate([y, samples.values[samples.is_taken]])
        assert (belief.step, belief.posterior.count) == (step + 1, len(x))
        expected = reference_belief(belief).refit(x, y)
        mean, covariance = expected.predict(queries)
        found = predict(belief.posterior, f64(queries))
        np.testing.assert_allclose(found[0], mean, atol=1e-9)
        np.testing.assert_allclose(found[1], np.diag(covariance), atol=1e-9)
    np.testing.assert_array_equal(belief.pose, world.vehicle)
    assert 0 < len(x) < problem.max_steps * SIZE  # some paths were cut short


def test_the_snapshot_has_the_belief_after_every_step(updated):
    problem, (prior, world, beliefs) = PRIOR, updated
    steps = [prior, *(belief for belief, _ in beliefs[:3])]
    snapshot = jax.jit(lambda belief: problem.snapshot(world, belief)["belief"])
    kept = [snapshot(belief) for belief in steps]
    for step in range(4):
        np.testing.assert_allclose(kept[3]["means"][step], kept[step]["mean"], atol=1e-6)
        np.testing.assert_allclose(kept[3]["stds"][step], kept[step]["std"], atol=1e-6)
        assert np.all(np.isnan(kept[step]["means"][step + 1 :]))
    assert kept[3]["means"].shape == (problem.max_steps + 1, problem.resolution, problem.resolution)
    assert kept[3]["means"].dtype == kept[3]["stds"].dtype == np.float32


def test_hyperparameters_are_learned_when_they_are_due_and_not_before():
    problem = monitoring(start=(0.5, 1.2, 0.0), walls=None, relearn_every=2, noise=0.02)
    belief = problem.prior(jax.random.key(0), problem.reset(jax.random.key(1)), SIZE)
    _, paths = drives(3, seed=5)
    _, beliefs = update(problem, belief, jax.random.key(2), keys_of(0, 3), f64(paths))
    first, second, third = (after.posterior for after, _ in beliefs)
    assert_same = lambda one, other: jax.tree.map(np.testing.assert_array_equal, one, other)  # noqa: E731
    assert_same((first.kernel, first.noise_variance), (problem.kernel, problem.noise_variance))
    assert_same((third.kernel, third.noise_variance), (second.kernel, second.noise_variance))
    assert second.kernel.kernel.lengthscale != problem.kernel.kernel.lengthscale
    # What is held is the posterior of all samples under what was learned, and more likely than before.
    both = f64(np.concatenate([samples.points for _, samples in beliefs[:2]]))
    values = f64(np.concatenate([samples.values for _, samples in beliefs[:2]]))
    taken = jnp.asarray(np.concatenate([samples.is_taken for _, samples in beliefs[:2]]))
    fit = jax.jit(
        lambda kernel, noise: GaussianProcess.prior(kernel, noise, 24, 2).extend(both, values, taken)
    )
    again = fit(second.kernel, second.noise_variance)
    np.testing.assert_allclose(again.inverse_cholesky, second.inverse_cholesky, atol=1e-9)
    before = fit(problem.kernel, problem.noise_variance)
    evidence = jax.jit(GaussianProcess.log_marginal_likelihood)
    assert evidence(second) > evidence(before)


@jax.jit
def pay(problem, objective, belief, keys, poses, paths):
    """What driving each path pays, and what the simulations of the path expect of it."""

    def one(key, pose, path):
        here = dataclasses.replace(belief, pose=pose)
        world = problem.reset(key)
        world = type(world)(pose, world.collisions, world.gradient)
        _, _, events = problem.execute(jax.random.fold_in(key, 1), world, path)
        root, node = problem.root(here, 3)
        sequence = jnp.stack([path, path[::-1], path])
        simulated = problem.simulate(jax.random.fold_in(key, 2), root, node, sequence, objective)
        alone = problem.simulate(jax.random.fold_in(key, 3), *problem.root(here, 1), path[None], objective)
        return problem.reward(objective, here, path, events), simulated.rewards, alone.rewards[0]

    return jax.vmap(one)(keys, poses, paths)


# Without an objective of its own, a planner has the task's: the value.
@pytest.mark.parametrize(
    "name",
    by_tier([*sorted(OBJECTIVES.keys() - {"value"}), "of the task"], normal=["gradient", "of the task"]),
)
@pytest.mark.parametrize("count", [0, 17])
def test_the_reward_is_what_the_samples_are_worth_under_the_belief_before_them(name, count):
    objective = OBJECTIVES.get(name)
    belief = field_belief(WALLED, (0.0, 0.0, 0.0), count)
    poses, paths = drives(100)
    paid, simulated, alone = map(
        np.asarray, pay(WALLED, objective, belief, keys_of(0, 100), f64(poses), f64(paths))
    )
    reference = reference_problem(WALLED, type("Planner", (), {"objective": objective}))
    start = reference_belief(belief)
    for index, (pose, path) in enumerate(zip(poses, paths, strict=True)):
        _, expected, _ = reference.drive(dataclasses.replace(start, pose=pose), path, np.zeros(SIZE))
        np.testing.assert_allclose(paid[index], expected, atol=1e-9)
    # The planner knows the world's geometry: what it simulates is what is paid.
    np.testing.assert_allclose(simulated[:, 0], paid, atol=1e-9)
    np.testing.assert_allclose(alone, paid, atol=1e-9)
    assert np.all(np.isfinite(simulated))


def test_what_is_imagined_differs_from_key_to_key_unless_it_is_the_mean():
    belief = field_belief(WALLED, (0.0, 0.0, 0.0), 5)
    poses, paths = (f64(np.repeat(part[3:4], 5, axis=0)) for part in drives(20))

    @jax.jit
    def rewards(problem, key, pose, path):
        root, node = problem.root(dataclasses.replace(belief, pose=pose), 3)
        return problem.simulate(key, root, node, jnp.stack([path, path[::-1], path]), None).rewards

    for imagined, number in (("sample", 5), ("mean", 1)):
        problem, keys = monitoring(imagined=imagined, walls=None), keys_of(0, 5)
        simulated = np.array([rewards(problem, *each) for each in zip(keys, poses, paths, strict=True)])
        assert len(np.unique(np.round(simulated[:, 0], 10))) == 1
        assert len(np.unique(np.round(simulated[:, 2], 10))) == number


FIELDS = {"bumps": FIELD, "step": Step(f64([1.5, 1.2]), f64(0.6), f64(1.0), f64(0.3))}


@pytest.mark.parametrize("field", FIELDS.values(), ids=FIELDS)
def test_the_weights_are_their_definitions(field):
    grid = np.asarray(grid_of(WALLED))
    values, gradients = (np.asarray(of(field, f64(grid))) for of in (values_of, gradients_of))
    norm = np.linalg.norm(gradients, axis=1)
    scaled = (gradients - gradients.min(axis=0)) / (gradients.max(axis=0) - gradients.min(axis=0))
    expected = {
        "value": (values - values.min()) / (values.max() - values.min()),
        "gradient-norm": (norm - norm.min()) / (norm.max() - norm.min()),
        "gradient": np.linalg.norm(scaled, axis=1),  # (3.7) as printed: signs included
    }
    for weighting, weights in expected.items():
        np.testing.assert_allclose(weigh(field, f64(grid), weighting), weights, atol=1e-12)


def test_of_a_constant_field_all_weights_are_equal():
    flat = Bumps(f64([0.0]), f64([[1.5, 1.2]]), f64([0.2]))
    for weighting, expected in (("value", 1.0), ("gradient-norm", 1.0), ("gradient", 2.0**0.5)):
        np.testing.assert_allclose(weigh(flat, grid_of(WALLED), weighting), expected)


@jax.jit
def score(problem, world, belief):
    return problem.score(world, belief)


@each_problem
@pytest.mark.parametrize("count", [0, 24])
def test_the_scores_are_errors_over_the_open_cells_of_the_grid(name, count):
    problem = PROBLEMS[name]
    belief = field_belief(problem, (0.5, 0.5, 0.0), count)
    world = problem.reset(jax.random.key(0))
    world = type(world)(world.vehicle, world.collisions + 3, world.gradient + 6.0)
    found = score(problem, world, belief)

    grid = np.stack(np.meshgrid(np.linspace(0.0, 3.0, 12), np.linspace(0.0, 2.4, 12)), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(grid_of(problem), grid, atol=1e-15)
    truth = np.asarray(values_of(problem.field, f64(grid)))
    mean, covariance = reference_belief(belief).gp.predict(grid)
    variance = np.diag(covariance)
    is_open = np.ones(len(grid), bool)
    if problem.walls is not None:
        is_open = ~segments_touch_boxes(grid, grid, np.asarray(problem.walls)).any(axis=1)
        assert 0 < np.sum(~is_open) < len(grid)
    squared = (mean - truth)[is_open] ** 2
    weights = ((truth - truth.min()) / (truth.max() - truth.min()))[is_open]
    nll = -stats.norm(mean[is_open], np.sqrt(variance[is_open])).logpdf(truth[is_open])
    np.testing.assert_allclose(found["rmse"], np.sqrt(squared.mean()), rtol=1e-9)
    np.testing.assert_allclose(found["wrmse"], np.sqrt((weights * squared).mean()), rtol=1e-9)
    np.testing.assert_allclose(found["wrmse_value"], found["wrmse"], rtol=1e-12)
    printed = np.asarray(weigh(problem.field, f64(grid), "gradient"))[is_open]
    np.testing.assert_allclose(found["wrmse_gradient"], np.sqrt((printed * squared).mean()), rtol=1e-9)
    np.testing.assert_allclose(found["mnll"], nll.mean(), rtol=1e-9)
    np.testing.assert_allclose(found["mean_std"], np.sqrt(variance[is_open]).mean(), rtol=1e-9)
    assert found["collisions"] == 3
    np.testing.assert_allclose(found["sampled_gradient"], 6.0 / max(count, 1))


def test_a_belief_without_uncertainty_has_a_finite_score():
    problem = monitoring(noise_variance=0.0, noise=0.0, resolution=2)
    belief = field_belief(problem, (0.5, 0.5, 0.0), 0)
    corners = grid_of(problem)
    extend = jax.jit(lambda posterior, y: posterior.extend(corners, y, jnp.ones(4, bool)))
    posterior = extend(belief.posterior, values_of(problem.field, corners))
    belief = dataclasses.replace(belief, posterior=posterior)
    found = score(problem, problem.reset(jax.random.key(0)), belief)
    assert all(np.isfinite(value) for value in found.values())
    np.testing.assert_allclose(found["rmse"], 0.0, atol=1e-9)


def test_a_reading_that_is_not_finite_is_left_out_of_the_belief_and_counted():
    problem = PROBLEMS["no walls"]
    world, belief = problem.reset(jax.random.key(0)), field_belief(problem, (0.5, 0.5, 0.0), 10)
    points, values = f64(np.full((SIZE, 2), 1.0)), f64([0.2, np.nan, np.inf, *[0.3] * (SIZE - 3)])
    update = jax.jit(lambda belief, seen: problem.update(belief, jnp.zeros((SIZE, 3)), seen))
    after = update(belief, Samples(points, values, jnp.ones(SIZE, bool), belief.pose))
    assert after.posterior.count == 10 + SIZE - 2
    found = score(problem, world, after)
    assert found["ignored_samples"] == 2 and all(np.isfinite(value) for value in found.values())


def test_a_robot_of_ones_own_moves_the_belief_and_is_refused_what_it_cannot_hold():
    problem = PROBLEMS["no walls"]
    belief, points = field_belief(problem, (0.5, 0.5, 0.0), 0), np.full((SIZE, 2), 1.0)
    posterior = belief.posterior.extend(points, np.ones(SIZE))
    moved = belief.after(posterior, [0.7, 0.6, 0.1])
    assert moved.posterior.count == SIZE and moved.step == belief.step + 1 and moved.counts[1] == SIZE
    np.testing.assert_array_equal(moved.pose, [0.7, 0.6, 0.1])
    with pytest.raises(ValueError, match="pose: got a number that is not finite"):
        belief.after(posterior, [0.7, np.nan, 0.1])
    with pytest.raises(ValueError, match=f"path {problem.max_steps + 1}; allowed: up to {problem.max_steps}"):
        for _ in range(problem.max_steps + 1):
            moved = belief = belief.after(posterior, [0.7, 0.6, 0.1])


def test_the_snapshot_has_field_belief_and_samples_on_the_grid():
    problem = PROBLEMS["walls"]
    belief = field_belief(problem, (0.5, 0.5, 0.0), 10)
    snapshot = jax.jit(lambda world, belief: problem.snapshot(world, belief))
    kept = snapshot(problem.reset(jax.random.key(0)), belief)["belief"]
    kept = {name: np.asarray(values) for name, values in kept.items()}
    x, y = np.meshgrid(kept["x"], kept["y"])  # the first axis is y
    points = f64(np.stack([x.ravel(), y.ravel()], axis=-1))
    assert kept["x"][-1] == 3.0 and kept["y"][-1] == 2.4
    mean, variance = predict(belief.posterior, points)
    np.testing.assert_allclose(kept["truth"].ravel(), values_of(FIELD, points), atol=1e-14)
    np.testing.assert_allclose(kept["mean"].ravel(), mean, atol=1e-12)
    np.testing.assert_allclose(kept["std"].ravel(), np.sqrt(variance), atol=1e-12)
    np.testing.assert_array_equal(kept["samples"][:10, :2], belief.posterior.x[:10])
    np.testing.assert_array_equal(kept["samples"][:10, 2], belief.posterior.y[:10])
    assert kept["samples"].shape == (24, 3) and np.all(np.isnan(kept["samples"][10:]))


class Wide(Exact):
    """A vehicle that cannot turn on the spot."""

    @property
    def turning_radius(self):
        return 0.5


def test_a_vehicle_that_cannot_turn_on_the_spot_is_not_told_to():
    assert monitoring(vehicle=Wide(), after_collision="stop").turning_radius == 0.5
    with pytest.raises(ValueError, match=r'^after_collision: got "turn"; [^\n]* 0.50 m: set "stop"$'):
        monitoring(vehicle=Wide())
    with pytest.raises(ConfigError, match="^after_collision"):
        build(Monitoring(vehicle=WheeledRobot()))
    build(Monitoring(vehicle=WheeledRobot(), after_collision="stop"))


def test_an_area_of_the_users_own_has_no_field_that_was_not_given():
    corners, bump = (0.0, 0.0, 9.0, 5.0), {"kind": "bumps", "centres": [[2.0, 2.0]]}
    assert Monitoring(domain=corners).field is None
    assert Monitoring.model_validate({"domain": corners, "field": bump}).field is not None
    assert Monitoring().field is not None
    saved = Monitoring(domain=corners).model_dump()
    assert Monitoring.model_validate(saved).field is None


def test_a_plan_needs_no_true_field_and_the_world_says_that_it_does():
    paths = {}
    for name, field in (("none", None), ("a bump", {"kind": "bumps", "centres": [[2.0, 2.0]]})):
        problem = bojax.part("monitoring", domain=(0.0, 0.0, 4.0, 4.0), max_steps=3, field=field)
        planner = bojax.part("sbo", iterations=5, depth=2)
        for_start, for_prior, for_plan, for_world = keys_of(0, 4)
        world = problem.reset(for_start)
        belief = problem.prior(for_prior, world, planner.motions.num_samples)
        paths[name] = eqx.filter_jit(planner.plan)(for_plan, problem, belief).path
        if field is None:
            with pytest.raises(ValueError, match="field: got none; allowed, to execute a path or to score"):
                problem.execute(for_world, world, paths[name])
            with pytest.raises(ValueError, match="field: got none"):
                problem.score(world, belief)
    np.testing.assert_array_equal(paths["none"], paths["a bump"])
