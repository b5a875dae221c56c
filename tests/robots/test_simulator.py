"""`Simulator` against C MuJoCo, on every model that comes with bojax, and what it refuses."""

import functools
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import bojax.robots.simulator
from bojax.engine.build import build
from bojax.numerics.pallas import kernels_run_here
from bojax.robots.models import RobotModel, from_file, jaco_model, packaged
from bojax.robots.settings import MJX
from bojax.robots.simulator import Simulator
from tests.compiling import REPEATABLY
from tests.refusals import assert_refused, one_line
from tests.tiers import by_tier

MODELS = {
    "hopper": packaged("hopper"),
    "reacher": packaged("reacher"),
    "jaco": jaco_model((1, 2)),
    "car": packaged("car"),
    "quadrotor": packaged("quadrotor"),
}
"""Every packaged model, by the name that its tests get; one more is one more line."""

# Hopper and reacher are compared with Gymnasium's in `envs/test_robots.py`, and the car with C MuJoCo in
# `problems/test_wheeled_robot.py`.
each_model = pytest.mark.parametrize("name", by_tier(MODELS, normal=["jaco", "quadrotor"]))

LANES, STEPS = 8, 20

NEEDS_GPU = pytest.mark.skipif(not kernels_run_here(), reason="needs an NVIDIA GPU")
IMPLS = ["jax", "c", pytest.param("pallas", marks=NEEDS_GPU)]


@functools.cache
def simulator(name: str, impl: str = "jax") -> Simulator:
    with jax.ensure_compile_time_eval():  # the first call may be within a trace
        return Simulator(build(MJX(impl=impl), "float32"), MODELS[name], substeps=1)


@functools.cache
def advanced(name: str, impl: str):
    """The compiled states of `LANES` lanes after each of `STEPS` steps, and whether they have diverged."""
    robot = simulator(name, impl)

    def lane(qpos, qvel, controls):
        def step(state, control):
            state = robot.advance(state, control)
            return state, (state, robot.has_diverged(state))

        return jax.lax.scan(step, robot.state(qpos, qvel), controls)[1]

    return jax.jit(jax.vmap(lane), compiler_options=REPEATABLY)


@functools.cache
def reference(name: str):
    """The same model, its constraints solved by C MuJoCo as well as it can."""
    model = mujoco.MjModel.from_xml_string(MODELS[name].xml)
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 50, 1e-10
    return model


