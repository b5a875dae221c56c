"""The timings of bench_robots.py, run in a process with its own cores."""

import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from bench_robots import IMPLS, parse
from peers import installed
from timing import Row, median_seconds, on_gpu, print_rows, time_runs, write_record

from bojax.engine.build import build
from bojax.envs.robots.settings import Hopper, Jaco, Reacher
from bojax.envs.settings import LunarLander
from bojax.numerics.cores import usable_cores
from bojax.robots.models import mujoco, packaged
from bojax.robots.settings import MJX
from bojax.robots.simulator import Simulator

SCHEMAS = {"hopper": Hopper, "reacher": Reacher, "jaco": Jaco}
MODELS = {"wheeled-robot": "car", "quadrotor": "quadrotor"}


def main(argv: list[str]) -> int:
    """Time all robots."""
    args = parse(argv)
    lanes = args.lanes or ([256, 2048] if on_gpu() else [16, 64])
    rows = []
    for robot in args.robots:
        rows += lander_rows(args, lanes) if robot == "lunar-lander" else robot_rows(args, robot, lanes)
    if args.json:
        settings = {"lanes": lanes} | {
            name: getattr(args, name) for name in ("robots", "settings", "impls", "steps", "seed", "repeats")
        }
        write_record(args.json, "robots", "steps", rows, settings)
    return 0


def robot_rows(args, robot: str, lanes: list[int]) -> list[Row]:
    """Time a robot of MuJoCo, with each of the settings."""
    rows = []
    for setting in args.settings:
        simulator = simulator_of(robot, setting)
        peer = [] if args.no_peer else [mujoco_row(args, simulator)]
        ours = [
            mjx_row(args, simulator_of(robot, setting, impl), impl, number)
            for impl in args.impls or default_impls()
            for number in lanes
        ]
        steps = peer + ours
        print_rows(f"{robot}, settings: {setting}", "physics steps", steps, steps[0].what)
        rows += [Row(f"{robot}, {setting}: {row.what}", *fields(row)) for row in steps]
    return rows


def fields(row: Row) -> tuple:
    """All fields of a row but its name."""
    return row.runs, row.seconds, row.work, row.compile_seconds


def default_impls() -> list[str]:
    """The implementations that are fast on this device."""
    return ["jax", "pallas", "c"] if on_gpu() else ["jax", "c"]


def simulator_of(robot: str, setting: str, impl: str = "jax") -> Simulator:
    """The simulator of a robot with the given solver settings."""
    physics = MJX.model_validate({"impl": impl})
    if setting != "model":
        iterations, ls_iterations, integrator = setting.split("/")
        given = {"iterations": int(iterations), "ls_iterations": int(ls_iterations), "integrator": integrator}
        physics = MJX.model_validate(given | {"impl": impl})
    if robot in SCHEMAS:
        return build(SCHEMAS[robot](physics=physics), "float32").simulator
    return Simulator(build(physics, "float32"), packaged(MODELS[robot]), substeps=5)


def ranges_of(simulator: Simulator) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of the controls."""
    ranges = simulator.mujoco_model.actuator_ctrlrange
    return ranges[:, 0], ranges[:, 1]


def mjx_row(args, simulator: Simulator, impl: str, lanes: int) -> Row:
    """Time an implementation, in a compiled program, with a number of robots at once."""
    low, high = (jnp.asarray(side, jnp.float32) for side in ranges_of(simulator))
    start = jnp.asarray(simulator.mujoco_model.qpos0, jnp.float32)

    def run(index):
        key = jax.random.fold_in(jax.random.key(args.seed), index)
        shape = (args.steps, low.size)
        controls = low[None] + (high - low)[None] * jax.random.uniform(key, shape, jnp.float32)
        state = simulator.state(start, jnp.zeros((simulator.mujoco_model.nv,), jnp.float32))
        return jax.lax.scan(lambda s, u: (simulator.advance(s, u), None), state, controls)[0].qpos

    work = args.steps * simulator.substeps
    return time_runs(f"bojax, {IMPLS[impl]}, {lanes} at once", run, lanes, lanes, work, args.repeats)


def mujoco_row(args, simulator: Simulator, runs: int = 64) -> Row:
    """Time C MuJoCo's rollout on all cores of this process."""
    from mujoco import rollout

    model = simulator.mujoco_model
    low, high = ranges_of(simulator)
    controls = np.random.default_rng(args.seed).uniform(low, high, (runs, args.steps, low.size))
    controls = np.repeat(controls, simulator.substeps, axis=1)
    cores = usable_cores()
    data = [mujoco.MjData(model) for _ in range(cores)]
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data[0], state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    with rollout.Rollout(nthread=cores if cores > 1 else 0) as pool:
        seconds = median_seconds(
            lambda: pool.rollout(model, data, np.tile(state, (runs, 1)), controls), args.repeats
        )
    threads = "1 thread" if cores == 1 else f"{cores} threads"
    return Row(f"C MuJoCo, {threads}", runs, seconds, runs * controls.shape[1])


def lander_rows(args, lanes: list[int]) -> list[Row]:
    """Time the lunar lander, and Gymnasium's on Box2D."""
    env = build(LunarLander(), "float32")

    def run(index):
        key = jax.random.fold_in(jax.random.key(args.seed), index)
        actions = jax.random.uniform(jax.random.fold_in(key, 1), (args.steps, 2), jnp.float32, -1.0, 1.0)
        state = env.reset(jax.random.fold_in(key, 0))

        def step(state, at):
            return env.step(jax.random.fold_in(key, at[0]), state, at[1])[0], None

        numbers = jnp.arange(2, args.steps + 2)
        return env.observe(jax.lax.scan(step, state, (numbers, actions))[0])

    peers = {} if args.no_peer else {"Gymnasium, Box2D": ("Box2D", gym_lander)}
    rows = [Row(name, 1, *gym_seconds(args, made)) for name, made in installed(peers).items()]
    rows += [
        time_runs(f"bojax, {number} at once", run, number, number, args.steps, args.repeats)
        for number in lanes
    ]
    print_rows("lunar-lander", "steps", rows, rows[0].what)
    return [Row(f"lunar-lander: {row.what}", *fields(row)) for row in rows]


def gym_lander() -> Any:
    """Gymnasium's lander with continuous actions."""
    import gymnasium

    return gymnasium.make("LunarLander-v3", continuous=True).unwrapped


def gym_seconds(args, env: Any) -> tuple[float, int]:
    """Seconds and number of some steps of an environment of Gymnasium."""
    actions = np.random.default_rng(args.seed).uniform(-1.0, 1.0, (200, 2)).astype(np.float32)

    def episode():
        env.reset(seed=args.seed)
        for action in actions:
            if env.step(action)[2]:
                env.reset()

    return median_seconds(episode, min(args.repeats, 3)), len(actions)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
