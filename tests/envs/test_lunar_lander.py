"""The lunar lander against Gymnasium's, which Box2D steps, and against what the thesis says of its goal."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bojax.engine.build import build
from bojax.envs import lander_dynamics, lander_geometry
from bojax.envs import settings as envs
from bojax.envs.lander_dynamics import LanderState, hull_touches_ground, smooth_terrain

pytest.importorskip("Box2D")

from gymnasium.envs.box2d.lunar_lander import heuristic  # noqa: E402

from tests.compiling import as_for_a_gpu  # noqa: E402
from tests.reference.lunar_lander import GymLander, rotation  # noqa: E402
from tests.tiers import by_tier

NUM_STEPS, LANES = 120, 200
OFF = np.array([-1.0, 0.0])
CLASSIC = envs.LunarLander(reward="classic")


@pytest.fixture(scope="module")
def gym():
    return GymLander()


@eqx.filter_jit
def start(env, heights, push):
    """The first state, with heights and force as shares of their ranges."""
    heights, push = 0.5 * lander_geometry.HEIGHT * heights, env.max_push * (2.0 * push - 1.0)
    return lander_dynamics.step(lander_dynamics.reset(push, smooth_terrain(heights)), env.gravity)


@eqx.filter_jit
def rollout(env, state, keys, actions):
    """The states after each step, and the transitions."""

    def go_on(state, given):
        after, transition = env.step(*given[:1], state, *given[1:])
        return after, (after, transition)

    return jax.lax.scan(go_on, state, (keys, actions))[1]


@eqx.filter_jit
def resets(env, keys):
    """Many first states."""
    return jax.vmap(env.reset)(keys)


@eqx.filter_jit
def steps(env, keys, states, actions):
    """Many landers, one step each: the states after, and the transitions."""
    return jax.vmap(env.step)(keys, states, actions)


@eqx.filter_jit
def draws(keys, dtype=None):
    """The noise of both engines in each step."""
    return jax.vmap(lambda key: jax.random.uniform(key, (2,), dtype, -1.0, 1.0))(keys)


def flights(gym, env, num, seed=0):
    """Both landers from the same starts, under the same actions and noise: observations, rewards, ends."""
    rng = np.random.default_rng(seed)
    dtype = env.gravity.dtype
    for i in range(num):
        heights, push = rng.uniform(size=12), rng.uniform(size=2)
        actions = rng.uniform(-1.5, 1.5, (NUM_STEPS, 2))
        keys = jax.random.split(jax.random.key(i), NUM_STEPS)
        noise = np.asarray(draws(jax.random.clone(keys), dtype))
        first = gym.reset(heights, push)
        state = start(env, jnp.asarray(heights, dtype), jnp.asarray(push, dtype))
        theirs = [gym.step(action, given) for action, given in zip(actions, noise, strict=True)]
        states, transition = rollout(env, state, keys, jnp.asarray(actions, dtype))
        yield first, env.observe(state), theirs, transition, states


def standing(terrain, dtype="float64", x=10.0, height=0.6, angle=0.0, velocity=(0.0, 0.0), legs=(0.4, 0.4)):
    """A lander with the hull's origin so high above the pad; on its legs it is 0.624 m high."""
    centre = np.array([0.0, lander_geometry.lander(lander_geometry.LEG_REST).centre[1]])
    position = np.array([x, lander_geometry.PAD_HEIGHT + height]) + rotation(angle) @ centre
    numbers = [jnp.asarray(given, dtype) for given in (position, angle, velocity, 0.0, legs)]
    return LanderState(*numbers, jnp.zeros(2, bool), jnp.zeros((), jnp.int32), jnp.asarray(terrain, dtype))


