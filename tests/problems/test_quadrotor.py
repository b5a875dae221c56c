"""The quadrotor behind its problems: how it flies paths, what it measures, what its maps are scored by."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pydantic
import pytest

from bojax.config.errors import ConfigError
from bojax.engine.build import build
from bojax.fields.settings import Bumps
from bojax.models.settings import ConstantMean, Matern12, Scaled
from bojax.motions.base import place
from bojax.motions.splines import SplineSet
from bojax.problems.mapping import CORNERS, Map, final_map
from bojax.problems.sensors import RangeSensor
from bojax.problems.settings import HillyTerrain, IndoorProps, Range, TwoPits
from bojax.problems.vehicles import settings as vehicles
from bojax.results.tables import to_arrow
from bojax.robots.quaternions import rotation_matrix
from tests.arrays import f64
from tests.refusals import assert_refused

LANES, SIZE = 48, 8
ALTITUDE = 1.4
PATH_STEPS, REST_STEPS = 300, 250
VEHICLE = vehicles.Quadrotor(altitude=ALTITUDE, path_steps=PATH_STEPS, rest_steps=REST_STEPS)
NOISE = (0.02, 0.02, 0.03)


@pytest.fixture(scope="module")
def quadrotor():
    return build(VEHICLE)


@eqx.filter_jit
def follow(vehicle, keys, bodies, paths, ends, noise):
    """One compiled program for all tests: a vehicle, its bodies, paths, headings at the end, and a noise."""
    one = lambda key, body, path, end: vehicle.follow(key, body, path, end, noise)  # noqa: E731
    return jax.vmap(one)(keys, bodies, paths, ends)


@eqx.filter_jit
def poses_of(vehicle, bodies):
    return jax.vmap(vehicle.pose)(bodies)


@eqx.filter_jit
def placed(vehicle, starts):
    """The vehicle at each start."""
    return jax.vmap(vehicle.reset)(starts)


rotations = jax.jit(jax.vmap(jax.vmap(rotation_matrix)))


@jax.jit
def paths_from(starts, turn=0.0):
    """A path of a metre for every start, all actions in turn, and where it ends."""
    paths = SplineSet(f64(1.0), 5, SIZE).paths()
    paths = jax.vmap(place)(paths[jnp.arange(len(starts)) % 5], starts)
    ends = paths[:, -1].at[:, 2].add(turn)
    return paths, ends.at[:, 2].set(jnp.mod(ends[:, 2], 2.0 * np.pi))


def starts_of(seed=0):
    return f64(np.random.default_rng(seed).uniform([0, 0, 0], [3, 3, 2 * np.pi], (LANES, 3)))


def keys_of(seed):
    return jax.random.split(jax.random.key(seed), LANES)


def apart(one, other):
    """Distances of headings."""
    return np.abs(np.angle(np.exp(1j * (np.asarray(one) - np.asarray(other)))))


@pytest.fixture(scope="module")
def ride(quadrotor):
    """Paths flown with noise, and a turn by pi after them."""
    starts = starts_of()
    paths, ends = paths_from(starts, turn=np.pi)
    bodies = placed(quadrotor, starts)
    found = follow(quadrotor, keys_of(1), bodies, paths, ends, f64(NOISE))
    return starts, paths, ends, jax.tree.map(np.asarray, found)


def test_it_starts_where_it_is_placed_and_knows_it(quadrotor):
    starts = starts_of()
    bodies = placed(quadrotor, starts)
    pose, estimate = poses_of(quadrotor, bodies), jax.jit(jax.vmap(quadrotor.estimate))(bodies)
    np.testing.assert_allclose(pose[:, :2], starts[:, :2], atol=1e-6)
    assert apart(pose[:, 2], starts[:, 2]).max() < 1e-5 and pose.dtype == jnp.float64
    np.testing.assert_array_equal(estimate, starts)
    assert bodies.robot.qpos.dtype == jnp.float32
    np.testing.assert_allclose(bodies.robot.qpos[:, 2], ALTITUDE, rtol=1e-6)


def test_it_flies_near_the_path_and_stops_at_its_end(quadrotor, ride):
    _, paths, ends, found = ride
    gap = np.linalg.norm(found.poses[..., :2] - paths[..., :2], axis=-1)
    assert gap.max() < 0.06 and np.sqrt(np.mean(gap**2)) < 0.025
    # The heading lags behind where a path bends most.
    assert apart(found.poses[..., 2], paths[..., 2]).max() < 0.2
    last = found.state.robot
    assert np.abs(last.qvel[:, :3]).max() < 0.08 and np.abs(last.qvel[:, 3:]).max() < 0.5
    np.testing.assert_allclose(last.qpos[:, :2], ends[:, :2], atol=0.04)
    assert (
        apart(poses_of(quadrotor, found.state)[:, 2], ends[:, 2]).max() < 0.05
    )  # it has turned round on the spot
    assert apart(paths[:, -1, 2], ends[:, 2]).min() > 3.0
    assert not found.failed.any()
    moved = np.linalg.norm(np.diff(found.frames[..., :3], axis=1), axis=-1)  # ten frames a second, at 1 m/s
    assert found.frames.shape[1:] == ((PATH_STEPS + REST_STEPS) // 10, 7) and moved.max() < 0.1
    np.testing.assert_array_equal(found.frames[:, -1], last.qpos)
    for part in (found.poses, found.estimates, found.sensor_poses, found.state.reading):
        assert part.dtype == np.float64


def test_estimates_are_readings_of_the_stated_spread(quadrotor, ride):
    _, _, _, found = ride
    wrong = found.estimates - found.poses
    wrong[..., 2] = np.angle(np.exp(1j * wrong[..., 2]))
    spread = wrong.reshape(-1, 3)
    assert spread.std(axis=0) == pytest.approx(NOISE, rel=0.15)
    assert np.abs(spread.mean(axis=0)).max() < 0.004
    reading = found.state.reading - np.asarray(poses_of(quadrotor, found.state))
    assert 0.01 < reading[:, :2].std() < 0.03


def test_mounts_are_where_the_sensor_is(ride):
    _, _, _, found = ride
    position, quaternion = found.sensor_poses[..., :3], found.sensor_poses[..., 3:]
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1.0, atol=1e-5)
    rotation = np.asarray(rotations(f64(quaternion)))
    body = position + 0.04 * rotation[..., 2]
    np.testing.assert_allclose(body[..., :2], found.poses[..., :2], atol=1e-5)
    np.testing.assert_allclose(body[..., 2], ALTITUDE, atol=0.03)
    lean = np.arccos(rotation[..., 2, 2])
    assert 0.01 < lean.max() < 0.2


def test_a_robot_that_diverges_fails_alone(quadrotor, ride):
    starts, paths, ends, before = ride
    bodies = placed(quadrotor, starts)
    broken = eqx.tree_at(
        lambda b: b.robot.qvel, bodies, bodies.robot.qvel.at[5, 0].set(jnp.nan).at[7, 3].set(1e7)
    )
    found = follow(quadrotor, keys_of(1), broken, f64(paths), f64(ends), f64(NOISE))
    is_broken = np.isin(np.arange(LANES), [5, 7])
    np.testing.assert_array_equal(found.failed, is_broken)
    np.testing.assert_array_equal(np.asarray(found.poses)[~is_broken], before.poses[~is_broken])


# The sensor.


def mounts_of(num, lean, seed=0):
    """Hovering 1.5 m over random places, leaning by an angle about x."""
    rng = np.random.default_rng(seed)
    position = np.column_stack([rng.uniform(0.5, 2.5, (num, 2)), np.full(num, 1.5)])
    quaternion = np.tile([np.cos(lean / 2), np.sin(lean / 2), 0.0, 0.0], (num, 1))
    return f64(np.column_stack([position, quaternion]))


def sensor(**settings):
    return build(Range(**{"altitude_noise": 0.0, **settings}))


@eqx.filter_jit
def measure(sensor, key, field, mounts, noise):
    poses = jnp.column_stack([mounts[:, :2], jnp.zeros(len(mounts))])
    return sensor(key, field, poses, mounts, noise)


def measured(sensor, field, mounts, noise=0.0, seed=0):
    return np.asarray(measure(sensor, jax.random.key(seed), field, mounts, f64(noise)))


LEVEL = build(Bumps(heights=(0.3,), widths=(1e3,)))
HILL = build(Bumps(heights=(0.8,), centres=((1.5, 1.5),), widths=(0.4,)))


def test_over_level_ground_it_tells_the_height_as_far_as_it_sees_and_knows_how_it_leans():
    for lean in (0.0, 0.15):
        found = measured(sensor(beam=0.0), LEVEL, mounts_of(20, lean))
        np.testing.assert_allclose(found, 0.3, atol=1e-5)
    found = measured(sensor(beam=0.0, upright=False), LEVEL, mounts_of(20, 0.15))
    np.testing.assert_allclose(found, 1.5 - 1.2 / np.cos(0.15), atol=1e-5)
    np.testing.assert_allclose(measured(sensor(max_range=1.0), LEVEL, mounts_of(5, 0.0)), 0.5, atol=1e-6)


def test_noise_has_the_stated_spread():
    found = measured(sensor(), LEVEL, mounts_of(4000, 0.0), noise=0.04)
    assert found.std() == pytest.approx(0.04, rel=0.05) and found.mean() == pytest.approx(0.3, abs=0.003)
    found = measured(sensor(altitude_noise=0.03), LEVEL, mounts_of(4000, 0.0), noise=0.04)
    assert found.std() == pytest.approx(0.05, rel=0.05)


def test_a_beam_averages_over_its_foot():
    """On the top of a hill: over a disc of radius r the mean height is less, by (r/2w)^2 of it."""
    mounts = jnp.asarray([[1.5, 1.5, 1.5, 1.0, 0.0, 0.0, 0.0]])
    narrow = measured(sensor(beam=0.0), HILL, mounts)
    wide = measured(sensor(beam=0.2, rays=150), HILL, mounts)
    nearest = measured(sensor(beam=0.2, rays=150, reading="minimum"), HILL, mounts)
    assert narrow == pytest.approx(0.8, abs=1e-5) and nearest == pytest.approx(0.8, abs=1e-3)
    radius = 0.7 * np.tan(0.1)
    # The rays of the rim are longer, too: by r^2 / 4 h on average.
    expected = 0.8 * (1 - (radius / 0.8) ** 2) - radius**2 / (4 * 0.7)
    assert wide == pytest.approx(expected, abs=2e-3) and wide < 0.795


def test_it_can_follow_what_its_thrust_can_accelerate():
    # 4 rotors of 13 N, 1.325 kg; the least jerk over T seconds and L metres peaks at 10 / sqrt(3) L / T^2.
    sideways = np.sqrt((4 * 13.0 / 1.325) ** 2 - 9.81**2)
    slow, fast = (build(vehicles.Quadrotor(path_steps=steps)) for steps in (400, 10))
    assert slow.reach == pytest.approx(sideways * 4.0**2 * np.sqrt(3.0) / 10.0, rel=1e-3)
    assert fast.reach == pytest.approx(slow.reach / 1600.0)


# The problems.


def test_samples_are_learned_where_the_robot_takes_itself_to_be():
    problem = build(HillyTerrain(vehicle=VEHICLE, field=Bumps(heights=(0.3,), widths=(1e3,)), noise=0.01))

    @jax.jit
    def step(key):
        world = problem.reset(key)
        belief = problem.prior(jax.random.fold_in(key, 1), world, SIZE)
        path = SplineSet(f64(1.0), 5, SIZE).paths()[1]
        after, samples, events = problem.execute(jax.random.fold_in(key, 2), world, path)
        return world, after, samples, events, problem.update(belief, path, samples)

    world, after, samples, events, belief = jax.vmap(step)(keys_of(3))
    samples, events, posterior = jax.tree.map(np.asarray, (samples, events, belief.posterior))
    taken = samples.is_taken
    np.testing.assert_array_equal(events.is_driven, taken)
    np.testing.assert_allclose(samples.values[taken], 0.3, atol=0.15)
    assert samples.values[taken].std() == pytest.approx(np.hypot(0.01, 0.02), rel=0.2)
    off = (samples.points - events.driven[..., :2])[taken]
    assert off.std() == pytest.approx(0.02, rel=0.15)
    np.testing.assert_array_equal(samples.pose, after.vehicle.reading)
    np.testing.assert_array_equal(belief.pose, after.vehicle.reading)
    for lane in range(LANES):
        number = taken[lane].sum()
        assert posterior.count[lane] == number
        np.testing.assert_array_equal(posterior.x[lane, :number], samples.points[lane, taken[lane]])
    is_stopped = events.exited
    assert is_stopped.any() and not is_stopped.all() and not events.failed.any()
    # Where the border stopped it, it has turned round.
    turn = apart(after.vehicle.reading[:, 2], events.driven[:, -1, 2])
    assert turn[is_stopped].min() > 2.8 and turn[~is_stopped].max() < 0.3
    assert events.frames.shape == (LANES, (PATH_STEPS + REST_STEPS) // 10, 7)
    assert np.all(world.vehicle.reading[:, :2] >= 0.0)


values_of = eqx.filter_jit(lambda field, points: field.values(points))


@pytest.fixture(scope="module")
def room():
    return build(IndoorProps(resolution=29, vehicle=VEHICLE, mean=ConstantMean(value=0.0)))


def belief_of(problem, points, values):
    """A belief after some samples, without flying there."""
    world = problem.reset(jax.random.key(0))
    belief = problem.prior(jax.random.key(1), world, SIZE)
    taken = jnp.ones(len(points), bool)
    posterior = belief.posterior.extend(f64(points), f64(values), taken)
    return world, dataclasses.replace(belief, posterior=posterior)


@eqx.filter_jit
def score_and_map(problem, points, values):
    world, belief = belief_of(problem, points, values)
    return problem.score(world, belief), final_map(problem, belief)


@eqx.filter_jit
def scored_and_recorded(problem, points, values):
    """The scores, the map that the flight is planned with, and the mean that is recorded."""
    world, belief = belief_of(problem, points, values)
    recorded = problem.snapshot(world, belief)["belief"]["mean"]
    return problem.score(world, belief), final_map(problem, belief), recorded.ravel()


def scored(problem, points, values):
    score, found = score_and_map(problem, points, values)
    assert set(score) == {column.name for column in problem.scores}
    return {name: float(value) for name, value in score.items()}, found


def test_scores_are_those_of_the_grid(room):
    rng = np.random.default_rng(4)
    points = rng.uniform(0.2, 2.8, (60, 2))
    values = np.asarray(values_of(room.field, f64(points))) + 0.05 + 0.02 * rng.normal(size=60)
    score, found = scored(room, points, values)
    axis = np.linspace(0.0, 3.0, 29)
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    truth = np.asarray(values_of(room.field, f64(np.column_stack([x, y]))))
    error = np.asarray(found.mean) - truth
    offset, centred = error.mean(), error - error.mean()
    rms = lambda where: np.sqrt(np.mean(centred[where] ** 2))  # noqa: E731
    south, north, west, east = y <= 0.6, y >= 2.4, x <= 0.6, x >= 2.4
    corners = {"sw": south & west, "nw": north & west, "se": south & east, "ne": north & east}
    rest = ~np.any([*corners.values()], axis=0)
    std = np.asarray(found.std)
    distance = np.min(np.hypot(x[:, None] - points[:, 0], y[:, None] - points[:, 1]), axis=1)
    far = distance >= np.quantile(distance, 0.75)
    edge = np.zeros(len(x), bool)
    for a, b, c, d in np.asarray(room.field.boxes):
        outer = np.hypot(np.maximum(np.maximum(a - x, x - c), 0), np.maximum(np.maximum(b - y, y - d), 0))
        inner = np.minimum(np.minimum(x - a, c - x), np.minimum(y - b, d - y))
        edge |= np.where(inner > 0, inner <= 0.1, outer <= 0.1)
    expected = {
        "rmse": np.sqrt(np.mean(error**2)),
        "offset": offset,
        "spread": error.std(),
        "explained_variance": 1 - error.var() / truth.var(),
        "mean_std": std.mean(),
        **{f"corner_error_{name}": rms(where) - rms(rest) for name, where in corners.items()},
        **{f"corner_std_{name}": std[where].mean() - std[rest].mean() for name, where in corners.items()},
        "sparse_error": rms(far),
        "edge_error": rms(edge),
        "edge_excess": rms(edge) - rms(~edge),
        "gap_height": np.asarray(found.mean)[(x >= 0.4) & (x <= 1.0) & (y > 1.2) & (y < 1.6)].mean() / 0.2,
    }
    for name, value in expected.items():
        assert score[name] == pytest.approx(value, abs=1e-9), name
    assert (~rest).sum() == 12**2 and 0.02 < offset


def test_scores_of_regions_without_a_grid_point_are_null_and_a_flat_field_has_no_share_of_its_variance(room):
    """A coarse grid has no point at an edge or outside of the corners, and the floor there is flat."""
    coarse = dataclasses.replace(room, resolution=2)
    score, _ = scored(coarse, np.array([[0.5, 0.5], [2.0, 1.0]]), np.array([0.1, 0.2]))
    corners = [f"corner_{score}_{corner}" for score in ("error", "std") for corner in CORNERS]
    names = ["explained_variance", *corners, "edge_error", "edge_excess", "gap_height"]
    assert {name for name, value in score.items() if np.isnan(value)} == {*names}
    assert all(np.isfinite(value) for name, value in score.items() if name not in names)
    table = to_arrow(room.scores, {name: np.array([value]) for name, value in score.items()})
    assert [name for name in table.column_names if table[name].null_count] == names[1:]
    assert np.isnan(table["explained_variance"][0].as_py())


def test_the_height_between_the_two_nearest_props_is_a_share_of_the_lower_one(room):
    """The props on the left, of 0.2 and 0.25 m, have a gap of 0.4 m."""
    points = np.asarray(room.grid())

    @jax.jit
    def share(shown):
        found = Map(f64(points), shown, shown, shown, f64(0.0), jnp.ones(len(points), bool))
        return room._gap_height(found, room._outside(f64(points)))

    truth = np.asarray(values_of(room.field, f64(points)))
    x, y = points.T
    in_gap = (x >= 0.4) & (x <= 1.0) & (y > 1.2) & (y < 1.6)
    assert in_gap.any() and share(truth) == pytest.approx(0.0)
    assert share(np.where(in_gap, 0.1, truth)) == pytest.approx(0.5)
    assert share(np.where(in_gap, 0.0, 1.0)) == pytest.approx(0.0)


@eqx.filter_jit
def which_are_found(problem, points, shown):
    """Which props are found in a map that shows these heights."""
    found = Map(points, shown, shown, shown, f64(0.0), jnp.ones(len(points), bool))
    return problem._is_found(found, problem._outside(points))


def test_props_are_found_where_the_map_shows_them_in_their_place(room):
    def share(shift, left_out=()):
        points = np.column_stack([part.ravel() for part in room.grid().T])
        heights = np.array(room.field.heights)
        heights[list(left_out)] = 0.0
        shown = values_of(
            dataclasses.replace(room.field, heights=f64(heights)), f64(points - np.asarray(shift))
        )
        return np.asarray(which_are_found(room, f64(points), shown))

    np.testing.assert_array_equal(share((0.0, 0.0)), True)
    np.testing.assert_array_equal(share((0.1, 0.0)), True)
    np.testing.assert_array_equal(share((0.5, 0.0)), False)
    np.testing.assert_array_equal(share((0.0, 0.0), left_out=(1,)), [True, False, True])


def test_the_map_may_have_another_kernel_than_the_flight():
    sharp, given = (
        Scaled(kernel=Matern12(lengthscale=0.4), variance=0.02),
        {"resolution": 13, "vehicle": VEHICLE},
    )
    rng = np.random.default_rng(5)
    points = rng.uniform(0.2, 2.8, (30, 2))
    values = 0.1 * rng.normal(size=30)
    (other, flown, recorded), (whole, there, _) = (
        jax.device_get(scored_and_recorded(build(problem), points, values))
        for problem in (IndoorProps(map_kernel=sharp, **given), IndoorProps(kernel=sharp, **given))
    )
    other, whole = (jax.tree.map(float, scores) for scores in (other, whole))
    assert other == pytest.approx(whole, abs=1e-9) and other["rmse"] > 0.01
    np.testing.assert_allclose(recorded, there.mean, atol=1e-9)
    assert np.ptp(flown.mean - there.mean) > 0.01, "the flight keeps its own"


def test_what_does_not_fit_together_is_refused():
    high, in_the_air = vehicles.Quadrotor(altitude=6.0), "sensor: got .range., which measures from the air"
    low = {"kind": "quadrotor", "altitude": 0.5}
    on_wheels = f"{in_the_air}; set a vehicle that flies"
    below = r"sensor.max_range: got 5; the ground is up to 6.00 m below"
    hill = "vehicle.altitude: got 0.5; the ground rises to 1.[0-9]+ m"
    assert_refused(
        [
            (lambda: build(HillyTerrain(vehicle=vehicles.Exact())), on_wheels),
            (lambda: build(HillyTerrain(vehicle=vehicles.WheeledRobot())), on_wheels),
            (lambda: build(TwoPits(sensor=Range())), in_the_air),
            (lambda: build(HillyTerrain(vehicle=high)), below),
            (lambda: build(HillyTerrain(vehicle=low)), hill),
        ],
        ConfigError,
    )
    assert isinstance(build(HillyTerrain()).sensor, RangeSensor)
    build(HillyTerrain(vehicle=high, sensor=Range(max_range=6.5)))
    with pytest.raises(pydantic.ValidationError, match="unknown kind"):
        IndoorProps(field=Bumps())
    problem = build(IndoorProps())
    with pytest.raises(ValueError, match="prop mapping needs a field of kind blocks"):
        dataclasses.replace(problem, field=HILL)
