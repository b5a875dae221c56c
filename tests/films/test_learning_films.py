"""Animations are made from the files of a results folder alone; what cannot be shown is told in a line."""

import shutil
import subprocess
import sys
from math import cos, sin

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from bojax.cli.main import main
from bojax.config.component import registry
from bojax.films.choose import choose_film
from bojax.films.film import MAX_FRAMES, frames_of, render
from bojax.films.recorded import choose_episode
from bojax.films.scenes import SCENES
from bojax.report.build import build_report
from bojax.report.source import load
from bojax.report.style import settings
from bojax.results.store import ResultsError
from tests.report.synthetic import edit_manifest, write_folder, write_learning
from tests.tiers import by_tier


def observations(kind, num_steps):
    """A made-up motion that stays on the stage."""
    t = np.linspace(0.0, 3.0, num_steps)
    zero = np.zeros_like(t)
    columns = {
        "single-pendulum": (np.cos(t), np.sin(t), zero),
        "mountain-car": (-0.5 + 0.4 * np.sin(t), zero),
        "double-pendulum": (np.cos(t), np.sin(t), np.cos(2 * t), np.sin(2 * t), zero, zero),
        "cartpole-swing-up": (np.sin(t), zero, 3.1 - t, zero),
        "lunar-lander": (0.3 * np.sin(t), 0.5 + 0.3 * np.cos(t), zero, zero, 0.3 * t, *[zero] * 3),
    }
    return np.stack(columns.get(kind, (zero,)), axis=-1)


def learning_results(
    folder, kind="mountain-car", *, lengths=(30, 20, 25), goals=(False, True, True), frames=(), **env
):
    """Two points, of each runs 0, 1 and 3 with one episode of every length; run 3 never succeeds.

    Every step has the numbers of `frames` as what its animation needs, the first of them growing.
    """
    steps, episodes, points = [], [], []
    schema = registry["env"].get(kind)
    settings = schema(**env).model_dump(mode="json") if schema else {"kind": kind}
    for point in range(2):
        config = {"kind": "learning", "env": settings, "learner": {"kind": "emu-q"}}
        entry = {"index": point, "label": "emu-q", "variant": "emu q/1", "swept": {"learner.kappa": point}}
        points.append(entry | {"config": config})
        for run in (0, 1, 3):
            for number, (length, goal) in enumerate(zip(lengths, goals, strict=True), start=1):
                seen = observations(kind, length)
                common = {"point": point, "label": "emu-q", "run": run, "episode": number}
                success = goal and run != 3
                end = {"phase": "train", "success": success, "terminated": goal}
                test = {"phase": "test", "success": True, "terminated": True}
                episodes += [common | end, common | test]
                for i in range(length):
                    row = common | {"step": i + 1, "reward": 0.5, "accumulated_reward": 0.5 * (i + 1)}
                    row |= {f"observation_{j}": x for j, x in enumerate(seen[i])}
                    row |= {f"qpos_{j}": x + 0.02 * i * (j == 0) for j, x in enumerate(frames)}
                    row |= {"action_1": cos(i)} if kind == "lunar-lander" else {}
                    steps.append(row | {"action_0": sin(i) + run})
    runs = [{"point": point, "run": run} for point in range(2) for run in (0, 1, 3)]
    tables = {"runs": runs, "steps": steps, "episodes": episodes}
    return write_folder(folder, tables, points, {})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return learning_results(tmp_path_factory.mktemp("animations") / "results")


def frames(path):
    with Image.open(path) as image:
        for i in range(image.n_frames):
            image.seek(i)
            yield np.asarray(image.convert("RGB")), image.info["duration"]