def drifts(gym, env, **settings):
    """Both landers without engines from the same state: observations, joints and how each ended."""
    gym.reset(np.full(12, 0.5))
    for _ in range(25):
        gym.step(OFF)  # the legs come to rest
    state = standing(gym.terrain, legs=gym.legs, **settings)
    gym.place(state.origin, float(state.angle), np.array(state.velocity), float(state.spin))
    seen, joints, end = [], [], ("goes on", NUM_STEPS)
    for i in range(NUM_STEPS):
        observation, reward, terminated = gym.step(OFF)
        seen.append(observation)
        joints.append(gym.legs)
        if terminated:
            end = ({100.0: "rests", -100.0: "crashes"}[reward], i + 1)
            break
    keys = jax.random.split(jax.random.key(0), NUM_STEPS)
    states, transition = rollout(env, state, keys, jnp.tile(jnp.asarray(OFF), (NUM_STEPS, 1)))
    over = np.flatnonzero(transition.terminated)
    ours = ("goes on", NUM_STEPS)
    if len(over):
        ours = ({100.0: "rests", -100.0: "crashes"}[float(transition.reward[over[0]])], int(over[0]) + 1)
    num = ours[1]
    return (np.array(seen), np.array(joints), end), (
        np.array(transition.observation)[:num],
        np.array(states.legs)[:num],
        ours,
    )


def test_masses_are_those_of_box2d(gym):
    gym.reset()
    hull, right, left = gym.bodies
    for (mass, _, inertia), ours in (
        (hull, lander_geometry.hull()),
        (right, lander_geometry.polygon(lander_geometry.LEG, 1.0)),
        (left, lander_geometry.polygon(lander_geometry.LEG, 1.0)),
    ):
        np.testing.assert_allclose((mass, inertia), (ours.mass, ours.inertia), rtol=1e-6)
    origin, angle = np.array(gym.env.lander.position), gym.env.lander.angle
    parts = [lander_geometry.Mass(m, rotation(-angle) @ (c - origin), i) for m, c, i in gym.bodies]
    together, ours = lander_geometry.combined(parts), lander_geometry.lander(float(gym.legs.mean()))
    np.testing.assert_allclose(together.centre, ours.centre, atol=1e-4)
    np.testing.assert_allclose((together.mass, together.inertia), (ours.mass, ours.inertia), rtol=1e-4)


def test_an_episode_begins_as_in_gymnasium(gym):
    env, rng = build(CLASSIC), np.random.default_rng(1)
    for _ in range(5):
        heights, push = rng.uniform(size=12), rng.uniform(size=2)
        observation = gym.reset(heights, push)
        state = start(env, jnp.asarray(heights), jnp.asarray(push))
        np.testing.assert_allclose(state.terrain, gym.terrain, atol=1e-6)
        np.testing.assert_allclose(env.observe(state), observation, atol=1e-3)


def test_starts_are_drawn_as_in_gymnasium():
    env = build(CLASSIC)
    states = resets(env, jax.random.split(jax.random.key(2), 1000))
    fastest = 20.0 / lander_geometry.lander(0.4).mass
    drawn = (np.asarray(states.velocity) + [0.0, 0.2]) / fastest
    for column in drawn.T:
        assert stats.kstest(column, "uniform", args=(-1.0, 2.0)).pvalue > 1e-3
    terrain = np.asarray(states.terrain)
    np.testing.assert_allclose(terrain[:, 4:7], lander_geometry.PAD_HEIGHT, rtol=1e-12)
    rough = terrain[:, [0, 1, 2, 8, 9]] / (0.33 * lander_geometry.HEIGHT)
    assert np.all(rough > 0.0) and np.all(rough < 1.5) and np.all(np.std(rough, axis=0) > 0.1)
    columns = np.concatenate([drawn, rough[:, [0, 4]]], axis=1).T
    assert np.abs(np.corrcoef(columns) - np.eye(4)).max() < 0.11


