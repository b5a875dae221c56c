"""dm-control's Jaco (Kinova's arm and hand), some of its joints locked, torque motors on the others."""

from pathlib import Path

import mujoco
import numpy as np

REST = (0.0, np.pi, np.pi, 0.0, 0.0, 0.0)
TORQUES = (30.5, 30.5, 30.5, 6.8, 6.8, 6.8)
FINGERS = 0.6


def dm_control_jaco(joints: tuple[int, ...], folder: Path) -> mujoco.MjModel:
    """The model, without collisions.

    Args:
        joints: The joints that move, from 1 to 6.
        folder: dm-control's `third_party/kinova`.
    """
    spec = mujoco.MjSpec.from_file(str(folder / "jaco_arm.xml"))
    hand = mujoco.MjSpec.from_file(str(folder / "jaco_hand.xml"))
    spec.attach(hand, prefix="hand_", site=spec.site("wristsite"))
    spec.option.timestep = 0.004
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    for number, (angle, torque) in enumerate(zip(REST, TORQUES, strict=True), start=1):
        joint = spec.joint(f"joint_{number}")
        if number not in joints:
            _lock(spec, joint, angle)
            continue
        motor = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gear[0] = torque
        motor.ctrllimited, motor.ctrlrange = True, [-1, 1]
    for number in (1, 2, 3):
        _lock(spec, spec.joint(f"hand_finger_{number}"), FINGERS)
    return spec.compile()


def finger_tips(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """The middle of the ends of the three fingers, from the bounding boxes of their meshes."""
    ends = []
    for number in (1, 2, 3):
        geom = model.geom(f"hand_finger_tip_{number}").id
        knuckle = data.body(f"hand_b_finger_{number}").xpos
        centre, half = np.split(model.geom_aabb[geom], 2)
        along = np.array([[0.0, 0.0, half[2]], [0.0, 0.0, -half[2]]])
        corners = data.geom_xpos[geom] + (centre + along) @ data.geom_xmat[geom].reshape(3, 3).T
        ends.append(max(corners, key=lambda corner, knuckle=knuckle: np.linalg.norm(corner - knuckle)))
    return np.mean(ends, axis=0)


def _lock(spec, joint, angle: float) -> None:
    """Turn the body of a joint about its z axis, and take the joint away."""
    turned = np.zeros(4)
    turn = np.array([np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)])
    mujoco.mju_mulQuat(turned, np.array(joint.parent.quat, float), turn)
    joint.parent.quat = turned
    spec.delete(joint)
