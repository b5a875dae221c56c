"""Our environments in Gymnasium's hands, and Gymnasium's in ours."""

import re
import sys

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

from bojax.config.errors import ConfigError
from bojax.engine.build import build
from bojax.envs import settings as envs
from bojax.envs.gymnasium import GymnasiumEnv, Idling
from bojax.envs.spaces import Box, Discrete
from bojax.numerics.trial import Misfit
from tests.refusals import assert_refused


class Toy(gymnasium.Env):
    """Pays what it is told, counts its resets and steps, and ends when it is told."""

    def __init__(
        self,
        observations=None,
        actions=None,
        shape=None,
        reward=1.0,
        ends_after=3,
        fails=False,
        exits="never",
        has_spaces=True,
    ):
        if not has_spaces:
            return
        if exits == "init":
            sys.exit(0)
        self.exits = exits
        self.observation_space = observations or spaces.Box(-1.0, 1.0, (2, 3))
        self.action_space = actions or spaces.Discrete(2, start=5)
        self.shape = shape or self.observation_space.shape
        self.reward, self.ends_after, self.fails = reward, ends_after, fails
        self.num_resets = self.num_steps = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.num_resets, self.num_steps = self.num_resets + 1, 0
        return np.zeros(self.shape), {}

    def step(self, action):
        if self.exits == "step":
            sys.exit(0)
        if self.exits == "quit":
            raise GeneratorExit
        if self.fails:
            raise RuntimeError("out of\nfuel")
        assert self.action_space.contains(action), action
        self.num_steps += 1
        ends = self.num_steps == self.ends_after
        return np.full(self.shape, 0.1 * self.num_steps), self.reward, ends, False, {}


class Telling(Toy):
    """A toy on two numbers whose `info` is a function of the number of the step, and of whether it ends."""

    def __init__(self, tell, ends_after=3):
        super().__init__(spaces.Box(-10.0, 10.0, (2,)), ends_after=ends_after)
        self.tell = tell

    def step(self, action):
        observation, reward, ends, truncated, _ = super().step(action)
        return observation, reward, ends, truncated, self.tell(self.num_steps, ends)


@pytest.fixture
def toy():
    """Register the toy under a name; its constructor takes what it is given."""
    gymnasium.register("Toy-v0", Toy, max_episode_steps=40)
    gymnasium.register("Endless-v0", Toy)
    yield lambda **settings: build(envs.Gymnasium(**{"id": "Toy-v0"} | settings), "float32")
    for name in ("Toy-v0", "Endless-v0"):
        del gymnasium.registry[name]


@pytest.mark.filterwarnings("ignore::UserWarning")  # on its advice for action spaces
@pytest.mark.parametrize("schema", [envs.SinglePendulum, envs.CartpoleSwingUp, envs.Chain])
def test_ours_pass_gymnasiums_checks(schema):
    check_env(GymnasiumEnv(build(schema(), "float32")))


def test_an_episode_is_truncated_at_the_limit_and_repeats_with_its_seed():
    env = GymnasiumEnv(build(envs.SinglePendulum(max_steps=5, goal_angle=1e-9), "float32"))

    def episode(seed):
        first, _ = env.reset(seed=seed)
        steps = [env.step(np.array([2.0], np.float32)) for _ in range(5)]
        assert [step[3] for step in steps] == [False] * 4 + [True]
        assert not any(step[2] for step in steps)
        return np.stack([first, *(step[0] for step in steps)])

    np.testing.assert_array_equal(episode(1), episode(1))
    assert np.abs(episode(1) - episode(2)).max() > 0.01
    again = [env.reset()[0] for _ in range(2)]
    assert np.abs(again[0] - again[1]).max() > 0.01  # without a seed, episodes differ


def test_stepping_comes_after_a_reset():
    with pytest.raises(gymnasium.error.ResetNeeded):
        GymnasiumEnv(build(envs.Chain())).step(0)