@pytest.mark.parametrize("dtype", by_tier(["float64", "float32"], normal=["float32"]))
def test_flights_and_their_rewards_are_gymnasiums(gym, dtype):
    """Random throttles with the same dispersion; both engines are on in some steps, in others none."""
    num = 0
    for _, _, theirs, transition, _ in flights(gym, build(CLASSIC, dtype), 3):
        observations, rewards, ends = (np.array(x) for x in zip(*theirs, strict=True))
        assert transition.reward.dtype == transition.observation.dtype == dtype
        in_flight = ~np.maximum.accumulate(ends | np.any(observations[:, 6:], axis=1))
        gap = np.abs(np.asarray(transition.observation) - observations)[in_flight]
        assert gap[:60].max() < 0.01 and gap.max() < 0.03  # units of observations; the legs open meanwhile
        np.testing.assert_allclose(np.asarray(transition.reward)[in_flight], rewards[in_flight], atol=0.6)
        num += in_flight.sum()
    assert num > 200


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.2, 2.5])
def test_engines_change_velocity_and_spin_as_in_gymnasium(gym, angle):
    env, keys = build(CLASSIC), jax.random.split(jax.random.key(3), LANES)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (LANES, 2))
    gym.reset()
    for _ in range(25):
        gym.step(OFF)
    state = standing(gym.terrain, height=6.0, angle=angle, velocity=(0.3, -0.2))
    states = jax.tree.map(lambda x: jnp.stack([x] * LANES), state)
    ours = np.asarray(steps(env, jax.random.clone(keys), states, jnp.asarray(actions))[1].observation)
    for drawn, action, observation in zip(np.asarray(draws(keys)), actions, ours, strict=True):
        gym.place(state.origin, angle, (0.3, -0.2), 0.0)
        theirs, _, _ = gym.step(action, drawn)
        np.testing.assert_allclose(observation[2:6], theirs[2:6], atol=1.5e-3)
    assert np.ptp(ours[:, 5]) > 0.05 and np.ptp(ours[:, 2]) > 0.03


@pytest.mark.parametrize(
    ("velocity", "end"),
    [(-0.2, "rests"), (-1.0, "rests"), (-1.5, "rests"), (-2.5, "crashes"), (-4.0, "crashes")],
)
def test_a_flat_landing_ends_as_in_box2d(gym, velocity, end):
    """From 0.1 m above the pad: the legs give way as far, and the hull comes down or does not."""
    theirs, ours = drifts(gym, build(CLASSIC), height=0.72, velocity=(0.0, velocity))
    assert (theirs[2][0], ours[2][0]) == (end, end)
    assert abs(theirs[2][1] - ours[2][1]) < 10
    if end == "rests":
        np.testing.assert_allclose(ours[1].max(axis=0), theirs[1].max(axis=0), atol=0.03)
        np.testing.assert_allclose(ours[0][-1], theirs[0][-1], atol=2e-3)


def episodes_of_ours(schema, policy, num):
    """Returns, lengths, last rewards and whether the goal was reached, of one episode each."""
    env = build(schema, "float32")
    states = resets(env, jax.random.split(jax.random.key(5), num))
    seen = np.asarray(jax.vmap(env.observe)(states))
    total, length, last = np.zeros(num), np.zeros(num, int), np.zeros(num)
    goes_on, reached = np.ones(num, bool), np.zeros(num, bool)
    for i in range(500):
        actions = jnp.asarray([policy(row) for row in seen], jnp.float32)
        keys = jax.random.split(jax.random.key(1000 + i), num)
        states, transition = steps(env, keys, states, actions)
        reward = np.asarray(transition.reward)
        total, length = total + goes_on * reward, length + goes_on
        last = np.where(goes_on, reward, last)
        reached |= goes_on & np.asarray(transition.success)
        goes_on &= ~np.asarray(transition.terminated)
        seen = np.asarray(transition.observation)
        if not goes_on.any():
            break
    return total, length, last, reached


def episodes_of_gymnasium(gym, policy, num):
    """The same of Gymnasium's, with its own random numbers."""
    told = []
    for i in range(num):
        seen, _ = gym.env.reset(seed=i)
        total, reached = 0.0, False
        for length in range(1, 501):  # noqa: B007
            seen, reward, ends, _, _ = gym.env.step(np.asarray(policy(seen), np.float64))
            total, reached = total + reward, reached or np.hypot(*seen[:2]) < 0.05
            if ends:
                break
        told.append((total, length, reward, reached))
    return tuple(np.array(column) for column in zip(*told, strict=True))


@pytest.mark.parametrize("kind", by_tier(["heuristic", "random"], normal=["heuristic"]))
def test_episodes_end_and_pay_as_in_gymnasium(gym, kind):
    """Under the controller that Gymnasium ships, which lands nearly always, and under random actions."""
    rng = np.random.default_rng(0)
    policies = {"heuristic": lambda seen: heuristic(gym.env, seen), "random": lambda _: rng.uniform(-1, 1, 2)}
    ours = episodes_of_ours(CLASSIC, policies[kind], 120)
    theirs = episodes_of_gymnasium(gym, policies[kind], 40)
    for mine, gyms in zip(ours[:2], theirs[:2], strict=True):
        assert stats.ks_2samp(mine, gyms).pvalue > 0.01
    shares = [[(x[2] == 100.0), (x[2] == -100.0), x[3]] for x in (ours, theirs)]
    for mine, gyms in zip(*shares, strict=True):
        table = [[mine.sum(), (~mine).sum()], [gyms.sum(), (~gyms).sum()]]
        assert stats.fisher_exact(table).pvalue > 0.01
    lands, crashes, reaches = (share.mean() for share in shares[0])
    if kind == "heuristic":
        assert lands > 0.97 and reaches > 0.75
    else:
        assert crashes > 0.97 and 0.0 < reaches < 0.15


