"""Process-wide flags, each checked in a process of its own."""

import json
import os
import subprocess
import sys

import pytest

from bojax.engine.devices import cache_folder, usable_cores

REPORT = """
import json
import jax
{before}
from bojax.engine.devices import find_devices, prepare, setting
assert not jax.config.read("jax_enable_x64")
prepare({device!r})
flags = ("jax_enable_x64", "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
print(json.dumps([len(find_devices("cpu")), *map(setting, flags)]))
"""


def prepared(device="cpu", before="", **environment):
    clean = {key: value for key, value in os.environ.items() if key not in ("XLA_FLAGS", "BOJAX_CACHE")}
    code = REPORT.format(device=device, before=before)
    result = subprocess.run(
        [sys.executable, "-c", code], env=clean | environment, capture_output=True, text=True, check=True
    )
    return json.loads(result.stdout)


def test_one_cpu_device_per_core(tmp_path):
    count, x64, cache, least = prepared(XDG_CACHE_HOME=str(tmp_path))
    assert count == usable_cores()
    assert x64 is True
    assert cache == str(tmp_path / "bojax" / "jax") and least == 0.0


@pytest.mark.parametrize(
    ("settings", "count"),
    [
        ({"XLA_FLAGS": "--xla_force_host_platform_device_count=3"}, 3),
        ({"JAX_NUM_CPU_DEVICES": "5"}, 5),
        ({"before": "jax.devices()"}, 1),  # a backend runs already: its starter has chosen
    ],
)
def test_what_the_user_has_set_is_left_alone(settings, count):
    assert prepared(JAX_COMPILATION_CACHE_DIR="/elsewhere", **settings)[::2] == [count, "/elsewhere"]


def test_cache_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("BOJAX_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.delenv("BOJAX_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "bojax" / "jax"