def steps_of(model, qpos, qvel, controls):
    """Positions and velocities after each step of C MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos, data.qvel = qpos, qvel
    after = []
    for control in controls:
        data.ctrl = control
        mujoco.mj_step(model, data)
        after.append((data.qpos.copy(), data.qvel.copy()))
    return tuple(np.array(part) for part in zip(*after, strict=True))


def driven(name: str, seed: int = 0):
    """States that a model comes to under random controls, and controls to go on with, in float32."""
    model, rng = reference(name), np.random.default_rng(seed)
    low, high = model.actuator_ctrlrange.T
    states = []
    for lane in range(LANES):
        qpos = model.qpos0.copy()
        mujoco.mj_integratePos(model, qpos, rng.uniform(-0.05, 0.05, model.nv), 1.0)
        before = rng.uniform(low, high, (1 + 40 * lane, model.nu))
        places, speeds = steps_of(model, qpos, np.zeros(model.nv), before)
        states.append((places[-1], speeds[-1]))
    qpos, qvel = (np.array(part, np.float32) for part in zip(*states, strict=True))
    return qpos, qvel, rng.uniform(low, high, (LANES, STEPS, model.nu)).astype(np.float32)


@pytest.mark.parametrize("impl", IMPLS)
@each_model
def test_mjx_is_c_mujoco(name, impl):
    qpos, qvel, controls = driven(name)
    found, has_diverged = advanced(name, impl)(qpos, qvel, controls)
    # In the few iterations that the model allows, C MuJoCo solves the constraints of the Jaco less well.
    model = simulator(name, impl).mujoco_model if impl == "c" else reference(name)
    expected = [steps_of(model, *lane) for lane in zip(qpos, qvel, controls, strict=True)]
    places, speeds = (np.array(part) for part in zip(*expected, strict=True))
    np.testing.assert_allclose(found.qpos, places, atol=1e-5)
    np.testing.assert_allclose(found.qvel, speeds, rtol=1e-3, atol=1e-3)
    assert np.abs(places[:, -1] - qpos).max() > 1e-3
    assert not np.any(has_diverged)


@pytest.mark.bits
@pytest.mark.parametrize("impl", IMPLS)
@pytest.mark.parametrize("wrong", [np.nan, 1e6], ids=["nan", "fast"])
@each_model
def test_a_lane_that_diverges_leaves_the_others_alone(name, wrong, impl):
    qpos, qvel, controls = driven(name, seed=1)
    alone, _ = advanced(name, impl)(qpos, qvel, controls)
    qvel[3, 0] = wrong
    beside, has_diverged = advanced(name, impl)(qpos, qvel, controls)
    others = np.arange(LANES) != 3
    for before, after in zip(jax.tree.leaves(alone), jax.tree.leaves(beside), strict=True):
        np.testing.assert_array_equal(np.asarray(after)[others], np.asarray(before)[others])
    np.testing.assert_array_equal(has_diverged[:, 0], ~others)
    assert not np.any(np.asarray(has_diverged)[others])


def test_a_state_is_positions_velocities_and_a_warm_start():
    robot = simulator("hopper")
    state = jax.eval_shape(
        lambda: robot.advance(robot.state(jnp.zeros(6), jnp.zeros(6)), jnp.zeros(3, jnp.float32))
    )
    assert {name: (leaf.shape, leaf.dtype) for name, leaf in vars(state).items()} == dict.fromkeys(
        ("qpos", "qvel", "qacc_warmstart"), ((6,), jnp.float32)
    )


@pytest.mark.parametrize("integrator", ["euler", "rk4", "implicitfast"])
def test_settings_reach_the_model(integrator):
    physics = build(MJX(iterations=7, ls_iterations=9, integrator=integrator), "float32")
    robot = Simulator(physics, MODELS["hopper"], substeps=3)
    options = robot.mujoco_model.opt
    assert (options.iterations, options.ls_iterations) == (7, 9)
    assert mujoco.mjtIntegrator(options.integrator).name == f"mjINT_{integrator.upper()}"
    assert robot.time_step == pytest.approx(3 * 0.002)
    own = simulator("hopper").mujoco_model.opt
    assert (own.iterations, own.ls_iterations, own.integrator) == (4, 8, mujoco.mjtIntegrator.mjINT_RK4)


def test_numbers_are_swept_and_do_not_make_another_model():
    slow, fast = (build(MJX(max_speed=speed), "float32") for speed in (1.0, 1000.0))
    robot = simulator("reacher")
    state = robot.state(jnp.zeros(4), jnp.full(4, 2.0))
    told = [eqx.tree_at(lambda r: r.physics, robot, physics).has_diverged(state) for physics in (slow, fast)]
    assert (bool(told[0]), bool(told[1])) == (True, False)


CYLINDER_ON_BOX = """
<mujoco><worldbody><body><freejoint/><geom type="cylinder" size="1 1"/><site pos="1 2 3"/></body>
<body pos="0 0 3"><freejoint/><geom type="box" size="1 1 1"/></body></worldbody></mujoco>
"""


def slider(extension="", actuator="", option="", further="", sleep="allowed", joint="", geom=""):
    """A mass on a rail."""
    return (
        f"<mujoco>{option}<extension>{extension}</extension><worldbody><body name='slider' sleep='{sleep}'>"
        f"<joint name='x' type='slide' {joint}/><geom size='0.1' {geom}/><site pos='0.1 0 0.2'/>"
        "</body></worldbody>"
        f"<actuator>{actuator}</actuator>{further}</mujoco>"
    )


PID = "<plugin plugin='mujoco.pid'/>", "<plugin joint='x' plugin='mujoco.pid'/>"
INTEGRAL = (
    "<plugin plugin='mujoco.pid'><instance name='pid'><config key='ki' value='1'/></instance></plugin>",
    "<plugin joint='x' plugin='mujoco.pid' instance='pid' actdim='1'/>",
)
OF_GROUP_1 = "<motor joint='x' ctrlrange='-1 1' gear='9' group='1'/>"
CAN_SLEEP = "<option><flag sleep='enable'/></option>"


REFUSED = [
    (CYLINDER_ON_BOX, r"MJX refuses the model: .*CYLINDER.*BOX.* not implemented"),
    ("<mujoco><worldbody>", "XML"),
    ("<mujoco><worldbody><body><jont/></body></worldbody></mujoco>", "jont"),
    (
        "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>",
        "MuJoCo refuses the model: .*mass and inertia",
    ),
    ("", "XML"),
    (slider(*PID), "MJX cannot simulate the model: plugins$"),
]
"""Models that MJX or MuJoCo refuse, and why."""


def simulated(xml, impl):
    """A call that makes a simulator."""
    return lambda: Simulator(build(MJX(impl=impl), "float32"), RobotModel(xml), substeps=1)


def test_a_model_that_cannot_be_used_says_why_in_a_line():
    assert_refused((simulated(xml, "jax"), reason) for xml, reason in REFUSED)


BY_C_ALONE = [
    (slider(option="<option solver='PGS'/>"), "MJX refuses the model: .*PGS"),
    (slider(option="<option integrator='implicit'/>"), "MJX refuses the model: .*IMPLICIT"),
    (slider(option="<option integrator='discrete'/>"), "MJX cannot simulate the model: the integrator disc"),
    (
        slider(option="<option integrator='implicitfast' density='1.2'/>"),
        "MJX refuses the model: implicitfast not implemented for fluid drag",
    ),
    (slider(option="<option noslip_iterations='3'/>"), "MJX cannot simulate the model: noslip iterations"),
    (slider(option=CAN_SLEEP), "MJX cannot simulate the model: sleeping bodies"),
    (slider(*PID), "MJX cannot simulate the model: plugins"),
    (
        slider(option="<option><flag spring='disable'/></option>", joint="damping='5'"),
        "MJX cannot simulate the model: springs or dampers that are switched off",
    ),
    (
        slider(option="<option density='1000'><flag spring='disable'/></option>"),
        "MJX cannot simulate the model: springs or dampers that are switched off",
    ),
    (
        slider(option="<option><flag damper='disable'/></option>", joint="stiffness='5' springref='1'"),
        "MJX cannot simulate the model: springs or dampers that are switched off",
    ),
    (
        slider(joint="damping='1 5 9'"),
        "MJX cannot simulate the model: springs or dampers that are not linear",
    ),
    (
        slider(joint="stiffness='1 5 9' springref='1'"),
        "MJX cannot simulate the model: springs or dampers that are not linear",
    ),
    (
        slider(further="<tendon><fixed damping='1 9'><joint joint='x' coef='1'/></fixed></tendon>"),
        "MJX cannot simulate the model: springs or dampers that are not linear",
    ),
    (
        slider(actuator="<motor joint='x' damping='5'/>"),
        "MJX cannot simulate the model: damping or armature of actuators",
    ),
    (
        slider(actuator="<motor joint='x' armature='5'/>"),
        "MJX cannot simulate the model: damping or armature of actuators",
    ),
    (
        slider(option="<option actuatorgroupdisable='1'/>", actuator=OF_GROUP_1),
        "MJX cannot simulate the model: groups of actuators that are switched off",
    ),
    (
        slider(option="<option density='1000'/>", geom="fluidshape='ellipsoid'"),
        "MJX cannot simulate the model: ellipsoids in a fluid",
    ),
    (slider(geom="adhesion='3'"), "MJX cannot simulate the model: adhesion of geoms"),
    (slider(geom="surfacevel='1 0 0'"), "MJX cannot simulate the model: surfaces that move"),
    (
        slider(
            actuator="<motor joint='x'/>",
            further="<sensor><user dim='1'/></sensor><keyframe><key qpos='0' ctrl='1'/></keyframe>"
            "<equality><joint joint1='x' active='false'/></equality>"
            "<tendon><fixed name='t'><joint joint='x' coef='1'/></fixed></tendon>",
        ),
        "MJX refuses the model: .*mjSENS_USER",
    ),
]
"""Models without contacts that C MuJoCo simulates, and why MJX does not."""


def test_auto_is_c_where_mjx_refuses_a_model_and_says_so_once(capsys):
    for xml, reason in BY_C_ALONE:
        robot, again = (
            Simulator(build(MJX(), "float32"), RobotModel(xml), substeps=count) for count in (2, 3)
        )
        assert robot.impl == again.impl == "c"
        (line,) = capsys.readouterr().err.splitlines()
        assert re.fullmatch(f"note: physics.impl: auto is c, since {reason}.*", line)
        model = mujoco.MjModel.from_xml_string(xml)
        data = mujoco.MjData(model)
        data.ctrl = control = np.full(model.nu, 0.5, np.float32)
        data.qvel = 1.0
        before = robot.state(jnp.asarray(data.qpos), jnp.asarray(data.qvel))
        mujoco.mj_step(model, data, 2)
        found = robot.advance(before, jnp.asarray(control))
        np.testing.assert_allclose(found.qpos, data.qpos, atol=1e-7)
        np.testing.assert_allclose(found.qvel, data.qvel, atol=1e-6)
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(robot.sites(found), data.site_xpos, atol=1e-7)


def test_the_sites_of_a_model_with_pairs_that_mjx_refuses():
    robot = Simulator(build(MJX(), "float32"), RobotModel(CYLINDER_ON_BOX), substeps=1)
    qpos = np.arange(14, dtype=np.float32)
    data = mujoco.MjData(robot.mujoco_model)
    data.qpos = qpos
    mujoco.mj_kinematics(robot.mujoco_model, data)
    state = robot.state(jnp.asarray(qpos), jnp.zeros(12))
    np.testing.assert_allclose(robot.sites(state), data.site_xpos, atol=1e-6)


@pytest.mark.parametrize("impl", ["auto", "jax", "c"])
def test_what_no_implementation_can_simulate_is_refused_by_all(impl, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warning of a NaN to a file
    no_joints = "<body><geom size='0.1'/></body>"
    refused = (
        ("<mujoco><worldbody/></mujoco>", "the model has no joints"),
        (f"<mujoco><worldbody>{no_joints}</worldbody></mujoco>", "the model has no joints"),
        # MuJoCo would simulate the second one without its limit.
        (slider(joint="damping='nan'"), "the model has NaN: dof_damping"),
        (slider(joint="range='nan 1'"), "the model has NaN: jnt_range"),
        (slider(option="<option timestep='nan'/>"), r"the model has NaN: opt\.timestep"),
        (slider(*INTEGRAL), "more than positions and velocities: .*activation of their own"),
        (slider(actuator="<muscle joint='x' lengthrange='0.1 0.2'/>"), "activation of their own"),
        (slider(actuator="<motor joint='x' delay='0.1' nsample='20'/>"), "delayed actuators"),
        (slider(option=CAN_SLEEP, sleep="init"), "bodies that are asleep at the start"),
    )
    assert_refused((simulated(xml, impl), reason) for xml, reason in refused)
    found = Simulator(build(MJX(), "float32"), RobotModel(slider(sleep="init")), substeps=1)
    assert found.impl == ("pallas" if kernels_run_here() else "jax")


FLYING_ARM = (
    "<mujoco><worldbody><body><freejoint/><geom size='0.1'/><body><joint name='x'/><geom size='0.1'/></body>"
    "</body></worldbody><actuator><motor joint='x'/></actuator></mujoco>"
)


def test_states_and_controls_have_the_sizes_of_the_model():
    robot = Simulator(build(MJX(impl="c"), "float32"), RobotModel(FLYING_ARM), substeps=1)
    state = robot.state(jnp.asarray(robot.mujoco_model.qpos0), jnp.zeros(7))
    refused = [
        # C MuJoCo would take the last position for the first velocity.
        (lambda: robot.state(jnp.zeros(9), jnp.zeros(6)), r"^generalised positions .* \(9,\); .* \(8,\)$"),
        (lambda: robot.state(jnp.zeros(8), jnp.zeros(8)), r"^generalised velocities .* \(8,\); .* \(7,\)$"),
        (lambda: robot.advance(state, jnp.zeros(2)), r"^controls: got the shape \(2,\); .* needs \(1,\)$"),
        (lambda: robot.advance(state, 0.0), r"^controls: got the shape \(\); the model needs \(1,\)$"),
    ]
    assert_refused(refused)


@pytest.mark.parametrize("impl", ["auto", "jax", "c"])
def test_a_robot_that_would_not_move_is_refused(impl):
    """A `substeps` of one's own settings has no limit."""
    physics, model = build(MJX(impl=impl), "float32"), RobotModel(slider())
    refused = (
        (lambda n=n: Simulator(physics, model, n), f"^substeps: got {n}; allowed: >= 1$") for n in (0, -1)
    )
    assert_refused(refused)