def outcome(schema, **settings):
    """What one step without engines leads to."""
    terrain = np.full(11, lander_geometry.PAD_HEIGHT)
    states = jax.tree.map(lambda x: x[None], standing(terrain, **settings))
    actions = jnp.asarray([OFF])
    _, transition = steps(build(schema), jax.random.split(jax.random.key(0), 1), states, actions)
    return transition.reward.item(), transition.terminated.item(), transition.success.item()


@pytest.mark.parametrize("reward", ["goal-only", "classic"])
def test_goal_and_failure(reward):
    """0.05 of the observation are 0.5 m to the side; 0.33 m up from 0.63 m, where it stands."""
    schema = envs.LunarLander(reward=reward)
    reaches, ends, fails = (
        (1.0, True, True),
        reward == "goal-only",
        (-1.0 if reward == "goal-only" else -100.0),
    )
    for settings, success in (
        ({"x": 10.4, "height": 0.7}, True),
        ({"x": 9.52, "height": 0.7}, True),
        ({"x": 10.6, "height": 0.7}, False),
        ({"x": 10.0, "height": 0.9}, True),
        ({"x": 10.0, "height": 1.0}, False),
    ):
        told = outcome(schema, **settings)
        assert told[1:] == ((ends, True) if success else (False, False))
        if reward == "goal-only":
            assert told == (reaches if success else (0.0, False, False))
    assert outcome(schema, height=0.3) == (fails, True, False)  # on its hull, at the centre
    for x in (0.005, 19.995):
        velocity = (np.sign(x - 10.0), 0.0)
        assert outcome(schema, x=x, height=5.0, velocity=velocity) == (fails, True, False)
    assert not outcome(schema, x=19.9, height=5.0)[1]
    wide = envs.LunarLander(reward=reward, goal_distance=0.2)
    assert outcome(wide, x=10.6, height=0.7)[2]


def test_the_goal_may_be_a_box():
    corner = {"x": 10.45, "height": 0.9}  # 0.045 and about 0.04 of the observation
    assert not outcome(envs.LunarLander(), **corner)[2]
    assert outcome(envs.LunarLander(goal="box"), **corner)[2]
    assert not outcome(envs.LunarLander(goal="box"), x=10.55, height=0.7)[2]
    assert not outcome(envs.LunarLander(goal="box"), x=10.0, height=1.0)[2]


def test_the_published_reward_charges_steps_and_failures():
    schema = envs.LunarLander(reward="classic", classic_reward="published")
    assert outcome(schema, x=10.0, height=3.0) == (-1.0, False, False)
    assert outcome(schema, x=10.4, height=0.7) == (0.0, True, True)
    assert outcome(schema, height=0.3) == (-100.0, True, False)


