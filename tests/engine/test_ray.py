"""A sweep on a local cluster of Ray, with two nodes that pretend to have a GPU each."""

import importlib
import importlib.util
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import types
from pathlib import Path

import pytest

from bojax.config.launching import RayConfig
from bojax.engine.errors import EngineError
from bojax.engine.launchers import ray_actors
from bojax.results.attempts import AttemptRegistry
from bojax.results.store import WORK
from tests.engine.clusters import EPISODES, SWEEP, contents, running_in, search_path, wait_until


@pytest.fixture(scope="module")
def cluster():
    if importlib.util.find_spec("ray") is None:
        pytest.skip("needs the extra ray")
    utils = importlib.import_module("ray.cluster_utils")
    made = utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "num_gpus": 1})
    made.second = made.add_node(num_cpus=1, num_gpus=1)
    made.wait_for_nodes()
    yield made
    made.shutdown()


def start(place: Path, *words: str, address: str | None = None) -> subprocess.Popen:
    return bojax(place, "sweep", "sweep.yaml", EPISODES, *words, address=address)


ENTRY = "from bojax.engine.launchers import ray_actors; from bojax.cli.main import entry; {}; entry()"


def bojax(place: Path, *words: str, address: str | None, before: str = "", **variables) -> subprocess.Popen:
    """`bojax WORDS`, after a Python statement in which `ray_actors` may be changed."""
    environment = {**os.environ, **search_path(), **variables}
    if address:
        environment["RAY_ADDRESS"] = address
    return subprocess.Popen(
        [sys.executable, "-c", ENTRY.format(before or "pass"), *words],
        cwd=place,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.ray
def test_actors_nodes_and_drivers_are_lost(cluster, tmp_path):
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    alone, out = tmp_path / "alone", tmp_path / "out"
    assert start(tmp_path, "--out", "alone").wait(300) == 0
    options = ("--launcher", "ray", "--out", "out")
    driver = start(tmp_path, *options, address=cluster.address)
    wait_until(lambda: len(running_in(out, with_checkpoint=True)) == 2, driver)  # one for each GPU
    os.kill(running_in(out, with_checkpoint=True)[0], signal.SIGKILL)
    driver.send_signal(signal.SIGKILL)
    driver.communicate()
    cluster.remove_node(cluster.second)  # now, since a driver may use that node to reach the cluster
    driver = start(tmp_path, *options, "--resume", address=cluster.address)
    text, _ = driver.communicate(timeout=300)
    assert driver.returncode == 0, text
    assert contents(out) == contents(alone)
    assert not (out / WORK).exists()


@pytest.mark.ray
def test_a_driver_that_is_interrupted_stops_its_actors(cluster, tmp_path):
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    out = tmp_path / "out"
    driver = start(tmp_path, "--launcher", "ray", "--out", "out", address=cluster.address)
    wait_until(lambda: running_in(out, with_checkpoint=True), driver)
    driver.send_signal(signal.SIGTERM)
    text, _ = driver.communicate(timeout=120)
    assert driver.returncode == 143, text
    assert "interrupted; to resume:\n  bojax sweep sweep.yaml" in text
    attempts = AttemptRegistry(out / WORK, out)
    begun = [each for each in attempts.begun() if not attempts.has_ended(each)]
    assert begun and all(attempts.paused.get(each) == attempts.newest(each) for each in begun)


@pytest.mark.ray
def test_the_rounds_of_a_search_run_on_the_same_actors(cluster, tmp_path):
    words = ["chain", "episodes=3", "learner.discount=0.8:1", "--batch", "2", "--runs", "2", "--budget", "8"]
    options = ["--confirm", "2", "--launcher", "ray", "--out", "out"]
    text, _ = bojax(tmp_path, "tune", *words, *options, address=cluster.address).communicate(timeout=300)
    assert (tmp_path / "out" / "tuning.json").exists(), text
    assert 1 <= len(set(re.findall(r"_Actor pid=(\d+)", text))) <= 2, text


@pytest.mark.slow
@pytest.mark.ray
def test_without_an_address_ray_is_started_here(cluster, tmp_path):
    """The file of Ray's last cluster names one that has ended, and Ray would wait for it."""
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    with tempfile.TemporaryDirectory(prefix="ray-") as place:  # the names of Ray's sockets must be short
        (Path(place) / "ray").mkdir()
        (Path(place) / "ray" / "ray_current_cluster").write_text("127.0.0.1:1")
        words = ["sweep", "sweep.yaml", "episodes=5", "--launcher", "ray", "--out", "out"]
        driver = bojax(tmp_path, *words, address=None, RAY_TMPDIR=place)
        text, _ = driver.communicate(timeout=120)
    assert driver.returncode == 0, text


@pytest.mark.slow
@pytest.mark.ray
def test_a_cluster_loses_its_only_node(tmp_path):
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    utils = pytest.importorskip("ray.cluster_utils")
    cluster = utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    try:
        node = cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        words = ["sweep", "sweep.yaml", "episodes=1000000", "--launcher", "ray", "--out", "out"]
        few = "ray_actors.LOST_SECONDS = 2.0"
        address = cluster.address
        driver = bojax(tmp_path, *words, address=address, before=few)
        wait_until(lambda: running_in(tmp_path / "out", with_checkpoint=True), driver)
        cluster.remove_node(node)
        text, _ = driver.communicate(timeout=120)
    finally:
        cluster.shutdown()
    assert driver.returncode == 1, text
    reason, advice = [line for line in text.splitlines() if line.startswith("error: ")][-2:]
    assert reason == f"error: --launcher ray: the cluster at {address} has no node for a worker any more"
    assert advice.startswith("error: the workers have ended early; to go on: bojax sweep ")


def test_a_cluster_that_does_not_answer_any_more_is_given_up(monkeypatch, capsys):
    launcher = ray_actors.Ray(RayConfig())
    launcher._calls["call"] = 0, 0
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        launcher._address = f"127.0.0.1:{unused.getsockname()[1]}"
        assert launcher.keep() and not launcher.all_refused
        monkeypatch.setattr(ray_actors, "LOST_SECONDS", 0.0)
        assert not launcher.keep() and launcher.all_refused
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"error: --launcher ray: the cluster at {launcher._address} does not answer any more"
    launcher.close()  # asks nothing of Ray


def test_an_actor_tells_why_it_left(tmp_path):
    """As on a node that does not share the folder."""
    error = ray_actors._Actor().work([str(tmp_path / "elsewhere")], 0, 1, 1)
    assert error is not None and "elsewhere: no such folder on " in error


def test_a_worker_that_cannot_run_tells_why(monkeypatch):
    """As on a node without bojax: the reason is the last line of what Ray says."""

    class Failure(Exception):
        actor_init_failed = True

    def fail(_):
        raise Failure(
            "The actor died in its creation task, ...\nTraceback ...\nModuleNotFoundError: no bojax"
        )

    kinds = types.SimpleNamespace(RayError=Failure, RayActorError=Failure)
    fake = types.SimpleNamespace(wait=lambda calls, **_: (calls, []), get=fail, exceptions=kinds)
    monkeypatch.setitem(sys.modules, "ray", fake)
    launcher = ray_actors.Ray(RayConfig())
    launcher._calls["call"] = 0, 0
    with pytest.raises(
        EngineError, match="--launcher ray: a worker cannot run: ModuleNotFoundError: no bojax$"
    ):
        launcher.keep()


@pytest.fixture
def here(here, monkeypatch) -> Path:
    """A working directory with a sweep, and what nobody has set."""
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    (here / "sweep.yaml").write_text(SWEEP)
    return here


LAUNCH = "sweep sweep.yaml --out out --launcher ray"


def refuse(*_, **__):
    raise ConnectionError("Failed to connect to Ray cluster")


def hang(*_, **__):
    threading.Event().wait(60)


TOKEN = "if it asks for a token, set RAY_AUTH"


@pytest.mark.parametrize(
    ("listens", "init", "message"),
    [
        (
            False,
            refuse,
            "(ConnectionRefusedError: [Errno 111] Connection refused); start one with `ray start",
        ),
        (True, refuse, f"(ConnectionError: Failed to connect to Ray cluster); {TOKEN}"),
        (True, hang, f"(TimeoutError: no connection within 0 s); {TOKEN}"),
    ],
)
def test_no_cluster_at_the_address(here, refusal, monkeypatch, listens, init, message):
    """Where nothing answers, Ray itself would try for minutes."""
    fake = types.SimpleNamespace(is_initialized=lambda: False, init=init)
    monkeypatch.setattr(ray_actors, "CONNECT_SECONDS", 0.2)
    monkeypatch.setitem(sys.modules, "ray", fake)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        if listens:
            unused.listen()
        address = f"127.0.0.1:{unused.getsockname()[1]}"
        (here / "ray.yaml").write_text(f"address: {address}")
        error = refusal(f"{LAUNCH} --cluster ray.yaml")
    assert error.startswith(f"--launcher ray: no Ray cluster at {address} {message}")


def test_more_cores_than_the_cluster_has(here, refusal, monkeypatch):
    """Refused before anything is written, and Ray is shut down again."""
    calls = []
    cluster = {
        "is_initialized": lambda: False,
        "cluster_resources": lambda: {"CPU": 2.0},
        "nodes": lambda: [1],
        "get_runtime_context": lambda: types.SimpleNamespace(gcs_address="127.0.0.1:1"),
        "init": lambda address, **_: calls.append(f"init {address}"),
        "shutdown": lambda: calls.append("shutdown"),
    }
    monkeypatch.setitem(sys.modules, "ray", types.SimpleNamespace(**cluster))
    (here / "ray.yaml").write_text("cpus_per_worker: 64")
    message = "--launcher ray: cpus_per_worker: got 64; allowed: at most 2"
    assert refusal(f"{LAUNCH} --cluster ray.yaml") == message
    assert calls == ["init local", "shutdown"]


def test_without_the_extra(here, refusal, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    message = "ray is not installed; install it in a clone of bojax: pip install -e '.[ray]'"
    assert refusal(LAUNCH) == message


def test_actors_of_gpus_share_the_cores():
    found = {"GPU": 8.0, "CPU": 64.0}
    count, options, cores = ray_actors.Ray(RayConfig())._shape(found, 1)
    assert (count, options["num_gpus"], cores) == (8, 1, 8)