def test_what_mjx_ignores_does_not_matter_where_the_model_does_not_use_it():
    unused = (
        slider(option="<option actuatorgroupdisable='2'/>", actuator=OF_GROUP_1),
        slider(geom="fluidshape='ellipsoid'"),
        slider(option="<option><flag spring='disable' damper='disable'/></option>"),
    )
    for xml in unused:
        assert simulated(xml, "jax")().impl == "jax"


CHOICES = [
    ("auto", "reacher", "cpu", "jax"),
    ("auto", "reacher", "gpu", "pallas"),
    ("auto", "hopper", "cpu", "c"),
    ("auto", "hopper", "gpu", "pallas"),
    ("auto", "hopper", "tpu", "jax"),
    ("auto", "car", "gpu", "jax"),
    ("auto", "car", "cpu", "c"),
    ("auto", None, "cpu", "jax"),
    ("auto", None, "gpu", "pallas"),
    ("auto", "loop", "cpu", "c"),
    ("auto", "loop", "gpu", "pallas"),
    ("auto", "noslip", "gpu", "c"),
    ("auto", "noslip", "tpu", "c"),
    ("jax", "hopper", "cpu", "jax"),
]
"""Settings, models and platforms, and the implementation that they get."""


def test_the_implementation_that_auto_stands_for(monkeypatch):
    """The car stands for models that cannot be a kernel, although it can."""
    noslip = RobotModel(slider(option="<option noslip_iterations='3'/>"))
    too_large = MODELS["car"], noslip
    joined = "<equality><connect body1='slider' body2='world' anchor='0 0 0'/></equality>"
    own = {"noslip": noslip, "loop": RobotModel(slider(further=joined)), None: RobotModel(slider())}
    monkeypatch.setattr(
        bojax.robots.simulator, "_can_be_a_kernel", lambda configured, _: configured.model not in too_large
    )
    monkeypatch.setattr(bojax.robots.simulator, "_stepping", lambda *_: None)
    for impl, name, platform, expected in CHOICES:
        monkeypatch.setattr(jax, "default_backend", lambda platform=platform: platform)
        monkeypatch.setattr(
            bojax.robots.simulator, "kernels_run_here", lambda platform=platform: platform == "gpu"
        )
        robot = Simulator(build(MJX(impl=impl), "float32"), (own | MODELS)[name], substeps=1)
        assert robot.impl == expected, (impl, name, platform)


