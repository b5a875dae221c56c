"""MuJoCo Warp under `Simulator`: sizes of buffers, and several devices. `test_lanes` has its lanes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.engine.build import build
from bojax.robots.models import RobotModel
from bojax.robots.settings import MJX
from bojax.robots.simulator import Simulator
from tests.robots.test_lanes import assert_close
from tests.robots.test_simulator import LANES, driven, simulator

pytest.importorskip("warp")

from bojax.robots import mujoco_warp  # noqa: E402


@pytest.mark.bits
@pytest.mark.parametrize("name", ["reacher", "jaco", "quadrotor"])
def test_without_contacts_long_executions_on_all_devices_give_the_same_bits(name):
    """With more lanes than a GPU has multiprocessors."""
    robot, copies = simulator(name, "warp"), 256 // LANES

    def lane(qpos, qvel, controls):
        controls = jnp.tile(controls, (10, 1))
        return jax.lax.scan(lambda s, u: (robot.advance(s, u), None), robot.state(qpos, qvel), controls)[0]

    inputs = [np.repeat(part, copies, axis=0) for part in driven(name)]
    advance = jax.jit(jax.vmap(lane))
    first = advance(*inputs)
    assert np.isfinite(first.qpos).all()
    for device in [jax.devices()[0], *jax.devices()]:
        assert_close(advance(*jax.device_put(inputs, device)), first)
    assert_close(jax.tree.map(lambda leaf: leaf[copies - 1 :: copies], first), advance(*driven(name)))


PILE = """
<mujoco><option cone="{cone}"/><worldbody><geom type="plane" size="5 5 0.1"/>
<body pos="0 0 0.08"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
<body pos="0 0 0.26"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
<body pos="0.15 0 0.09"><freejoint/><geom type="capsule" size="0.1 0.1"/></body>
<body pos="0.1 0.15 0.09"><freejoint/><geom type="cylinder" size="0.1 0.1"/></body>
<body pos="-0.15 0 0.08"><freejoint/><geom type="ellipsoid" size="0.1 0.12 0.1"/></body>
<body pos="0 -0.18 0.09"><freejoint/><geom type="sphere" size="0.1" condim="6"/></body>
</worldbody></mujoco>
"""
"""Bodies of all shapes that overlap one another and the floor."""


@pytest.mark.slow
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_the_buffers_hold_all_contacts_of_overlapping_bodies(cone):
    robot = Simulator(build(MJX(impl="warp"), "float32"), RobotModel(PILE.format(cone=cone)), substeps=2)
    qpos = np.tile(robot.mujoco_model.qpos0, (3, 1))
    after = jax.jit(jax.vmap(lambda q: robot.advance(robot.state(q, jnp.zeros(36)), jnp.zeros(0))))(qpos)
    assert np.isfinite(after.qpos).all()
    assert not np.array_equal(after.qpos, qpos)


LYING = """
<mujoco><worldbody><geom type="plane" size="5 5 0.1"/>
<body pos="0 0 0.099"><freejoint/><geom type="capsule" size="0.1 0.1" zaxis="1 0 0"/></body>
</worldbody></mujoco>
"""
"""A capsule that touches the floor at both ends: two contacts of four rows each."""


@pytest.mark.parametrize(
    ("contacts", "rows", "expected"),
    [(2, 4, False), (1, 8, True), (2, 3, True)],
    ids=["enough", "contacts", "rows"],
)
def test_a_lane_with_a_contact_that_has_no_room_has_diverged(monkeypatch, contacts, rows, expected):
    monkeypatch.setattr(mujoco_warp, "_max_contacts", lambda *_: contacts)
    monkeypatch.setattr(mujoco_warp, "_rows_per_contact", lambda *_: rows)
    model = RobotModel(f"{LYING}<!-- {contacts}, {rows} -->")  # compiled for this test alone
    robot = Simulator(build(MJX(impl="warp"), "float32"), model, substeps=1)
    state = robot.state(jnp.asarray(robot.mujoco_model.qpos0), jnp.zeros(6))
    after = jax.jit(lambda state: robot.advance(state, jnp.zeros(0)))(state)
    assert bool(robot.has_diverged(after)) == expected


def test_a_model_that_only_warp_refuses_says_why_in_a_line():
    xml = "<mujoco><option solver='PGS'/><worldbody/></mujoco>"
    with pytest.raises(ValueError, match=r"^MuJoCo Warp refuses the model: .*PGS") as caught:
        Simulator(build(MJX(impl="warp"), "float32"), RobotModel(xml), substeps=1)
    assert "\n" not in str(caught.value)
