"""Robots that are learned on, against Gymnasium's and dm-control's models and the words of the thesis."""

import dataclasses
import functools
from pathlib import Path

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pydantic
import pytest
from scipy import stats

from bojax.config.errors import ConfigError
from bojax.engine.build import build
from bojax.envs.check import check_env
from bojax.envs.control import ControlStep
from bojax.envs.robots import settings as envs
from bojax.envs.robots.reacher import Reacher, fingertip
from bojax.robots.models import RobotModel, jaco_model
from tests.compiling import REPEATABLY
from tests.reference.jaco import dm_control_jaco, finger_tips

LANES, STEPS = 8, 50
GYM = {"hopper": "Hopper-v5", "reacher": "Reacher-v5"}
CLASSIC = {"hopper": envs.Hopper(reward="classic"), "reacher": envs.Reacher(reward="classic")}


compiled = functools.partial(eqx.filter_jit, compiler_options=REPEATABLY)


@functools.cache
def built(schema, dtype="float32"):
    return build(schema, dtype)


@compiled
def rollout(env, states, actions):
    """States after each step of each lane, and the transitions."""

    def lane(state, actions):
        def go_on(state, action):
            after, transition = env.step(jax.random.key(0), state, action)
            return after, (after, transition)

        return jax.lax.scan(go_on, state, actions)[1]

    return jax.vmap(lane)(states, actions)


@compiled
def resets(env, num):
    return jax.vmap(env.reset)(jax.random.split(jax.random.key(3), num))


@functools.cache
def beside_gymnasium(kind):
    """Our states and transitions, and Gymnasium's states, rewards and ends, under the same actions."""
    pytest.importorskip("imageio")  # without which Gymnasium's MuJoCo environments are not there
    env, theirs = built(CLASSIC[kind]), gymnasium.make(GYM[kind]).unwrapped
    theirs.reset(seed=0)
    model, rng = theirs.model, np.random.default_rng(0)
    qpos = model.qpos0 + rng.uniform(-0.05, 0.05, (LANES, model.nq))
    qvel = rng.uniform(-0.5, 0.5, (LANES, model.nv))
    if kind == "reacher":
        qvel[:, 2:] = 0.0  # of the target
    qpos, qvel = qpos.astype(np.float32), qvel.astype(np.float32)
    actions = rng.uniform(-1, 1, (LANES, STEPS, model.nu)).astype(np.float32)
    rows = []
    for lane in range(LANES):
        theirs.set_state(qpos[lane].astype(float), qvel[lane].astype(float))
        for action in actions[lane]:
            observation, reward, ends, _, _ = theirs.step(action.astype(float))
            rows.append((theirs.data.qpos.copy(), theirs.data.qvel.copy(), observation, reward, ends))
    gym = [np.array(column).reshape(LANES, STEPS, -1) for column in zip(*rows, strict=True)]
    states = jax.jit(jax.vmap(env.simulator.state))(jnp.asarray(qpos), jnp.asarray(qvel))
    return env, actions, rollout(env, states, jnp.asarray(actions)), gym, model


@pytest.mark.parametrize("kind", GYM)
def test_states_are_gymnasiums(kind):
    _, _, (states, _), (qpos, qvel, *_), _ = beside_gymnasium(kind)
    np.testing.assert_allclose(states.qpos, qpos, atol=1e-4)
    np.testing.assert_allclose(states.qvel, qvel, atol=5e-3, rtol=1e-3)


def test_hopper_sees_and_pays_as_gymnasiums():
    _, _, (_, transition), (_, _, observations, rewards, ends), _ = beside_gymnasium("hopper")
    np.testing.assert_allclose(transition.observation, observations, atol=5e-3, rtol=1e-3)
    # A velocity of the torso over a step of 8 ms: positions of 32 bits are 1e-7 off.
    np.testing.assert_allclose(transition.reward, rewards[..., 0], atol=2e-3)
    np.testing.assert_array_equal(transition.terminated, ends[..., 0])
    assert 0.1 < ends.mean() < 0.9


