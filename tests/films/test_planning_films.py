"""Films of planners and of robots: what is drawn is what was recorded, on a screen or on none."""

from contextlib import closing

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from bojax.cli.main import main
from bojax.films import rendering
from bojax.films.choose import choose_film
from bojax.films.film import MAX_FRAMES, render
from bojax.films.planning import MAX_IMAGES_PER_STEP, PlanningFilm, _Map
from bojax.films.recorded import choose_drive
from bojax.motions.base import place as placed
from bojax.problems.settings import Parking, TwoPits
from bojax.report.source import load
from bojax.report.style import settings
from bojax.results.store import ResultsError
from bojax.robots.models import RobotModel
from tests.films.test_learning_films import frames as images_in
from tests.films.test_learning_films import learning_results
from tests.report.synthetic import edit_manifest, write_folder, write_results

STEPS, SAMPLES, ROOM = 4, 5, 6
ARC = np.array([[0.2, 0.02, 0.2], [0.4, 0.08, 0.4], [0.6, 0.18, 0.6], [0.7, 0.26, 0.8], [0.8, 0.4, 1.0]])


def place(path, pose):
    """What the planner's problem makes of a path, in NumPy."""
    return np.asarray(placed(jnp.asarray(path), jnp.asarray(pose)))


def planning_results(folder, problem, *, belief=False, frames=None, success=True, nans=0):
    """Run 3 of point 0: the same arc again and again, of which the second stops halfway and turns round."""
    poses, rows, pose = [], [], np.array([3.0, 3.0, 0.3])
    start = pose
    for step in range(STEPS):
        path = place(ARC, pose).copy()
        if step == 1:
            path[3:] = path[2]
        poses.append(path)
        pose = path[-1] + [0.0, 0.0, np.pi * (step == 1)]
        row = {"step": step + 1, "accumulated_reward": -1.5 * (step + 1)}
        rows.append(row | dict(zip(("x", "y", "heading"), pose.tolist(), strict=True)))
    nothing = np.full((ROOM - STEPS, SAMPLES, 3), np.nan)
    paths = {
        "paths": np.concatenate([poses, nothing]),
        "plans": np.concatenate([np.tile(ARC, (STEPS, 1, 1)), nothing]),
        "start": start,
    }
    if frames is not None:
        paths["frames"] = frames
    arrays = {"0-3-paths": paths}
    if belief:
        grid = np.linspace(0.0, 6.0, 9)
        x, y = np.meshgrid(grid, grid)
        steps = np.arange(ROOM + 1.0)[:, None, None]
        maps = {"x": grid, "y": grid, "truth": x, "mean": x + y, "std": 0.1 * x}
        maps |= {
            "means": (x + steps).astype(np.float32),
            "stds": (1.0 + x / (1.0 + steps)).astype(np.float32),
        }
        arrays["0-3-belief"] = maps
    common = {"point": 0, "label": "kcbts", "run": 3}
    end = {"success": success, "exits": 1, "nans": nans, "return": -6.0, "steps": STEPS}
    tables = {"runs": [common | end], "steps": [common | row for row in rows]}
    config = {"kind": "planning", "problem": problem.model_dump(mode="json"), "planner": {"kind": "kcbts"}}
    points = [{"index": 0, "label": "kcbts", "variant": "kcbts", "swept": {}, "config": config}]
    return write_folder(folder, tables, points, arrays)


def test_a_plan_lies_where_the_robot_stood_when_it_was_made(tmp_path):
    drive = choose_drive(load(planning_results(tmp_path / "results", Parking())))
    assert (drive.run, len(drive.legs), drive.outcome) == (3, STEPS, "goal reached")
    for step in (0, 1, 3):
        leg = drive.legs[step]
        np.testing.assert_allclose(leg.plan, place(ARC, leg.before), atol=1e-12)
        same = slice(None) if step != 1 else slice(3)  # where it was stopped, it did not go on
        np.testing.assert_allclose(leg.plan[same], leg.poses[same], atol=1e-12)
    turned = drive.legs[1].poses[-1] + [0.0, 0.0, np.pi]
    np.testing.assert_allclose(drive.legs[2].before, turned)
    assert [leg.accumulated for leg in drive.legs] == [-1.5, -3.0, -4.5, -6.0]


def test_how_it_ended_is_said(tmp_path):
    for number, (problem, nans, outcome) in enumerate(
        (
            (Parking(), 0, "left the domain"),
            (Parking(exit_terminates=False), 0, ""),
            (TwoPits(), 0, ""),
            (TwoPits(), 2, "failed"),
        )
    ):
        folder = planning_results(tmp_path / str(number), problem, success=False, nans=nans)
        assert choose_drive(load(folder)).outcome == outcome