@pytest.mark.parametrize("kind", SCENES)
def test_every_scene_is_drawn_and_moves(tmp_path, kind):
    kept = {"lunar-lander": (0.4, 0.4, *[3.3] * 11)}.get(kind, ())
    folder = learning_results(tmp_path / "results", kind, lengths=(12,), goals=(True,), frames=kept)
    counted = []
    paths = render(choose_film(load(folder)), folder / "animations", lambda: counted.append(1))
    assert paths[0].name == "emu-q-1-kappa-0-run0-episode1.gif"
    assert len(counted) == 12
    images, durations = zip(*frames(paths[0]), strict=True)
    assert images[0].shape == (400, 440, 3) and len(images) == 12
    stage = [image[70:330] for image in images]  # without the words above and the action below
    assert all(np.any(a != b) for a, b in zip(stage, stage[1:], strict=False))
    assert np.mean(np.all(images[0] == 255, axis=-1)) > 0.4  # the background stays white
    assert durations[-1] == 2000 and set(durations[:-1]) <= {40, 50, 100}
    assert paths[0].stat().st_size < 200_000
    assert (len(paths) == 2) == (shutil.which("ffmpeg") is not None)


FFMPEG = """#!{python}
import sys
size = len(sys.stdin.buffer.read())
open(sys.argv[-1], "w").write(str(size))
sys.exit({code})
"""
"""An ffmpeg that writes down how many bytes it was given."""


@pytest.mark.parametrize("code", [0, 1])
def test_where_there_is_ffmpeg_it_gets_the_same_frames_and_its_failure_is_told(tmp_path, monkeypatch, code):
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(FFMPEG.format(python=sys.executable, code=code))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    film = choose_film(load(learning_results(tmp_path / "results", lengths=(6,), goals=(True,))))
    if code:
        with pytest.raises(ResultsError, match="the GIF is written, but ffmpeg failed"):
            render(film, tmp_path / "films")
        assert [path.suffix for path in (tmp_path / "films").iterdir()] == [".gif"]
    else:
        gif, mp4 = render(film, tmp_path / "films")
        assert mp4 == gif.with_suffix(".mp4")
        assert int(mp4.read_text()) == (6 + 50) * 400 * 440 * 4  # the last frame for 2 s of 25 frames


def scene(kind, observation, **env):
    axes = Figure().add_subplot()
    drawn = SCENES[kind](axes, registry["env"][kind](**env))
    drawn.move(np.asarray(observation), np.zeros(1), np.zeros(0))
    return axes


def tips(axes):
    """Ends of the lines, which are the links and where they have been."""
    return [tuple(np.round(line.get_xydata()[-1], 9)) for line in axes.lines]


def test_links_are_where_the_observation_has_them():
    """Angles as the environments have them: left of upright, from hanging, right of upright."""
    single = scene("single-pendulum", [cos(0.5), sin(0.5), 0.0], length=2.0)
    assert (round(-2 * sin(0.5), 9), round(2 * cos(0.5), 9)) in tips(single)
    double = scene("double-pendulum", [cos(0.7), sin(0.7), cos(0.4), sin(0.4), 0.0, 0.0])
    assert (round(sin(0.7) + sin(1.1), 9), round(-cos(0.7) - cos(1.1), 9)) in tips(double)
    cart = scene("cartpole-swing-up", [0.3, 0.0, 0.5, 0.0])
    assert (round(0.3 + sin(0.5), 9), round(cos(0.5), 9)) in tips(cart)


def test_the_stage_shows_the_settings():
    def goal_box(**env):
        return scene("double-pendulum", [1.0, 0.0, 1.0, 0.0, 0.0, 0.0], **env).patches[0].get_extents().bounds

    assert goal_box(goal_distance=0.5) != goal_box(goal_distance=1.0) != goal_box(goal="height")
    assert scene("cartpole-swing-up", [0.0] * 4, limit=3.0).get_xlim()[1] > 3.0
    flag = [scene("mountain-car", [0.0, 0.0], goal_position=x).patches[0].get_xy()[0][0] for x in (0.42, 0.5)]
    assert flag == [0.42, 0.5]