def test_reacher_sees_and_pays_as_gymnasiums():
    """Gymnasium has the finger tip where it was a substep before; mj_forward has it where the state does."""
    _, actions, (_, transition), (qpos, qvel, observations, rewards, ends), model = beside_gymnasium(
        "reacher"
    )
    data, gaps = mujoco.MjData(model), []
    for row in qpos.reshape(-1, 4):
        data.qpos = row
        mujoco.mj_forward(model, data)
        gaps.append(data.body("fingertip").xpos - data.body("target").xpos)
    gaps = np.array(gaps).reshape(LANES, STEPS, 3)
    np.testing.assert_allclose(transition.observation[..., :8], observations[..., :8], atol=5e-3, rtol=1e-4)
    np.testing.assert_allclose(transition.observation[..., 8:], gaps, atol=1e-4)
    expected = -np.linalg.norm(gaps, axis=-1) - np.sum(actions.astype(float) ** 2, axis=-1)
    np.testing.assert_allclose(transition.reward, expected, atol=1e-4)
    travelled = 0.01 * np.abs(qvel[..., 0] + qvel[..., 1]) * 0.11 + 0.01 * np.abs(qvel[..., 0]) * 0.1
    assert np.all(np.abs(np.asarray(transition.reward) - rewards[..., 0]) < 1.5 * travelled + 0.01)
    assert not np.any(transition.terminated) and not np.any(ends)
    np.testing.assert_array_equal(transition.success, np.linalg.norm(gaps, axis=-1) < 0.015)


def test_hopper_succeeds_and_fails_where_the_thesis_says():
    def at(height, angle, **settings):
        env = built(envs.Hopper(**settings))
        state = env.simulator.state(jnp.asarray([0.0, height, angle, 0.0, 0.0, 0.0]), jnp.zeros(6))
        return bool(env.is_goal(state)), bool(env.is_failure(state))

    assert at(1.29, 0.19) == (False, False)
    assert at(1.31, 0.19) == (True, False)
    assert at(1.29, 0.21) == at(1.29, -0.21) == (False, True)
    assert at(1.31, -0.21) == (True, True)  # which `ControlTask` counts as a failure
    assert at(0.69, 0.0) == (False, False)
    assert at(0.69, 0.0, failure_height=0.7) == (False, True)
    assert at(1.31, 0.0, goal_height=1.4) == (False, False)


def test_hopper_pays_the_published_reward():
    env = built(envs.Hopper(reward="classic", classic_reward="published"))
    state = env.simulator.state(jnp.asarray([0.0, 1.0, 0.3, 0.0, 0.0, 0.0]), jnp.zeros(6))

    def paid(success, failure):
        step = ControlStep(
            state, jnp.zeros(3, jnp.float32), state, jnp.asarray(success), jnp.asarray(failure)
        )
        reward, ends = env.classic(step)
        return reward.item(), ends.item()

    assert paid(False, False) == (-1.0, False)  # although Gym's ends at this angle
    assert paid(True, False) == (0.0, True)
    assert paid(False, True) == (-1000.0, True)


def test_the_second_action_of_the_reacher_can_be_fixed():
    env, actions, *_ = beside_gymnasium("reacher")  # whose program serves here too
    fixed = built(envs.Reacher(reward="classic", second_action="fixed"))
    still = jnp.zeros((LANES, env.simulator.mujoco_model.nq), jnp.float32)
    states, told = jax.jit(jax.vmap(env.simulator.state))(still, still), jnp.asarray(actions)
    expected = rollout(env, states, told.at[..., 1].set(1.0))
    found = rollout(fixed, states, told)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert not np.allclose(rollout(env, states, told)[1].reward, expected[1].reward)


@pytest.mark.parametrize(
    "schema",
    [envs.Hopper(reward="classic"), envs.Reacher(), envs.Jaco(reward="classic", targets="per-episode")],
    ids=lambda schema: schema.kind,
)
def test_they_compute_in_the_precision_of_the_run(schema):
    """Without compiling: the physics stays in 32 bits, what a learner gets does not."""
    env = build(schema, "float64")

    def one_step(key):
        state = env.of_run(key).reset(key)
        after, transition = env.step(key, state, env.action_space.high)
        return state, after, transition, env.frame(state)

    with jax.debug_key_reuse(False):
        state, after, transition, frame = jax.eval_shape(one_step, jax.random.key(0))
    assert frame.shape == (env.frame_size,)
    assert jax.tree.structure(state) == jax.tree.structure(after)
    assert [leaf.dtype for leaf in jax.tree.leaves(state)] == [leaf.dtype for leaf in jax.tree.leaves(after)]
    assert transition.observation.dtype == transition.reward.dtype == jnp.float64
    assert transition.observation.shape == env.observation_space.low.shape
    assert env.observation_space.low.dtype == env.action_space.low.dtype == jnp.float64