@pytest.mark.parametrize("problem, belief", [(Parking(), False), (TwoPits(), True)])
def test_the_film_of_a_planner_moves_at_every_picture(tmp_path, problem, belief):
    folder = planning_results(tmp_path / "results", problem, belief=belief)
    film = choose_film(load(folder))
    gif = render(film, folder / "animations")[0]
    assert gif.name == "kcbts-run3.gif" and gif.stat().st_size < 300_000
    pictures = [image for image, _ in images_in(gif)]
    per_step = MAX_IMAGES_PER_STEP
    halted = range(per_step + per_step * 3 // 5, 2 * per_step)  # it was stopped in its second step
    for index, (before, after) in enumerate(zip(pictures, pictures[1:], strict=False)):
        is_moving = np.any(before[70:] != after[70:])
        assert is_moving or index in halted or index + 1 in halted
    assert np.mean(np.all(pictures[0] == 255, axis=-1)) > 0.2


def test_of_a_long_run_fewer_pictures_are_made_of_a_step(tmp_path):
    drive = choose_drive(load(planning_results(tmp_path / "results", Parking())))
    long = type(drive)(drive.point, drive.run, drive.legs * 20, drive.belief, drive.outcome)
    assert PlanningFilm(drive).num_images == STEPS * MAX_IMAGES_PER_STEP + 1
    assert PlanningFilm(long).num_images == 20 * STEPS * (MAX_FRAMES // (20 * STEPS)) + 1


def test_the_belief_is_that_before_the_plan(tmp_path):
    folder = planning_results(tmp_path / "results", TwoPits(), belief=True)
    drive = choose_drive(load(folder))
    truth, stds = drive.belief["truth"], drive.belief["stds"]
    for name, limits in (("mean", (truth.min(), truth.max())), ("std", (0.0, stds.max()))):
        view = _Map(Figure().add_subplot(), drive, name)
        for step in (0, 2):
            view.believe(step)
            np.testing.assert_array_equal(view._image.get_array(), drive.belief[f"{name}s"][step])
        assert view._image.get_clim() == limits


def test_results_without_plans_are_drawn_too(tmp_path, monkeypatch, capsys, refusal):
    monkeypatch.setattr("bojax.films.planning.MAX_IMAGES_PER_STEP", 2)
    folder = write_results(tmp_path / "results", runs=2)
    assert main(["render", str(folder), "--point", "3", "--run", "1"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == str(folder / "animations" / "gps-abt-run1.gif")
    assert "no steps of run 7; recorded: 0 to 1" in refusal(f"render {folder} --run 7")
    assert "--episode: a run of a planner is one episode" in refusal(f"render {folder} --episode 1")
    folder = write_results(tmp_path / "unrecorded", runs=2, recorded=0)
    assert "no paths were recorded (record.runs in the config: 1 or more)" in refusal(f"render {folder}")


@pytest.fixture
def drawing():
    """Skips a test on a machine where MuJoCo cannot draw."""
    try:
        rendering.backend()
    except rendering.CannotDraw as error:
        pytest.skip(str(error))


def standing(folder, steps=2):
    """Steps of a hopper."""
    frames = (0.0, 1.25, 0.0, 0.0, 0.0, 0.0)
    return learning_results(folder, "hopper", lengths=(steps,), goals=(True,), frames=frames)


PUCK = """
<mujoco>
  <option timestep="0.02"/>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="side" pos="0 -3 0.5" xyaxes="1 0 0 0 0 1"/>
    <body><freejoint/><geom type="box" size="0.3 0.2 0.1" rgba="1 0 0 1"/></body>
    <body name="flag" mocap="true"><geom size="0.2" rgba="0 0 1 1"/></body>
  </worldbody>
</mujoco>
"""


def test_a_robot_is_where_its_positions_are(drawing):
    with closing(rendering.Renderer(RobotModel(PUCK), 800, 600)) as renderer:
        puck = np.array([-1.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])
        left = renderer.image(puck).astype(int)
        both = renderer.image(np.concatenate([puck, [1.0, 0.0, 0.5]])).astype(int)
        with pytest.raises(ValueError, match="the model has 7 generalised positions, a frame 4 numbers"):
            renderer.image(np.zeros(4))
    assert left.shape == (600, 800, 3)

    def column(image, colour):
        """Where it is on average, from -1 at the left edge to 1 at the right one."""
        strength = image[..., colour] - image[..., [c for c in range(3) if c != colour]].max(axis=-1)
        return np.mean(np.nonzero(strength > 60)[1]) / 399.5 - 1.0

    assert column(left, 0) == pytest.approx(-column(both, 2), abs=0.1) and column(left, 0) < -0.3


def test_a_robot_that_learns_is_drawn_from_its_settings(tmp_path, drawing, refusal):
    folder = standing(tmp_path / "results", 7)
    film = choose_film(load(folder))
    assert film.seconds == 0.04  # 4 substeps of 2 ms would be too fast
    with settings():
        pictures = [np.asarray(image)[70:330] for image in film.images()]
    assert len(pictures) == 7
    assert all(np.any(a != b) for a, b in zip(pictures, pictures[1:], strict=False))
    assert main(["render", str(folder)]) == 0
    refusal(f"render {folder} --model {tmp_path}/none.xml")
    (tmp_path / "puck.xml").write_text(PUCK)
    error = refusal(f"render {folder} --model {tmp_path}/puck.xml")
    assert "the model differs from the one that was simulated: the model has 7 generalised" in error


def test_a_robot_of_ones_own_needs_its_model(tmp_path, drawing, refusal):
    frames = learning_results(
        tmp_path / "learned", "mine:Puck", lengths=(3,), goals=(True,), frames=[0.0] * 7
    )
    assert "no drawing of mine:Puck is known" in refusal(f"render {frames}")
    (tmp_path / "puck.xml").write_text(PUCK)
    assert main(["render", str(frames), "--model", str(tmp_path / "puck.xml")]) == 0


@pytest.mark.parametrize("problem, belief", [(Parking(), False), (TwoPits(), True)])
def test_a_robot_with_a_body_is_the_main_picture(tmp_path, drawing, problem, belief, refusal):
    frames = np.full((ROOM, 3, 7), np.nan)
    x = np.linspace(-0.5, 0.5, STEPS * 3).reshape(STEPS, 3)
    frames[:STEPS] = np.stack([x, 0 * x, 0 * x + 0.5, 0 * x + 1.0, 0 * x, 0 * x, 0 * x], axis=-1)
    folder = planning_results(tmp_path / "results", problem, belief=belief, frames=frames)
    assert "no model of exact is known: give its MJCF by --model FILE" in refusal(f"render {folder}")
    (tmp_path / "puck.xml").write_text(PUCK)
    film = choose_film(load(folder), model=tmp_path / "puck.xml")
    with settings():
        pictures = [np.asarray(image).astype(int) for image in film.images()]
    assert len(pictures) == film.num_images == 3 * STEPS + 1
    red = [np.mean(np.nonzero(picture[..., 0] - picture[..., 1] > 100)[1]) for picture in pictures]
    assert np.all(np.diff(red[::3]) > 0)  # to the right, from step to step


WHEELS = "".join(f"<body><joint name='wheel{i}' axis='0 1 0'/><geom size='0.1'/></body>" for i in range(4))
BASE = f"""
<mujoco>
  <worldbody>
    <body>
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint axis="0 0 1"/>
      <geom size="0.2"/>{WHEELS}
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("xml", [BASE, PUCK])
def test_positions_are_a_pose_only_where_a_body_is_free(tmp_path, xml):
    (tmp_path / "model.xml").write_text(xml)
    frames = np.full((ROOM, 3, 7), np.nan)
    half = np.sqrt(0.5)  # a heading of pi / 2, or angles of wheels
    frames[:STEPS] = [3.0, 2.0, 0.5, half, 0.0, 0.0, half]
    folder = planning_results(tmp_path / "results", Parking(), frames=frames)
    drive = choose_drive(load(folder))
    film = PlanningFilm(drive, tmp_path / "model.xml")
    for leg, curve in zip(drive.legs, film._curves, strict=True):
        if xml == PUCK:
            np.testing.assert_allclose(curve, np.tile([3.0, 2.0, np.pi / 2], (3, 1)))
        else:
            np.testing.assert_allclose(curve[[0, -1]], [leg.before, leg.poses[-1]], atol=1e-9)


class TestWithoutAScreen:
    """Which way to draw is taken."""

    @pytest.fixture
    def works(self, monkeypatch):
        """Let only these ways work, and note which were tried."""

        def install(*names):
            tried = []
            monkeypatch.setattr(rendering, "_works", lambda name: tried.append(name) or name in names)
            monkeypatch.setattr(rendering, "BACKENDS", ("egl", "osmesa"))
            return tried

        rendering._working.cache_clear()
        yield install
        rendering._working.cache_clear()

    def test_osmesa_where_egl_fails(self, works, monkeypatch):
        monkeypatch.delenv("MUJOCO_GL", raising=False)
        tried = works("osmesa")
        assert rendering.backend() == rendering.backend() == "osmesa" and tried == ["egl", "osmesa"]

    def test_what_the_user_has_set_alone(self, works, monkeypatch, tmp_path, refusal):
        monkeypatch.setenv("MUJOCO_GL", "glfw")
        tried = works("egl")
        folder = standing(tmp_path / "results")
        message = "MUJOCO_GL=glfw draws nothing here: unset it, and EGL and OSMesa are tried"
        assert refusal(f"render {folder}") == message
        assert tried == ["glfw"] and not (folder / "animations").exists()

    def test_nothing_works(self, works, monkeypatch, tmp_path, refusal):
        monkeypatch.delenv("MUJOCO_GL", raising=False)
        works()
        folder = standing(tmp_path / "results")
        error = refusal(f"render {folder}")
        assert "neither EGL nor OSMesa works here" in error and "apt install" in error
        from bojax.cli import doctor

        findings = list(doctor.examine(doctor.CHECKS["films"]))
        assert findings[-1].state == "note" and "apt install" in findings[-1].text

    def test_a_probe_that_fails_is_no_way(self):
        assert not rendering._works("no-such-thing")


def test_gallery_results_do_not_move(tmp_path):
    folder = planning_results(tmp_path / "results", Parking())
    edit_manifest(folder, lambda manifest: manifest["points"][0].update(config={"kind": "trajectories"}))
    with pytest.raises(ResultsError, match="got results of trajectories; only planners and learners"):
        choose_film(load(folder))