def test_what_is_no_fault_of_the_model_is_not_put_down_to_it(monkeypatch):
    def fails(*_, **__):
        raise RuntimeError("RESOURCE_EXHAUSTED")

    monkeypatch.setattr(bojax.robots.simulator.mjx, "put_model", fails)
    with pytest.raises(RuntimeError, match=r"^RESOURCE_EXHAUSTED$"):
        Simulator(build(MJX(), "float32"), RobotModel(slider("<!-- of its own -->")), substeps=1)


def test_what_a_file_of_ones_own_includes_lies_beside_it(tmp_path):
    (tmp_path / "arm.xml").write_text(
        "<mujocoinclude><body><joint type='slide'/><geom size='0.1'/></body></mujocoinclude>"
    )
    scene = tmp_path / "scene.xml"
    scene.write_text("<mujoco><worldbody><include file='arm.xml'/></worldbody></mujoco>")
    assert Simulator(build(MJX(), "float32"), from_file(scene), substeps=1).mujoco_model.nq == 1
    scene.write_text("<mujoco><worldbody><include file='leg.xml'/></worldbody></mujoco>")
    with pytest.raises(ValueError, match=r"leg\.xml"):
        from_file(scene).spec()
    scene.write_text("<mujoco><worldbody>")
    with pytest.raises(ValueError, match=r"^scene\.xml: .*XML"):
        from_file(scene).spec()


def test_a_file_of_ones_own_that_is_missing_says_so_in_a_line(tmp_path):
    with one_line(ValueError, r"none\.xml: .*No such file"):
        from_file(tmp_path / "none.xml")