def test_hopper_begins_as_in_gym():
    state = resets(built(CLASSIC["hopper"]), 2000)
    standing = np.array([0.0, 1.25, 0.0, 0.0, 0.0, 0.0])
    drawn = np.concatenate([np.asarray(state.qpos) - standing, state.qvel], axis=1)
    for column in drawn.T:
        assert stats.kstest(column, "uniform", args=(-0.005, 0.01)).pvalue > 1e-3
    assert np.abs(np.corrcoef(drawn.T) - np.eye(12)).max() < 0.1


def test_reacher_begins_as_in_gym():
    state = resets(built(CLASSIC["reacher"]), 2000)
    x, y = np.asarray(state.qpos)[:, 2:].T
    uniform = {
        "shoulder": (state.qpos[:, 0], -0.1, 0.1),
        "elbow": (state.qpos[:, 1], -0.1, 0.1),
        "speed of the shoulder": (state.qvel[:, 0], -0.005, 0.005),
        "speed of the elbow": (state.qvel[:, 1], -0.005, 0.005),
        "area": (x**2 + y**2, 0.0, 0.04),
        "bearing": (np.arctan2(y, x), -np.pi, np.pi),
    }
    for column, low, high in uniform.values():
        assert stats.kstest(np.asarray(column), "uniform", args=(low, high - low)).pvalue > 1e-3
    drawn = np.array([column for column, _, _ in uniform.values()])
    assert np.abs(np.corrcoef(drawn) - np.eye(6)).max() < 0.1
    np.testing.assert_array_equal(state.qvel[:, 2:], 0.0)


def test_the_finger_tip_of_the_reacher_is_its_models():
    model = built(CLASSIC["reacher"]).simulator.mujoco_model
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for angles in rng.uniform(-3, 3, (50, 2)):
        data.qpos[:2] = angles
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(
            fingertip(jnp.asarray(angles)), data.site("fingertip").xpos[:2], atol=1e-12
        )


def test_settings_that_make_no_sense_are_refused():
    for schema, settings, complaint in (
        (envs.Reacher, {"target_radius": 0.22}, "less than or equal to 0.21"),
        (envs.Jaco, {"joints": (2, 2)}, "duplicate entry"),
        (envs.Hopper, {"goal_height": 1.2}, "greater than 1.26"),
    ):
        with pytest.raises(pydantic.ValidationError, match=complaint):
            schema(**settings)


@functools.cache
def kinova() -> Path:
    """dm-control's folder of the Jaco."""
    return Path(pytest.importorskip("dm_control").__file__).parent / "third_party" / "kinova"


@pytest.mark.parametrize("joints", [(1, 2), (2, 3), (3, 5), (1, 2, 3, 4, 5, 6)])
def test_jaco_has_the_dynamics_of_dm_controls(joints):
    ours, theirs = jaco_model(joints).compiled(), dm_control_jaco(joints, kinova())
    data = [mujoco.MjData(ours), mujoco.MjData(theirs)]
    rng = np.random.default_rng(0)
    for _ in range(100):
        qpos = ours.qpos0 + rng.uniform(-2, 2, len(joints))
        qvel, torque = rng.uniform(-3, 3, (2, len(joints)))
        inertias = []
        for model, state in zip((ours, theirs), data, strict=True):
            state.qpos, state.qvel, state.ctrl = qpos, qvel, torque / 3
            mujoco.mj_forward(model, state)
            inertias.append(np.zeros((model.nv, model.nv)))
            mujoco.mj_fullM(model, state, inertias[-1])
        np.testing.assert_allclose(*inertias, atol=2e-5)
        np.testing.assert_allclose(data[0].qfrc_bias, data[1].qfrc_bias, atol=5e-4)
        np.testing.assert_array_equal(data[0].qfrc_actuator, data[1].qfrc_actuator)
        np.testing.assert_allclose(data[0].site("finger_tips").xpos, finger_tips(theirs, data[1]), atol=2e-5)
    np.testing.assert_array_equal(ours.dof_armature, theirs.dof_armature)
    np.testing.assert_array_equal(ours.dof_frictionloss, theirs.dof_frictionloss)
    np.testing.assert_allclose(ours.jnt_range, theirs.jnt_range, atol=1e-5)