def test_the_hull_touches_where_ground_is_within_it():
    """Against points of the ground, 2 mm apart, in the polygon of the hull, and corners below the ground."""
    rng = np.random.default_rng(0)
    terrains = rng.uniform(0.0, 4.0, (300, 11))
    places = np.stack([rng.uniform(1.0, 19.0, 300), rng.uniform(1.0, 4.5, 300)], axis=1)
    angles = rng.uniform(-np.pi, np.pi, 300)
    across = np.linspace(0.0, 20.0, 10_001)
    knots = np.linspace(0.0, 20.0, 11)
    centre = np.array([0.0, lander_geometry.lander(0.4).centre[1]])
    margins = []
    for terrain, place, angle in zip(terrains, places, angles, strict=True):
        corners = place + lander_geometry.HULL @ rotation(angle).T
        edges = np.roll(corners, -1, axis=0) - corners
        edges /= np.linalg.norm(edges, axis=1, keepdims=True)
        ground = np.stack([across, np.interp(across, knots, terrain)], axis=1)
        away = ground[:, None] - corners
        inside = np.min(edges[:, 0] * away[..., 1] - edges[:, 1] * away[..., 0], axis=1).max()
        above = corners[:, 1] - np.interp(corners[:, 0], knots, terrain)
        margins.append(max(inside, -above.min()))
    margins = np.array(margins)
    position = places + np.stack([rotation(a) @ centre for a in angles])
    zero = jnp.zeros(300)
    states = jax.vmap(LanderState)(
        jnp.asarray(position),
        jnp.asarray(angles),
        jnp.zeros((300, 2)),
        zero,
        jnp.zeros((300, 2)),
        jnp.zeros((300, 2), bool),
        jnp.zeros(300, jnp.int32),
        jnp.asarray(terrains),
    )
    touches = np.asarray(jax.jit(jax.vmap(hull_touches_ground))(states))
    clear = np.abs(margins) > 0.06  # the skins of hull and ground
    np.testing.assert_array_equal(touches[clear], margins[clear] > 0.0)
    assert 50 < touches[clear].sum() < 250


def test_a_state_that_no_body_can_be_in_pays_nan():
    assert np.isnan(outcome(CLASSIC, height=5.0, velocity=(2000.0, 0.0))[0])
    assert np.isnan(outcome(envs.LunarLander(), height=5.0, velocity=(0.0, np.nan))[0])
    assert not np.isnan(outcome(CLASSIC, height=5.0, velocity=(30.0, 0.0))[0])


def test_noise_scales_with_its_settings():
    terrain = np.full(11, lander_geometry.PAD_HEIGHT)
    states = jax.tree.map(lambda x: jnp.stack([x] * LANES), standing(terrain, height=6.0))
    keys, full = jax.random.split(jax.random.key(4), LANES), jnp.ones((LANES, 2))

    def spread(**settings):
        env = build(envs.LunarLander(reward="classic", **settings))
        return np.std(steps(env, jax.random.clone(keys), states, full)[1].observation[:, 2:6], axis=0)

    assert np.all(spread() > 1e-4)
    np.testing.assert_allclose(spread(dispersion=0.0), 0.0, atol=1e-12)
    half, whole = (spread(dispersion=share, side_power=0.0) for share in (0.5, 1.0))
    np.testing.assert_allclose(half, 0.5 * whole, rtol=0.02)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_contacts_as_a_kernel_are_those_of_xla(dtype, monkeypatch):
    """The kernel of a GPU, interpreted, for landers above, on and in the ground, with legs at all angles."""
    rng, number = np.random.default_rng(0), 32

    def drawn(low, high, *shape):
        return jnp.asarray(rng.uniform(low, high, (number, *shape)), dtype)

    states = jax.vmap(LanderState)(
        jnp.stack([drawn(2.0, 18.0), drawn(3.5, 6.0)], axis=1),
        drawn(-1.0, 1.0),
        drawn(-3.0, 3.0, 2),
        drawn(-2.0, 2.0),
        drawn(-0.4, 0.9, 2),
        jnp.zeros((number, 2), bool),
        jnp.zeros(number, jnp.int32),
        drawn(2.0, 5.0, 11),
    )
    # Two axes of lanes, as where a run batches episodes.
    states = jax.tree.map(lambda x: x.reshape(4, -1, *x.shape[1:]), states)

    def step(state):
        return lander_dynamics.step(state, jnp.asarray(10.0, dtype))

    expected = jax.jit(jax.vmap(jax.vmap(step)))(states)
    monkeypatch.setattr(lander_dynamics, "either", lambda _, kernel, otherwise, *args: kernel(*args))
    found = jax.jit(jax.vmap(jax.vmap(step)))(states)
    pushed = np.asarray(expected.velocity) - np.asarray(states.velocity) + [0.0, 0.2]
    assert np.mean(np.abs(pushed).max(axis=-1) > 0.1) > 0.3  # the ground pushes many
    tolerance = 1e-5 if dtype == "float32" else 1e-12
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, atol=tolerance, rtol=tolerance)

    with as_for_a_gpu(monkeypatch):  # Triton's program is made on any machine
        traced = jax.jit(jax.vmap(jax.vmap(lambda state: step(state)))).trace(states)
        assert "triton" in traced.lower(lowering_platforms=("cuda",)).as_text()
