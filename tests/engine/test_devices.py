"""Process-wide flags, each checked in a process of its own."""

import json
import os
import subprocess
import sys

from bojax.engine.devices import cache_folder, workers_of
from bojax.numerics.cores import usable_cores

REPORT = """
import json
import jax
{before}
from bojax.engine.devices import find_devices, prepare, setting, workers_of
assert not jax.config.read("jax_enable_x64")
prepare({device!r})
flags = ("jax_enable_x64", "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
found = find_devices("cpu")
print(json.dumps([len(found), len(workers_of(found)), *map(setting, flags)]))
"""


def prepared(device="cpu", before="", **environment):
    clean = {key: value for key, value in os.environ.items() if key not in ("XLA_FLAGS", "BOJAX_CACHE")}
    code = REPORT.format(device=device, before=before)
    result = subprocess.run(
        [sys.executable, "-c", code], env=clean | environment, capture_output=True, text=True, check=True
    )
    return json.loads(result.stdout)


def test_a_cpu_is_one_device_of_a_worker_for_each_core(tmp_path):
    count, workers, x64, cache, least = prepared(XDG_CACHE_HOME=str(tmp_path))
    assert (count, workers) == (1, usable_cores())
    assert x64 is True
    assert cache == str(tmp_path / "bojax" / "jax") and least == 0.0


def test_every_accelerator_has_two_workers():
    class Accelerator:
        platform = "gpu"

    devices = [Accelerator(), Accelerator()]
    assert workers_of(devices) == [devices[0], devices[0], devices[1], devices[1]]


def test_what_the_user_has_set_is_left_alone():
    assert prepared(JAX_COMPILATION_CACHE_DIR="/elsewhere")[3] == "/elsewhere"


def test_cache_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("BOJAX_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.delenv("BOJAX_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "bojax" / "jax"
