"""What stands around a robot that follows plans is drawn where the problem has it."""

import numpy as np
import pytest

from bojax.films.robot_worlds import VEHICLES, WALL_HEIGHT
from bojax.problems.settings import Parking, SpaceModelling, TwoPits
from bojax.results.outline import Outline
from bojax.robots.models import mujoco


def boxes(model):
    """Rows of lower and upper corner of the boxes that belong to no robot and cannot be touched."""
    is_wall = (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX) & (model.geom_bodyid == 0)
    assert not model.geom_contype[is_wall].any() and not model.geom_conaffinity[is_wall].any()
    middle, half = model.geom_pos[is_wall], model.geom_size[is_wall]
    return np.concatenate([middle - half, middle + half], axis=1)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_walls_stand_where_they_stop_the_robot(vehicle):
    problem = SpaceModelling()
    drawn = boxes(VEHICLES[vehicle](problem.outline, None).compiled())
    np.testing.assert_allclose(drawn[:, [0, 1, 3, 4]], problem.walls, atol=1e-9)
    np.testing.assert_allclose(drawn[:, 2], 0.0, atol=1e-9)


def test_walls_reach_from_the_lowest_to_above_the_highest_ground():
    pits = TwoPits(walls=((2.0, 2.0, 4.0, 2.2),)).outline
    (wall,) = boxes(VEHICLES["quadrotor"](pits, np.array([[-1.0, -0.5], [0.0, 0.2]])).compiled())
    assert wall[2] == pytest.approx(-1.0)
    assert wall[5] == pytest.approx(0.2 + WALL_HEIGHT)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_the_parking_spot_is_drawn_for_every_vehicle(vehicle):
    problem = Parking(half_width=2.0, distance_tolerance=0.3)
    model = VEHICLES[vehicle](problem.outline, None).compiled()
    np.testing.assert_allclose(model.geom("floor").size[:2], 2.0)
    assert model.camera("overview") is not None
    assert model.geom("goal_0").size[0] == pytest.approx(0.3)
    assert not model.geom("goal_0").contype and not model.geom("goal_0_heading").contype
    np.testing.assert_allclose(model.geom("goal_0_heading").pos, [1.73 * 0.3, 0.0, 0.0])


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_a_problem_of_ones_own_without_a_domain_is_drawn_too(vehicle):
    outline = Outline(obstacles=[(1.0, 2.0, 0.3)], goals=[(0.5, 0.0, 0.2)])
    model = VEHICLES[vehicle](outline, None).compiled()
    np.testing.assert_allclose(model.geom("floor").size[:2], 5.0)
    np.testing.assert_allclose(model.geom("goal_0").pos, [0.5, 0.0, 0.0])
    (disc,) = [geom for geom in map(model.geom, range(model.ngeom)) if np.allclose(geom.pos[:2], [1.0, 2.0])]
    assert disc.size[0] == pytest.approx(0.3)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_the_floor_is_the_domain(vehicle):
    model = VEHICLES[vehicle](Outline(border=(0.0, 1.0, 6.0, 5.0)), None).compiled()
    np.testing.assert_allclose(model.geom("floor").pos, [3.0, 3.0, 0.0])
    np.testing.assert_allclose(model.geom("floor").size[:2], [3.0, 2.0])


def test_the_camera_goes_along_with_the_wheeled_robot():
    model = VEHICLES["wheeled-robot"](Parking().outline, None).compiled()
    data = mujoco.MjData(model)
    middle = []
    for data.qpos[:2] in ((0.0, 0.0), (2.0, -1.0)):
        mujoco.mj_forward(model, data)
        middle.append(data.camera("side").xpos - data.body("chassis").xpos)
    np.testing.assert_allclose(middle[0], middle[1], atol=1e-9)