def test_spaces_are_read():
    env = build(envs.Gymnasium(id="MountainCar-v0"), "float32")
    assert isinstance(env.observation_space, Box) and env.observation_space.low.dtype == jnp.float32
    np.testing.assert_allclose(env.observation_space.low, [-1.2, -0.07])
    np.testing.assert_allclose(env.observation_space.high, [0.6, 0.07])
    assert isinstance(env.action_space, Discrete) and env.action_space.num == 3
    assert env.max_steps == 200
    assert build(envs.Gymnasium(id="MountainCar-v0", max_steps=9), "float32").max_steps == 9
    given = build(envs.Gymnasium(id="CartPole-v1", low=-3.0, high=[1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_array_equal(given.observation_space.low, [-3.0] * 4)
    np.testing.assert_array_equal(given.observation_space.high, [1.0, 2.0, 3.0, 4.0])


def test_observations_are_flattened_and_actions_count_from_0(toy):
    env = toy()
    assert env.observation_space.num_dims == 6 and env.action_space.num == 2
    vector = env.make_vector(2)
    observation, _ = vector.reset(seed=[0, 1])
    assert observation.shape == (2, 6) and observation.dtype == np.float32
    vector.step(np.array([0, 1]))  # the toy takes 5 and 6 only
    numbers = toy(kwargs={"observations": None, "ends_after": 2})
    assert numbers.kwargs == '{"ends_after": 2, "observations": null}'


def test_a_box_of_actions_is_clipped_shaped_and_rounded():
    def taken(space, action, num):
        seen = []

        class Recorder(Toy):
            def step(self, action):
                seen.append(np.array(action))
                return super().step(action)

        box = Box(-jnp.ones(num), jnp.ones(num))
        env = Idling(Recorder(actions=space), Box(-jnp.ones(6), jnp.ones(6)), box)
        env.reset(seed=0)
        env.step(np.asarray(action))
        return seen[0]

    found = taken(spaces.Box(-2.0, 2.0, (2, 2)), [0.5, -0.5, 7.0, -7.0], 4)
    np.testing.assert_array_equal(found, [[0.5, -0.5], [2.0, -2.0]])
    found = taken(spaces.Box(0, 4, (4,), np.int64), [0.4, 0.6, 3.7, 9.0], 4)
    np.testing.assert_array_equal(found, [0, 1, 4, 4])
    assert found.dtype == np.int64


def test_lanes_wait_at_the_end_of_their_episodes_until_they_are_seeded(toy):
    env = toy(kwargs={"ends_after": 2})
    vector = env.make_vector(2)
    vector.reset(seed=[0, 1])
    vector.envs[1].unwrapped.ends_after = 4
    steps = [vector.step(np.array([0, 0])) for _ in range(6)]
    np.testing.assert_array_equal(
        [step[2] for step in steps],  # each end is told once
        [[False, False], [True, False], [False, False], [False, True], [False, False], [False, False]],
    )
    np.testing.assert_array_equal([step[1][0] for step in steps], [1, 1, 0, 0, 0, 0])
    np.testing.assert_allclose([step[0][0, 0] for step in steps], [0.1, 0.2, 0.2, 0.2, 0.2, 0.2], rtol=1e-6)
    assert [part.unwrapped.num_resets for part in vector.envs] == [1, 1]
    vector.reset(seed=[2, 3])
    assert [part.unwrapped.num_resets for part in vector.envs] == [2, 2]
    assert vector.step(np.array([0, 0]))[1].tolist() == [1.0, 1.0]


def test_the_time_limit_of_gymnasium_is_off(toy):
    vector = toy(kwargs={"ends_after": -1}).make_vector(1)
    vector.reset(seed=[0])
    assert not any(vector.step(np.array([0]))[3][0] for _ in range(45))


def test_what_counts_as_success():
    rewards, ends = jnp.asarray([0.0, 1.0, 2.0, 2.0]), jnp.asarray([True, False, False, True])
    told = jnp.asarray([False, False, True, False])
    for settings, expected in (
        ({}, [False, False, False, False]),
        ({"success": "terminated"}, [True, False, False, True]),
        ({"success": "reward", "success_reward": 2.0}, [False, False, True, True]),
    ):
        env = build(envs.Gymnasium(id="MountainCar-v0", **settings), "float32")
        np.testing.assert_array_equal(env.is_success(rewards, ends, told), expected)


INFOS = [
    lambda n, ends: {"is_success": n == 2},  # Gymnasium-Robotics
    lambda n, ends: {"success": float(n == 2), "unscaled_reward": 1.0},  # Meta-World
    lambda n, ends: {"is_success": np.bool_(n == 2), "success": True},  # the first key counts
    lambda n, ends: {"is_success": np.float32(1.0)} if n == 2 else {},
]


@pytest.mark.parametrize("tell", INFOS)
def test_info_tells_success_lane_by_lane(registered, tell):
    env = registered(lambda: Telling(tell, ends_after=30), success="info")
    vector = env.make_vector(2)
    vector.reset(seed=[0, 1])
    vector.envs[1].unwrapped.num_steps = 1  # the second lane is one step ahead
    never = np.zeros(2, bool)
    found = [vector.step(np.array([0, 0]))[4].get("success", never) for _ in range(4)]
    np.testing.assert_array_equal(found, [[False, True], [True, False], [False, False], [False, False]])


def test_success_is_told_by_another_key_and_at_the_end_of_an_episode(registered):
    registered(lambda: Telling(lambda n, ends: {"solved": n > 2}), success="info", success_key="solved")
    env = registered(
        lambda: Telling(lambda n, ends: {"is_success": True} if ends else {}, ends_after=15), success="info"
    )
    vector = env.make_vector(1)
    vector.reset(seed=[0])
    told = ["success" in vector.step(np.array([0]))[4] for _ in range(16)]
    assert told == [False] * 14 + [True, False]


def test_success_that_info_tells_and_nothing_counts_is_noted(registered, capsys):
    registered(lambda: Telling(lambda n, ends: {"is_success": False}))
    (line,) = capsys.readouterr().err.splitlines()
    assert re.fullmatch(r"note: success: got never, but the info of Odd\d+-v0 has is_success, .*", line)
    registered(lambda: Telling(lambda n, ends: {"score": 1}))
    registered(lambda: Telling(lambda n, ends: {"is_success": False}), success="terminated")
    assert capsys.readouterr().err == ""


class Unseeded(Toy):
    """A toy that starts anywhere, whatever the seed."""

    def reset(self, *, seed=None, options=None):
        return np.random.default_rng().uniform(size=self.shape), super().reset(seed=seed)[1]


def test_resets_that_ignore_their_seed_are_noted(registered, capsys):
    registered(Unseeded)
    (line,) = capsys.readouterr().err.splitlines()
    assert re.fullmatch(r"note: Odd\d+-v0: two resets with one seed differ, so that no run can be .*", line)


def test_info_that_does_not_tell_success_is_refused(registered):
    missing = r"success: got info; Odd\d+-v0 has no {} in the info of an episode of {} steps, {}; set"
    both, value = "is_success or success", r'step returns info\["is_success"\] as {}; allowed: True or False'
    bad = [
        (lambda n, ends: {}, {}, missing.format(both, 3, "which is empty")),
        (lambda n, ends: {"score": 1, "won": False}, {}, missing.format(both, 3, "but score, won")),
        (lambda n, ends: {"won": 1}, {"ends_after": -1}, missing.format(both, 20, "but won")),
        (
            lambda n, ends: {"is_success": True},
            {"success_key": "won"},
            missing.format("won", 3, "but is_success"),
        ),
        (lambda n, ends: {"is_success": "yes"}, {}, value.format("'yes'")),
        (lambda n, ends: {"is_success": 0.5}, {}, value.format("0.5")),
        (lambda n, ends: {"is_success": np.nan}, {}, value.format("nan")),
        (lambda n, ends: {"is_success": np.array([True])}, {}, value.format(r"array\(\[ True\]\)")),
        (lambda n, ends: None, {}, "step returns info as NoneType; allowed: a dictionary"),
    ]

    def made(tell, ends_after=3, **settings):
        return registered(lambda: Telling(tell, ends_after=ends_after), success="info", **settings)

    assert_refused([(lambda t=t, s=s: made(t, **s), message) for t, s, message in bad], ConfigError)
    with pytest.raises(ValueError, match='success_key: got "won"; allowed: null, unless success is info'):
        envs.Gymnasium(id="Toy-v0", success="reward", success_key="won")


def test_it_cannot_be_compiled():
    env = build(envs.Gymnasium(id="MountainCar-v0"), "float32")
    with pytest.raises(TypeError, match="MountainCar-v0 is stepped on the host"):
        jax.jit(lambda key: env.reset(key))(jax.random.key(0))


def test_what_cannot_be_learned_on_is_refused_in_a_line(toy):
    infinite = r"infinite bounds \(component 1, 3\)"
    endless = "max_steps: got null; allowed: a number, since Endless-v0 has no time limit of its own"
    shape = r"Toy-v0: reset returns an observation of shape \(2,\), not \(2, 3\)"
    order = r"observation space: low is not below high \(component 0, 1, 2, 3, 4, 5\)"
    bad = [
        ({"id": "MountainCart-v0"}, 'id: got "MountainCart-v0"; .*doesn\'t exist.*MountainCar.*MODULE:ID'),
        ({"id": "no_such:Env-v0"}, "No module named 'no_such'"),
        ({"kwargs": {"wheels": 4}}, "unexpected keyword argument 'wheels'"),
        ({"id": "CartPole-v1"}, rf"{infinite}: set low and high, such as high=\[1.0, 1.0, 1.0, 1.0\]"),
        ({"id": "CartPole-v1", "low": -1.0}, infinite),
        ({"low": [0.0, 1.0]}, "low: got 2 numbers; there are 6 in an observation"),
        ({"low": 1.0}, order),
        ({"id": "Endless-v0"}, endless),
        ({"kwargs": {"fails": True}}, "Toy-v0 fails in step 1: RuntimeError: out of fuel"),
        ({"kwargs": {"exits": "step"}}, "Toy-v0 fails in step 1: SystemExit: 0"),
        ({"kwargs": {"exits": "quit"}}, "Toy-v0 fails in step 1: GeneratorExit"),
        ({"kwargs": {"has_spaces": False}}, 'id: got "Toy-v0"; AttributeError'),
        ({"kwargs": {"exits": "init"}}, 'id: got "Toy-v0"; SystemExit: 0'),
        ({"kwargs": {"shape": [2]}}, shape),
        ({"kwargs": {"reward": [1.0, 2.0]}}, r"Toy-v0: step returns a reward of shape \(2,\)"),
    ]
    assert_refused([(lambda s=s: toy(**s), message) for s, message in bad], ConfigError)


def odd(**parts):
    """A toy on two numbers, with some of the five values of a step, or of the two of a reset, replaced."""

    class Odd(Toy):
        def reset(self, *, seed=None, options=None):
            return parts.get("reset", super().reset(seed=seed))

        def step(self, action):
            observation, reward, terminated, truncated, info = super().step(action)
            if self.num_steps < parts.get("after", 0):
                return observation, reward, terminated, truncated, info
            values = {"observation": observation, "reward": reward, "terminated": terminated}
            values |= {"truncated": truncated, "info": info} | parts
            return tuple(values[name] for name in parts.get("names", tuple(values)[:5]))

    space = parts.get("space", spaces.Box(-1.0, 1.0, (2,)))
    return Odd(space, ends_after=30)


TWO = np.zeros(2, np.float32)
THREE, FINITE = spaces.Discrete(3), "is not finite in the precision of the run"
FOUR = "step returns 4 values; allowed: 5 \\(observation, reward, terminated, truncated, info\\)"
OUTSIDE = "the observation of reset is out of bounds \\(component 1\\): set low and high"
ODD = [
    ({"names": ("observation", "reward", "truncated", "info")}, FOUR),
    ({"reset": TWO}, "reset returns one ndarray; allowed: an observation and a dictionary"),
    ({"reset": (0.0, 0.0)}, "reset returns 2 values; allowed: an observation and a dict"),
    ({"truncated": {}}, "step returns truncated as dict; allowed: True or False"),
    ({"terminated": None}, "step returns terminated as NoneType; allowed: True or False"),
    ({"terminated": np.array([True])}, "step returns terminated as ndarray"),
    ({"reward": "1.0"}, "step returns a reward of type str; allowed: a number"),
    ({"reward": None}, "step returns a reward of type NoneType; allowed: a number"),
    ({"reward": np.nan, "after": 7}, f"the reward of step 7 {FINITE}"),
    ({"reward": 1e39}, f"the reward of step 1 {FINITE}"),
    ({"observation": TWO * np.nan, "after": 10}, "the observation of step 10 is not finite"),
    ({"observation": np.zeros(3), "after": 4}, r"step returns an observation of shape \(3,\), not \(2,\)"),
    ({"reset": (TWO + 1j, {})}, "reset returns an observation of dtype complex64; allowed: num"),
    ({"observation": {"x": 1.0}}, "step returns an observation of dtype object; allowed: numbers"),
    ({"observation": [[1.0], []]}, "step returns an observation that is no array"),
    ({"reset": (np.array([0.5, 1.5]), {})}, OUTSIDE),
    (
        {"space": THREE, "reset": (np.float32(0.5), {})},
        "reset returns an observation of dtype float32; allowed: integers",
    ),
    (
        {"space": spaces.Discrete(3, start=1), "reset": (0, {})},
        "reset returns an observation of 0; allowed: 1 to 3",
    ),
]


@pytest.fixture
def registered(toy):
    """Build an environment that a function makes."""
    names = []

    def built(make, **settings):
        names.append(f"Odd{len(names)}-v0")
        gymnasium.register(names[-1], lambda **_: make(), max_episode_steps=20)
        return toy(id=names[-1], **settings)

    yield built
    for name in names:
        del gymnasium.registry[name]


@pytest.mark.filterwarnings("error")
def test_the_trial_finds_what_does_not_follow_the_interface(registered):
    odds = [(lambda p=p: registered(lambda: odd(**p)), rf"Odd\d+-v0: {message}") for p, message in ODD]
    assert_refused(odds, ConfigError)
    registered(lambda: odd(observation=[0.5, 1.5]), low=-2.0, high=2.0)
    registered(lambda: odd(reward=np.float64(1.0), terminated=np.bool_(False), observation=[0, True]))


def test_after_the_trial_each_step_is_checked(registered):
    for parts, message in ODD:
        if "reset" in parts or "finite" in message:  # what is not finite ends the run, which counts it
            continue
        vector = registered(lambda parts=parts: odd(**parts | {"after": 12})).make_vector(1)
        vector.reset(seed=[0])
        for _ in range(11):
            vector.step(np.array([0]))
        with pytest.raises(Misfit, match=rf"Odd\d+-v0: {message}"):
            vector.step(np.array([0]))


def test_other_spaces_are_refused(registered):
    mixed = spaces.Dict(gear=THREE, throttle=spaces.Box(0.0, 1.0))
    others = [
        (
            {"observations": spaces.Text(4)},
            r"observation space Text\(.*\): cannot be a vector; allowed: boxes",
        ),
        (
            {"observations": spaces.Dict(image=spaces.Box(0, 1), mission=spaces.Text(4))},
            r"observation space Dict.*, whose part mission is Text\(.*\): cannot be a vector; allowed",
        ),
        ({"observations": spaces.Tuple([spaces.Sequence(THREE)])}, "whose part 0 is Sequence"),
        (
            {"observations": spaces.Dict(a=THREE, goal=spaces.Box(-np.inf, np.inf, (2,)))},
            r"observation space has infinite bounds \(component 3, 4\): set low and high",
        ),
        ({"actions": spaces.MultiBinary(13)}, r"8,192 combinations; allowed: at most 4,096"),
        ({"actions": mixed}, "mixes both; allowed: discrete parts alone, or boxes alone"),
        ({"actions": spaces.Dict(a=spaces.Box(-np.inf, 1.0, (1,)))}, "infinite bounds .* finite ones"),
        ({"actions": spaces.Box(-np.inf, 1.0, (1,))}, "action space has infinite bounds .* finite ones"),
    ]
    assert_refused(
        [(lambda p=p: registered(lambda: Toy(**p)), message) for p, message in others], ConfigError
    )