def test_jaco_moves_as_dm_controls():
    """50 steps of 40 ms: 500 of the physics, in which sticking and slipping joints part company slowly."""
    ours, theirs = jaco_model((1, 2)).compiled(), dm_control_jaco((1, 2), kinova())
    ours.opt.iterations, ours.opt.ls_iterations = theirs.opt.iterations, theirs.opt.ls_iterations
    rng, gaps = np.random.default_rng(0), []
    for _ in range(LANES):
        data = [mujoco.MjData(ours), mujoco.MjData(theirs)]
        start = ours.qpos0 + rng.uniform(-1, 1, 2)
        for state in data:
            state.qpos = start
        for control in rng.uniform(-1, 1, (STEPS, 2)):
            for model, state in zip((ours, theirs), data, strict=True):
                state.ctrl = control
                mujoco.mj_step(model, state, nstep=10)
        assert np.abs(data[0].qpos - start).max() > 0.05
        gaps.append(np.abs(data[0].qpos - data[1].qpos).max())
    assert max(gaps) < 1e-4


@pytest.fixture(scope="module")
def jaco():
    return built(envs.Jaco())


@pytest.fixture(scope="module")
def starts():
    """Starts of the arm in 64 runs, two each, and the same with a target for every episode."""

    @compiled
    def drawn(env):
        def run(key):
            keys = jax.random.split(key, 3)
            return jax.vmap(env.of_run(keys[0]).reset)(keys[1:])

        return jax.vmap(run)(jax.random.split(jax.random.key(0), 64))

    return {targets: drawn(built(envs.Jaco(targets=targets))) for targets in ("per-run", "per-episode")}


def test_a_target_is_that_of_the_run_or_of_the_episode(starts):
    of_run, of_episode = (np.asarray(starts[name].target) for name in ("per-run", "per-episode"))
    np.testing.assert_array_equal(of_run[:, 0], of_run[:, 1])
    assert np.all(np.linalg.norm(of_episode[:, 0] - of_episode[:, 1], axis=-1) > 0)
    assert len(np.unique(of_run[:, 0], axis=0)) == 64
    qpos = np.asarray(starts["per-run"].robot.qpos)
    assert np.abs(qpos - [0.0, np.pi]).max() < 0.1 + 1e-6
    assert np.abs(qpos[:, 0] - qpos[:, 1]).min() > 0


def test_only_a_target_of_the_episode_is_observed(starts):
    state = jax.tree.map(lambda leaf: leaf[0, 0], starts["per-episode"])
    seen = built(envs.Jaco(targets="per-episode")).observe(state)
    np.testing.assert_array_equal(seen[6:], state.target)
    np.testing.assert_array_equal(built(envs.Jaco()).observe(state), seen[:6])


def test_every_target_can_be_reached_and_none_is_where_the_arm_starts(jaco, starts):
    model = jaco.simulator.mujoco_model
    data, tips = mujoco.MjData(model), []
    for shoulder in np.linspace(0.820305, 5.462881, 200):
        data.qpos = [0.0, shoulder]
        mujoco.mj_forward(model, data)
        tips.append(data.site("finger_tips").xpos.copy())
    tips = np.array(tips)
    # Joint 1 turns all of it about the vertical axis: radius and height tell whether it is reached.
    reached = np.stack([np.hypot(tips[:, 0], tips[:, 1]), tips[:, 2]], axis=-1)
    for targets in starts.values():
        x, y, z = np.asarray(targets.target).reshape(-1, 3).T
        gaps = np.stack([np.hypot(x, y), z], axis=-1)[:, None] - reached[None]
        assert np.linalg.norm(gaps, axis=-1).min(axis=1).max() < 0.02
        data.qpos = model.qpos0
        mujoco.mj_forward(model, data)
        away = np.stack([x, y, z], axis=-1) - data.site("finger_tips").xpos
        assert np.linalg.norm(away, axis=-1).min() > 0.2


