"""Commands without what only POSIX has: flock, SIGHUP, SIGUSR2, user ids, symbolic links, folders that open.

Nothing here runs on Windows: a process without these names stands for it.
"""

import os
import subprocess
import sys

from bojax.results import store
from tests.report.synthetic import write_results

POSIX_IS_GONE = """
import os, platform, signal, sys
sys.modules["fcntl"] = None  # an import raises
for name in ("SIGHUP", "SIGUSR1", "SIGUSR2", "SIGKILL"):
    delattr(signal, name)
for name in ("geteuid", "getuid", "fork", "killpg", "sched_getaffinity"):
    if hasattr(os, name):
        delattr(os, name)
def refused(*_, **__):
    raise OSError(1314, "A required privilege is not held by the client")
os.symlink = refused
opened = os.open
def open_file(path, *args, **kwargs):
    if os.path.isdir(path) and "dir_fd" not in kwargs:  # shutil, which has another way on Windows
        raise PermissionError(13, "Permission denied", str(path))
    return opened(path, *args, **kwargs)
os.open = open_file
platform.system = lambda: "Windows"
from bojax.results import store
store.IS_POSIX = False
"""


def run(code, folder):
    command = [sys.executable, "-c", POSIX_IS_GONE + code]
    path = os.pathsep.join(filter(None, [os.getcwd(), os.environ.get("PYTHONPATH")]))
    env = {**os.environ, "JAX_PLATFORMS": "cpu", "PYTHONPATH": path}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)


def test_functions_and_commands_that_lock_nothing_run_without_posix(tmp_path):
    write_results(tmp_path / "sweep", runs=20)
    code = """
import bojax
found = bojax.minimise(lambda x: (x - 0.3) ** 2, {"x": (0.0, 1.0)}, budget=5, progress=False)
assert found.table.num_rows == 5
assert bojax.load("sweep").runs.num_rows == 100
assert bojax.part("kcbts", iterations=5).iterations == 5
from bojax.engine.devices import why_not_private
from pathlib import Path
assert why_not_private(Path("cache")) is None
from bojax.cli.main import main
commands = [
    ["list", "kcbts"], ["report", "sweep"], ["status", "sweep"], ["export", "sweep", "--to", "csv"],
    ["compare", "sweep", "--out", "page"],
    ["survey", "200x100", "--budget", "500", "--lawnmower", "--out", "lake"],
]
print([main(words) for words in commands])
"""
    ended = run(code, tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-1:] == ["[0, 0, 0, 0, 0, 0]"], ended.stderr
    assert (tmp_path / "page" / "comparison.html").exists() and (tmp_path / "lake" / "report.html").exists()


def test_files_are_synced_and_folders_are_not_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "IS_POSIX", False)
    synced, opened = [], os.open
    monkeypatch.setattr(
        store.os, "open", lambda path, flags: synced.append((path, flags)) or opened(path, flags)
    )
    (tmp_path / "table").write_text("rows")
    store.sync(tmp_path / "table", tmp_path)
    assert synced == [(tmp_path / "table", os.O_RDWR)]