def test_any_recorded_episode_can_be_chosen(folder):
    """By default the first success of the first run; without success the last episode."""
    for asked, point, run, number, outcome in (
        ({}, 0, 0, 2, "goal reached"),
        ({"run": 3}, 0, 3, 3, "failed"),
        ({"point": 1, "run": 1, "episode": 1}, 1, 1, 1, "truncated"),
    ):
        episode = choose_episode(load(folder), **asked)
        found = episode.point.index, episode.run, episode.number, episode.outcome
        assert found == (point, run, number, outcome)
        steps = (30, 20, 25)[number - 1]
        np.testing.assert_allclose(episode.accumulated, 0.5 * np.arange(1, steps + 1))
        np.testing.assert_allclose(episode.observations, observations("mountain-car", steps))
        np.testing.assert_allclose(episode.actions[:, 0], np.sin(np.arange(steps)) + run)
    for asked, message in (
        ({"run": 2}, "no steps of run 2; recorded: 0 to 1, 3"),
        ({"episode": 4}, "no steps of episode 4; recorded: 1 to 3"),
        ({"point": 7}, "no steps of point 7; recorded: 0 to 1"),
    ):
        with pytest.raises(ResultsError, match=message):
            choose_episode(load(folder), **asked)


def test_a_long_episode_is_shown_in_parts():
    assert frames_of(1).tolist() == [0]
    assert frames_of(30).tolist() == list(range(30))
    shown = frames_of(500)
    assert len(shown) == MAX_FRAMES and shown[0] == 0 and shown[-1] == 499
    assert set(np.diff(shown)) == {2, 3}


def test_the_command(folder, capsys):
    assert main(["render", str(folder), "--run", "1", "--episode", "1"]) == 0
    written = folder / "animations" / "emu-q-1-kappa-0-run1-episode1.gif"
    assert capsys.readouterr().out.splitlines()[0] == str(written)
    assert len(list(frames(written))) == 30


def test_what_cannot_be_drawn_is_told_in_a_line(tmp_path, refusal):
    unread = "this version cannot read the settings: env"

    def forget(folder):
        goal = {"goal_position": None}
        edit_manifest(folder, lambda m: [each["config"]["env"].update(goal) for each in m["points"]])

    def delete_steps(folder):
        (folder / "steps.parquet").unlink()

    for number, (kind, damage, message) in enumerate(
        (
            ("mountain-car", delete_steps, "no steps were recorded"),
            ("mountain-car", forget, f"{unread}.goal_position: got null"),
            ("ice-rink", str, unread),
            ("reacher", str, "no drawing of reacher is known; known: single-pendulum"),
        )
    ):
        folder = learning_results(tmp_path / str(number), kind, lengths=(5,), goals=(True,))
        damage(folder)
        assert message in refusal(f"render {folder}")
        assert not (folder / "animations").exists()


@pytest.mark.parametrize("share", ["0", "0.5", "1"])
def test_a_still_is_a_moment_of_the_film(folder, tmp_path, capsys, refusal, share):
    path = tmp_path / "stills" / "one.png"
    words = ["--run", "1", "--episode", "1", "--still", str(path), "--at", share]
    assert main(["render", str(folder), *words]) == 0
    assert capsys.readouterr().out.strip() == str(path)
    film = choose_film(load(folder), run=1, episode=1)
    with Image.open(path) as image, settings():
        at = [step / 29 for step in range(30)]
        same = [np.array_equal(np.asarray(image), np.asarray(film.still(share))) for share in at]
    assert same.index(True) == round(float(share) * 29)
    assert "--at" in refusal(f"render {folder} --still {path} --at 2")
    assert "--at: allowed only with --still" in refusal(f"render {folder} --at {share}")


def test_it_needs_no_jax(folder):
    code = (
        "import sys; from bojax.cli.main import main; "
        f"assert main(['render', {str(folder)!r}]) == 0; assert 'jax' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.parametrize("part", by_tier(["learner", "env"], normal=["env"]))
def test_a_results_folder_imports_nothing(tmp_path, monkeypatch, part):
    """Its settings may name modules, here one that is there to be found; reports and films read files."""
    (tmp_path / "my_spy.py").write_text("raise SystemExit('imported')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    folders = [write_learning(tmp_path / "report"), learning_results(tmp_path / "film")]

    spy = {"kind": "my_spy:Mine"}
    for folder in folders:
        edit_manifest(folder, lambda m: [each["config"][part].update(spy) for each in m["points"]])
    assert build_report(folders[0]).exists()
    if part == "learner":
        choose_film(load(folders[1]))
    else:
        with pytest.raises(ResultsError, match="my_spy:Mine"):
            choose_film(load(folders[1]))
    assert "my_spy" not in sys.modules