@pytest.mark.slow
def test_an_arm_that_knows_the_angles_of_its_target_gets_there(jaco):
    """PD control in all lanes, and uniformly random actions in the others, from the same states."""
    model, rng = jaco.simulator.mujoco_model, np.random.default_rng(0)
    data, goals, targets = mujoco.MjData(model), [], []
    while len(goals) < 32:
        data.qpos = rng.uniform([-np.pi, 0.9], [np.pi, 5.4])
        mujoco.mj_forward(model, data)
        if np.linalg.norm(data.site("finger_tips").xpos - [0.0, 0.0, 1.22]) > 0.25:
            goals.append(data.qpos.copy())
            targets.append(data.site("finger_tips").xpos.copy())

    @compiled
    def controlled(env, goals, targets, shares):
        def lane(goal, target, share, key):
            def go_on(carry, key):
                state, is_over = carry
                error = goal - state.robot.qpos
                action = share * jnp.clip(12.0 * error - 5.0 * state.robot.qvel, -1.0, 1.0)
                action = action + (1.0 - share) * jax.random.uniform(key, (2,), jnp.float32, -1.0, 1.0)
                after, transition = env.step(key, state, action)
                return (after, is_over | transition.terminated), (transition, is_over)

            keys = jax.random.split(key, STEPS + 1)
            start = eqx.tree_at(lambda s: s.target, env.reset(keys[0]), target)
            return jax.lax.scan(go_on, (start, jnp.zeros((), bool)), keys[1:])[1]

        return jax.vmap(lane)(goals, targets, shares, jax.random.split(jax.random.key(0), len(goals)))

    goals, targets = (jnp.asarray(np.tile(part, (2, 1)), jnp.float32) for part in (goals, targets))
    shares = jnp.repeat(jnp.asarray([1.0, 0.0], jnp.float32), 32)
    with jax.debug_key_reuse(False):
        transition, is_over = controlled(jaco, goals, targets, shares)
    np.testing.assert_array_equal(transition.reward, np.asarray(transition.success, np.float32))
    np.testing.assert_array_equal(transition.terminated, transition.success)
    reached = np.asarray(transition.success & ~is_over).any(axis=1)
    assert reached[:32].mean() > 0.9 and reached[32:].mean() < 0.25


def test_a_state_that_diverged_pays_no_number():
    env = built(CLASSIC["reacher"])
    state = env.simulator.state(jnp.zeros((LANES, 4)), jnp.zeros((LANES, 4)).at[2, 0].set(1e9))
    _, transition = rollout(env, state, jnp.zeros((LANES, STEPS, 2), jnp.float32))
    np.testing.assert_array_equal(np.isnan(transition.reward[:, 0]), np.arange(LANES) == 2)


def test_a_jaco_that_begins_at_its_goal_is_refused_in_one_line():
    """Joint 6 moves the finger tips by 4 cm; within 0.6 m most targets are as good as reached."""
    for schema in (envs.Jaco(joints=(6,)), envs.Jaco(joints=(1,)), envs.Jaco(goal_distance=0.6)):
        with pytest.raises(ConfigError, match=r"^jaco: joints, goal_distance: joints [^\n]*$"):
            build(schema, "float32")
    env = build(envs.Jaco(joints=(5,)), "float32")
    with pytest.raises(ValueError, match="60 m"):
        dataclasses.replace(env, goal_distance=jnp.asarray(30.0))
    given = dataclasses.replace(env, target=jnp.zeros(3))  # a target of one's own
    assert dataclasses.replace(given, goal_distance=jnp.asarray(30.0)).goal_distance == 30.0


class Loose(Reacher):
    """A reacher with a model of its own."""

    motors: str = eqx.field(static=True, kw_only=True)

    @property
    def model(self) -> RobotModel:
        joint = '<joint name="x" type="slide" axis="1 0 0"/>'
        body = f'<body>{joint}<geom size="0.1" mass="1" contype="0"/></body>'
        worldbody = f"<worldbody>{body}</worldbody>"
        return RobotModel(f"<mujoco>{worldbody}<actuator>{self.motors}</actuator></mujoco>")


def test_actuators_without_limits_are_refused_by_name():
    settings = {
        field.name: getattr(built(envs.Reacher()), field.name) for field in dataclasses.fields(Reacher)
    }
    bound, free = '<motor name="push" joint="x" ctrlrange="-1 1"/>', '<motor name="pull" joint="x"/>'
    assert Loose(**settings, motors=bound).action_space.high.tolist() == [1.0]
    with pytest.raises(ValueError, match=r"^model: [^\n]* no ctrlrange of actuators pull, 2$"):
        Loose(**settings, motors=bound + free + '<motor joint="x"/>')


class Misplaced(Reacher):
    """A reacher whose model has no mocap body for its target."""

    def mocap_positions(self, state):
        return state.qpos[2:]


class Square(Reacher):
    """A reacher whose frames are no vectors."""

    def frame(self, state):
        return state.qpos.reshape(2, 2)


def test_frames_that_no_film_can_draw_are_refused_in_one_line():
    reacher = built(envs.Reacher())
    settings = {field.name: getattr(reacher, field.name) for field in dataclasses.fields(Reacher)}
    for kind, reason in (
        (Misplaced, r"mocap_positions has the shape \(2,\); the model needs \(0,\)"),
        (Square, r"frame has shape \(2, 2\); allowed: a vector"),
    ):
        with pytest.raises(ValueError, match=rf"^{kind.__name__}: [^\n]*{reason}[^\n]*$"):
            check_env(kind(**settings), "float32")
