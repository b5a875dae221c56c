"""What a chunk saves: checkpoints in the background, and learners that are merged into one tree a point."""

import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from jaxtyping import Array

from bojax.config.settings import Record
from bojax.engine.learners import EVALUATION_EPISODES, LEARNED, load_learner, merge_learners
from bojax.engine.storage import FolderSink
from bojax.results.chunk_folder import ChunkFolder
from bojax.results.store import ResultsError
from tests.examples.pages import ROOT, blocks
from tests.tiers import by_tier

CARRY = [jnp.arange(600.0), jnp.full((7, 3), -1, jnp.int32), jax.random.split(jax.random.key(5), 4)]
STRUCTURE = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in CARRY]


class State(NamedTuple):
    """What a learner has learned."""

    weights: Array
    transitions: Array
    key: Array


def learned(run: int) -> State:
    return State(jnp.arange(3.0) + run, jnp.zeros((0, 2)), jax.random.key(run))


LEARNER = jax.eval_shape(lambda: learned(0))


def opened(path: Path, name: str = "chunk-a") -> ChunkFolder:
    files = ChunkFolder(path / ".work" / name, path, "chunk")
    files.path.mkdir(parents=True, exist_ok=True)
    files.read()
    return files


def sink_of(files: ChunkFolder, runs: int = 8) -> FolderSink:
    return FolderSink(files, Record(runs=runs, learners=True))


def stopped(path: Path) -> ChunkFolder:
    """A chunk with a checkpoint and the learners of two runs, of point 0 and of point 2."""
    files = opened(path)
    sink = sink_of(files)
    sink.state.advances = 3
    sink.write_learner(0, 1, learned(1))
    sink.write_learner(2, 0, learned(20))
    sink.save(CARRY)
    sink.wait()
    return files


def test_a_flipped_bit_anywhere_is_refused(tmp_path):
    folder = stopped(tmp_path).path
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.stat().st_size]
    assert {path.relative_to(folder).parts[0] for path in files} == {
        *("checkpoint-00000003", "learners-00000003", "state.json")
    }
    draw = np.random.default_rng(0)
    for number in range(60):
        path = files[number % len(files)]
        whole = path.read_bytes()
        place, bit = draw.integers(len(whole)), 1 << draw.integers(8)
        path.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        with pytest.raises(ResultsError, match="delete the folder .* and resume") as error:
            ChunkFolder(folder, tmp_path, "chunk").read()
        assert str(folder) in str(error.value) and "\n" not in str(error.value)
        path.write_bytes(whole)
    restored = sink_of(opened(tmp_path)).load(STRUCTURE)
    for found, saved in zip(restored, CARRY, strict=True):
        assert found.dtype == saved.dtype and bool((found == saved).all())


KILLED = """
import os, signal, sys, threading
from pathlib import Path
import tests.strict
import jax.numpy as jnp
from tests.engine.test_sinks import CARRY, opened, sink_of
sink = sink_of(opened(Path(sys.argv[1])))
sink.state.advances = 1
sink.save([*CARRY])
sink.wait()
sink.state.advances = 2
sink.save([jnp.ones(3_000_000)])
threading.Event().wait(float(sys.argv[2]))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("seconds", by_tier([0.0, 0.02], normal=[0.02]))
def test_killed_during_a_save(tmp_path, seconds):
    command = [sys.executable, "-c", KILLED, str(tmp_path), str(seconds)]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == -signal.SIGKILL and ended.stderr == ""
    files = opened(tmp_path, "next")
    assert files.inherit(opened(tmp_path))
    assert files.state.advances == 1  # the second one is not committed within milliseconds
    assert {path.name for path in files.path.iterdir()} == {"checkpoint-00000001", "state.json"}
    assert (sink_of(files).load(STRUCTURE)[0] == CARRY[0]).all()


def test_a_full_disk_is_told_when_the_next_rows_are_written(tmp_path, monkeypatch):
    sink = sink_of(opened(tmp_path))
    monkeypatch.setattr(
        "orbax.checkpoint.v1.save_async",
        lambda *_: type("Ended", (), {"result": lambda self: (_ for _ in ()).throw(OSError(28, "full"))})(),
    )
    sink.save(CARRY)
    while not sink._commit.done():  # pyright: ignore[reportOptionalMemberAccess]
        pass
    with pytest.raises(ResultsError, match="the disk is full"):
        sink.write_piece({})
    assert not ChunkFolder(sink._files.path, tmp_path).read()


@pytest.fixture
def results(here) -> Path:
    """Learners of runs 0 to 3 of point 0, from two chunks, of which one was stopped and resumed."""
    folder = Path("results/hill").absolute()
    first, second = stopped(folder), opened(folder, "chunk-b")
    for files, runs in ((first, [0]), (second, [3, 2])):
        sink = sink_of(files)
        sink.state.advances += 1
        for run in runs:
            sink.write_learner(0, run, learned(run))
        sink.finish()
    assert opened(folder).learners() == [
        first.path / name for name in ("learners-00000003", "learners-00000004")
    ]
    for _ in range(2):  # a merge may be repeated
        merge_learners(folder, [first, second], [{"kind": "learning", "tests": 2}] * 3)
    return folder


def test_the_learners_of_a_point_are_one_tree(results):
    folder = results / "learners" / "0" / LEARNED
    for run in range(4):
        found = load_learner(folder, run, LEARNER)
        np.testing.assert_array_equal(found.weights, learned(run).weights)
        assert found.transitions.shape == (0, 2) and found.key == jax.random.key(run)
    assert load_learner(results / "learners" / "2" / LEARNED, 0, LEARNER).weights[0] == 20.0
    with pytest.raises(ResultsError, match="holds no learner of run 7; allowed: 0, 1, 2, 3"):
        load_learner(folder, 7, LEARNER)
    config = yaml.safe_load((folder.parent / "experiment.yaml").read_text())
    assert config == {
        "experiment": "learning",
        **{"saved": LEARNED, "saved_run": 0, "schedule": "exploit"},
        **{"episodes": EVALUATION_EPISODES, "stop": "never", "map_episodes": []},
    }


def test_damaged_learners_are_refused(results):
    folder = results / "learners" / "0" / LEARNED
    for path in [path for path in folder.rglob("*") if path.is_file()]:
        whole = path.read_bytes()
        path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]) if whole else b"x")
        with pytest.raises(ResultsError, match="learner: damaged or edited"):
            load_learner(folder, 0, LEARNER)
        path.write_bytes(whole)
    load_learner(folder, 0, LEARNER)


@pytest.mark.filterwarnings("ignore:Sharding info not provided")
def test_the_page_shows_how_orbax_opens_them(results, capsys):
    (shown,) = [text for kind, text, _ in blocks(ROOT / "docs" / "results.md") if "orbax" in text]
    stopped(results / "again").path.rename(results / ".work" / "chunk-c")
    exec(shown, {})
    assert capsys.readouterr().out.splitlines() == [
        "[0 1 2 3]",
        "{'key': (4, 2), 'weights': (4, 3)}",
        "{'0': (600,), '1': (7, 3), '2': (4, 2)}",
    ]
