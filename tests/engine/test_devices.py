"""Process-wide flags, each checked in a process of its own."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence

import jax
import pytest

from bojax.cli.main import main
from bojax.engine.devices import cache_folder, choose, find_devices, suited, workers_of
from bojax.engine.errors import EngineError
from bojax.numerics.cores import usable_cores

REPORT = """
import json
import jax
from bojax.engine.devices import find_devices, prepare, setting, workers_of
assert not jax.config.read("jax_enable_x64")
prepare("cpu")
flags = ("jax_enable_x64", "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
found = find_devices("cpu")
draw = float(jax.random.uniform(jax.random.key(3)))
print(json.dumps([len(found), len(workers_of(found)), *map(setting, flags), draw]))
"""


def python(*words: str, without: Sequence[str] = (), **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python with these words, in an environment without some variables and with others."""
    kept = {key: value for key, value in os.environ.items() if key not in without}
    return subprocess.run([sys.executable, *words], env=kept | environment, capture_output=True, text=True)


def prepared(**environment):
    return json.loads(python("-c", REPORT, without=["XLA_FLAGS", "BOJAX_CACHE"], **environment).stdout)


def test_a_cpu_is_one_device_of_a_worker_for_each_core(tmp_path):
    count, workers, x64, cache, least, _ = prepared(XDG_CACHE_HOME=str(tmp_path))
    assert (count, workers) == (1, usable_cores())
    assert x64 is True
    assert cache == str(tmp_path / "bojax" / "jax") and least == 0.0


def test_a_cache_of_the_user_is_left_alone_and_random_numbers_depend_on_the_seed_alone():
    flags = {"DEFAULT_PRNG_IMPL": "rbg", "THREEFRY_PARTITIONABLE": "0", "RANDOM_SEED_OFFSET": "1"}
    flags["COMPILATION_CACHE_DIR"] = "/elsewhere"
    *_, cache, _, draw = prepared(**{f"JAX_{name}": value for name, value in flags.items()})
    assert cache == "/elsewhere" and draw == float(jax.random.uniform(jax.random.key(3)))


def test_platforms_that_jax_cannot_start_are_one_line(tmp_path):
    ended = python("-m", "bojax", "run", "parking", "--out", str(tmp_path / "out"), JAX_PLATFORMS="tpu")
    assert ended.returncode == 2
    assert ended.stderr.splitlines()[-1].startswith(
        "error: JAX_PLATFORMS: got tpu; allowed: platforms that JAX can start on this machine, or unset it: "
    )
    assert "Traceback" not in ended.stderr and not (tmp_path / "out").exists()


def test_a_gpu_that_does_not_start_is_an_error_and_no_reason_to_use_the_cpu():
    code = """
import time
from jax._src import xla_bridge
from bojax.engine.devices import find_devices, start_early
from bojax.engine.errors import EngineError
def broken():
    raise RuntimeError("the GPU is taken")
xla_bridge.register_backend_factory("broken", broken, priority=500, fail_quietly=False)
start_early("auto")
time.sleep(0.5)
try:
    find_devices("auto")
except EngineError as error:
    print(error)
"""
    ended = python("-c", code, without=["JAX_PLATFORMS"])
    assert ended.returncode == 0 and ended.stdout.startswith(
        "JAX cannot start; run `bojax doctor`, or use engine.device=cpu: "
    )
    assert "the GPU is taken" in ended.stdout and len(ended.stdout.splitlines()) == 1


def test_a_process_does_not_end_while_backends_start():
    code = """
import time, jax
from bojax.engine.devices import start_early
jax.devices = lambda: (time.sleep(0.5), print("started"))
start_early("cpu")
"""
    ended = python("-c", code)
    assert (ended.returncode, ended.stdout) == (0, "started\n")


class Named:
    """A device, as far as the choice of devices is concerned."""

    device_kind = "H200"

    def __init__(self, platform):
        self.platform = platform


GPUS, CPU = [Named("gpu"), Named("gpu")], Named("cpu")


def test_every_accelerator_has_two_workers_and_leaves_cores_to_the_cpu():
    assert workers_of(GPUS) == [GPUS[0], GPUS[0], GPUS[1], GPUS[1]]
    assert workers_of([CPU], 5) == [CPU] * 5
    assert workers_of([GPUS[0], CPU], 9) == [GPUS[0]] * 2 + [CPU] * 2
    assert workers_of([GPUS[0], CPU], 1) == [GPUS[0]] * 2 + [CPU]


def test_the_cpu_stands_beside_the_gpus(monkeypatch):
    monkeypatch.setattr(jax, "devices", lambda platform=None: [CPU] if platform == "cpu" else GPUS)
    assert find_devices("auto") == [*GPUS, CPU]
    assert find_devices("gpu") == GPUS and find_devices("cpu") == [CPU]
    assert choose([*GPUS, CPU], None) == [*GPUS, CPU] and choose([*GPUS, CPU], [1]) == [GPUS[1], CPU]
    both = [CPU, Named("cpu")]
    assert choose(both, None) == both[:1] and choose(both, [0, 1]) == both
    with pytest.raises(EngineError, match="--devices: got 2; allowed: 0 to 1, this machine has 2 x gpu"):
        choose([*GPUS, CPU], [2])


def test_a_sweep_uses_devices_of_one_platform():
    assert suited([*GPUS, CPU]) == GPUS and suited([CPU]) == [CPU]


def test_flags_with_which_no_program_runs_are_one_line(tmp_path, capsys):
    for context, given in (
        (jax.disable_jit(), "DISABLE_JIT: got True"),
        (jax.transfer_guard("disallow"), "TRANSFER_GUARD: got disallow"),
    ):
        with context:
            assert main(["run", "chain", "--out", str(tmp_path / "out")]) == 2
            with pytest.raises(EngineError, match=given):  # as in training from Python
                find_devices("cpu")
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"error: JAX_{given}") and not (tmp_path / "out").exists()


def test_variables_that_jax_refuses_are_one_line(tmp_path):
    done = python("-m", "bojax", "run", "chain", "--out", str(tmp_path / "out"), JAX_ENABLE_X64="maybe")
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2 and line.startswith("error: JAX refuses") and "JAX_ENABLE_X64" in line
    assert not (tmp_path / "out").exists()


def test_cache_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("BOJAX_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.delenv("BOJAX_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "bojax" / "jax"
