"""Films of Gymnasium environments: recorded episodes are stepped again, and the environment draws itself."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from PIL import Image

from bojax.cli.main import main
from bojax.engine.replay import Replay
from bojax.envs.settings import Gymnasium
from bojax.report.source import load
from tests.runs import run

LEARNER = "learner={kind: rff-q, features: {num_features: 16}}"


class Walk(gymnasium.Env):
    """A noisy walk from a random place; its picture is grey, as bright as the place is high."""

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 20}
    observation_space = spaces.Box(-10.0, 10.0, (1,))
    action_space = spaces.Discrete(3, start=-1)

    def __init__(self, render_mode=None, shape=(12, 16, 3), is_secret=False):
        self.render_mode, self.shape, self.is_secret = render_mode, shape, is_secret

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-1.0, 1.0)
        return self.seen(), {}

    def step(self, action):
        noise = np.random.default_rng().normal() if self.is_secret else self.np_random.normal()
        self.place += 0.2 * int(action) + 0.1 * noise
        return self.seen(), self.place, abs(self.place) > 1.5, False, {}

    def seen(self):
        return np.array([self.place], np.float32)

    def render(self):
        assert self.render_mode == "rgb_array"
        return np.full(self.shape, np.clip(128 + 60 * self.place, 0, 255), np.uint8)


class Silent(Walk):
    metadata = {"render_modes": ["human"]}


@pytest.fixture(scope="module", autouse=True)
def walks():
    names = {"Walk-v0": Walk, "Silent-v0": Silent}
    for name, env in names.items():
        gymnasium.register(name, env, max_episode_steps=12)
    yield
    for name in names:
        del gymnasium.registry[name]


def recorded(folder, id="Walk-v0", *settings):
    env = f"env={{kind: gymnasium, id: {id}}}"
    return run(folder, "mountain-car", env, LEARNER, "stop=never", "episodes=3", *settings, "--runs", "2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("replay") / "walk")


def steps_of(folder, number, episode):
    steps = load(folder).steps
    chosen = (steps["run"] == number) & (steps["episode"] == episode)
    return steps["observation_0"][chosen], steps["action_0"][chosen]


@pytest.mark.parametrize("starts", ["per-episode", "per-run"])
def test_a_replay_has_the_recorded_observations(folder, tmp_path, starts):
    if starts == "per-run":
        folder = recorded(tmp_path / "walk", "Walk-v0", "starts=per-run")
    for number in (0, 1):
        for episode in (1, 3):
            observations, actions = steps_of(folder, number, episode)
            seed = load(folder).manifest.seed
            replay = Replay(Gymnasium(id="Walk-v0"), "float64", seed, number, episode, starts)
            assert replay.seconds == 0.05 and len(actions) > 1
            for _ in range(2):  # it may begin again
                replay.begin()
                for observation, action in zip(observations, actions, strict=True):
                    assert replay.observation.tolist() == [pytest.approx(observation, abs=1e-6)]
                    replay.step(np.array([float(action)]))
            replay.close()


def test_a_film_and_a_still_show_the_pictures_of_the_environment(folder, tmp_path, capsys):
    observations, _ = steps_of(folder, 1, 2)
    assert main(["render", str(folder), "--run", "1", "--episode", "2"]) == 0
    (path,) = (line for line in capsys.readouterr().out.splitlines() if line.endswith(".gif"))
    assert Image.open(path).n_frames == len(observations)
    words = ["--run", "1", "--episode", "2", "--still", str(tmp_path / "last.png"), "--at", "1"]
    assert main(["render", str(folder), *words]) == 0
    image = np.asarray(Image.open(tmp_path / "last.png").convert("RGB"))
    middle = image[image.shape[0] // 2, image.shape[1] // 2]
    assert middle.tolist() == [int(np.clip(128 + 60 * observations[-1], 0, 255))] * 3


@pytest.mark.parametrize(
    ("id", "kwargs", "message"),
    [
        ("Silent-v0", "", "Silent-v0 draws no pictures: its render modes are human, without rgb_array"),
        ("Walk-v0", "{shape: [12, 16]}", "Walk-v0 draws uint8 of shape (12, 16); allowed: uint8 of shape"),
        ("Walk-v0", "{is_secret: true}", "does not repeat the recorded episode from its seed"),
    ],
)
def test_what_cannot_be_drawn_is_told_in_a_line(tmp_path, refusal, id, kwargs, message):
    folder = recorded(tmp_path / "walk", id, *([f"env.kwargs={kwargs}"] if kwargs else []))
    assert message in refusal(f"render {folder}")
    assert not (folder / "animations").exists()
