"""Runs leave and enter lanes: every run is that of a plain loop, and the clock changes no bit."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pytest

from bojax.config.settings import Record
from bojax.config.sweep import load_config
from bojax.engine.batch import Functions, Programs, run_key
from bojax.engine.build import build
from bojax.engine.chunks import Layout, choose_layout, cut
from bojax.engine.errors import Stopped
from bojax.engine.groups import static_groups
from bojax.engine.runner import ChunkRunner, Limits
from bojax.engine.storage import FolderSink, Sink
from bojax.learning.settings import EMUQ, RFFQ, EMUQPublished
from bojax.results.chunk_folder import ChunkFolder
from bojax.results.store import read_table
from bojax.results.tables import sort_rows
from tests.tiers import by_tier
from tests.toy import Toy, toy

SEED, RUNS = 5, 12
MODULES = [toy(scale=1.0, max_length=30), toy(scale=2.0, max_length=30)]
(GROUP,) = static_groups(MODULES)
FUNCTIONS = Functions(GROUP)
NEVER = Limits(float("inf"), float("inf"), bool)

PLAIN = Layout(24, (24,), 0)
LAYOUTS = {
    "refilled": Layout(24, (5,), 1),
    "refilled now and then": Layout(24, (5,), 4),
    "narrowed": Layout(24, (24, 8, 2), 1),
    "narrowed now and then": Layout(24, (24, 7), 3),
    "refilled and narrowed": Layout(24, (8, 3), 2),
    "refilled and narrowed at once": Layout(24, (20, 17), 9),
    "two queues": Layout(13, (4, 1), 1),
}


def programs_for(functions: Functions, recorded: int):
    """A function from a layout to its programs by width; all layouts share them."""

    @cache
    def compiled(width, wider):
        return Programs(functions, jax.devices("cpu")[0], width, SEED, recorded=recorded, wider=wider)

    return lambda layout: lambda width: compiled(width, layout.wider(width))


programs_of = programs_for(FUNCTIONS, recorded=6)


def chunks_of(layout: Layout):
    return cut(GROUP, range(RUNS), layout, [{}, {}], {})


def run(runner: ChunkRunner) -> None:
    runner.advance()
    runner.finish()


def run_in_memory(layout: Layout, limits: Limits = NEVER) -> tuple[dict[str, pa.Table], list]:
    parts, segments = {}, []
    for chunk in chunks_of(layout):
        sink = Sink()
        run(ChunkRunner(chunk, MODULES[0], programs_of(layout), sink, limits, segments.append))
        assert sink.state.is_done and sink.state.next_run == chunk.num_runs
        for name, tables in sink.tables.items():
            parts.setdefault(name, []).extend(tables)
    return {name: sort_rows(pa.concat_tables(tables)) for name, tables in parts.items()}, segments


@pytest.fixture(scope="module")
def plain():
    return run_in_memory(PLAIN)[0]


def test_a_batch_gives_the_rows_of_a_loop_over_runs(plain):
    rows = []
    for point, module in enumerate(MODULES):
        init = jax.jit(lambda key, module=module: module.init(key))
        advance = jax.jit(lambda carry, module=module: module.advance(carry))
        for run in range(RUNS):
            carry = init(run_key(jax.random.key(SEED), jnp.asarray(run, jnp.int32)))
            while not module.is_done(carry):
                carry, _ = advance(carry)
            rows.append((point, run, float(module.summary(carry)["return"]), int(carry.step)))
    found = plain["runs"]
    assert found["steps"].to_pylist() == [steps for *_, steps in rows]
    np.testing.assert_allclose(found["return"].to_numpy(), [value for _, _, value, _ in rows], rtol=1e-12)
    assert len({steps for *_, steps in rows}) > 5


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_gives_the_rows_of_a_plain_batch(name, plain):
    tables, segments = run_in_memory(LAYOUTS[name])
    assert tables.keys() == plain.keys()
    for table, expected in plain.items():
        assert tables[table].num_rows == expected.num_rows
        for column in expected.column_names:
            ours, theirs = tables[table][column], expected[column]
            if pa.types.is_floating(ours.type):
                np.testing.assert_allclose(ours.to_numpy(), theirs.to_numpy(), rtol=1e-12)
            else:
                assert ours.equals(theirs), (table, column)
    assert sum(segment.finished for segment in segments) == 2 * RUNS
    assert sum(segment.active_steps for segment in segments) == tables["steps"].num_rows


def rows_and_learners(group, experiment, layout: Layout, programs) -> tuple[dict[str, np.ndarray], dict]:
    """The summaries of eight runs, by run, and the saved learners."""
    (chunk,) = cut(group, range(8), layout, [{}], {})
    sink = Sink(recorded_runs=8, saved_learners=8)
    run(ChunkRunner(chunk, experiment, programs(layout), sink, NEVER, lambda _: None))
    table = sort_rows(pa.concat_tables(sink.tables["runs"]))
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}, sink.learned


PARKING = "parking", "planner.iterations=20", "problem.max_steps=4"
DISCRETE = *PARKING, "planner=sbo"
MOUNTAIN_CAR = "mountain-car", "episodes=5", "env.max_steps=200"


@pytest.mark.parametrize(
    "words",
    by_tier([("chain",), PARKING, DISCRETE, MOUNTAIN_CAR], normal=[("chain",), DISCRETE]),
    ids=lambda words: words[-1],
)
def test_runs_of_shipped_experiments_do_not_depend_on_the_layout(words):
    """Learners are saved as their runs end, from lanes that other runs have had before."""
    config, *changes = words
    (point,) = load_config(config, changes, None, None).points
    experiment = build(point.config, "float64")
    (group,) = static_groups([experiment])
    programs = programs_for(Functions(group), recorded=8)
    expected, learned = rows_and_learners(group, experiment, Layout(8, (8,), 0), programs)
    assert len(np.unique(expected["steps"])) > 1
    for layout in (Layout(8, (3,), 1), Layout(8, (8, 4, 2), 1)):
        found, saved = rows_and_learners(group, experiment, layout, programs)
        for name, values in expected.items():
            if values.dtype.kind == "f":
                np.testing.assert_allclose(found[name], values, rtol=1e-9)
            else:
                np.testing.assert_array_equal(found[name], values)
        assert saved.keys() == learned.keys()
        for key, leaves in learned.items():
            for ours, theirs in zip(jax.tree.leaves(saved[key]), jax.tree.leaves(leaves), strict=True):
                np.testing.assert_allclose(ours, theirs, rtol=1e-6)


def test_repacking_keeps_lanes_busy():
    def busy(layout):
        _, segments = run_in_memory(layout)
        issued = sum(segment.issued_steps for segment in segments)
        return sum(segment.active_steps for segment in segments) / issued

    assert busy(LAYOUTS["refilled"]) > busy(LAYOUTS["refilled now and then"]) > busy(PLAIN)
    assert busy(LAYOUTS["narrowed"]) > busy(PLAIN)


def reopened(path) -> ChunkFolder:
    """The files of a chunk as the process before has left them."""
    files = ChunkFolder(path, path.parent)
    path.mkdir(exist_ok=True)
    files.read()
    return files


@pytest.mark.bits
@pytest.mark.parametrize("name", by_tier(LAYOUTS, normal=["refilled and narrowed", "two queues"]))
def test_stopped_and_resumed_after_some_segments(name, tmp_path):
    layout, folders, seen, stops = LAYOUTS[name], [], [], 0
    expected, once = run_in_memory(layout)
    for chunk in chunks_of(layout):
        while not (files := reopened(tmp_path / chunk.name)).state.is_done:
            sink, end = FolderSink(files, Record(runs=1)), len(seen) + 5
            limits = Limits(1e-9, float("inf"), lambda end=end: len(seen) >= end)
            run(ChunkRunner(chunk, MODULES[0], programs_of(layout), sink, limits, seen.append))
            stops += 1
        folders.append(files)
    assert stops > 2
    # Runs move at the same advances.
    assert sum(each.issued_steps for each in seen) == sum(each.issued_steps for each in once)
    for table, rows in expected.items():
        parts = [read_table(path) for files in folders for path in files.pieces(table)]
        assert sort_rows(pa.concat_tables(parts)).equals(rows)
    saved = sorted(name for files in folders for name in files.snapshots())
    assert saved == ["arrays/0-0-walk-end.npz", "arrays/1-0-walk-end.npz"]


@pytest.mark.bits
@pytest.mark.parametrize("missing", [12, 6])
def test_a_stop_during_the_wait_for_a_program_loses_nothing(tmp_path, missing):
    layout, stops, begun = Layout(24, (24, 12, 6), 1), [], []
    (chunk,) = chunks_of(layout)

    def without_one(width):
        if width == missing:
            stops.append(width)
            raise Stopped
        return programs_of(layout)(width)

    sink = FolderSink(reopened(tmp_path / "chunk"), Record(runs=0))
    limits = Limits(float("inf"), float("inf"), lambda: bool(stops))
    run(ChunkRunner(chunk, MODULES[0], without_one, sink, limits, begun.append))
    files = reopened(tmp_path / "chunk")
    assert stops and files.state.advances > 0
    again = []
    sink = FolderSink(files, Record(runs=0))
    run(ChunkRunner(chunk, MODULES[0], programs_of(layout), sink, NEVER, again.append))
    expected, once = run_in_memory(layout)
    assert sort_rows(pa.concat_tables(map(read_table, files.pieces("runs")))).equals(expected["runs"])
    for count in ("active_steps", "finished", "issued_steps"):  # none is repeated, or made in more lanes
        total = sum(getattr(segment, count) for segment in once)
        assert sum(getattr(segment, count) for segment in [*begun, *again]) == total


@pytest.mark.bits
def test_fewer_lanes_are_announced_before_the_runs_move_there():
    layout, seen = LAYOUTS["narrowed"], []
    (chunk,) = chunks_of(layout)

    def compiled(width):
        seen.append(("moved", width))
        return programs_of(layout)(width)

    def announced(width):
        seen.append(("announced", width))

    run(ChunkRunner(chunk, MODULES[0], compiled, Sink(), NEVER, lambda _: None, announced))
    order = list(dict.fromkeys(seen))
    assert order.index(("announced", 8)) < order.index(("moved", 8)) < order.index(("moved", 2))
    assert order[0] == ("moved", 24)


def test_a_chunk_of_few_runs_narrows_as_soon_as_it_may():
    layout = Layout(24, (24, 8), 3)
    chunk = replace(chunks_of(PLAIN)[0], layout=layout)
    few = replace(chunk, positions=chunk.positions[:4], points=chunk.points[:4], runs=chunk.runs[:4])
    sink, often = Sink(), Limits(1e-9, float("inf"), bool)
    run(ChunkRunner(few, MODULES[0], programs_of(layout), sink, often, lambda _: None))
    assert [lanes for lanes, _, _ in sink.state.segments[:4]] == [24, 24, 8, 8]


@pytest.mark.parametrize(
    ("platform", "runs", "given", "queue", "widths"),
    [
        ("cpu", 200, None, 50, (16,)),  # four queues, which several cores share
        ("cpu", 1000, None, 63, (16,)),
        ("cpu", 20, None, 10, (10,)),
        ("cpu", 3, None, 3, (3,)),
        ("cpu", 20, 4, 10, (4,)),
        ("gpu", 200, None, 200, (200,)),
        ("gpu", 5000, None, 2500, (2500,)),
        ("gpu", 5000, 100, 2500, (100,)),
        ("gpu", 16_384, None, 4096, (4096,)),  # four queues, which several devices share
        ("gpu", 36_000, None, 4000, (4000,)),
        ("gpu", 180_000, None, 12_273, (4091,)),  # three times as many runs as lanes
    ],
)
def test_layout(platform, runs, given, queue, widths):
    layout = choose_layout(toy(), runs, platform, given)
    assert (layout.queue, layout.widths) == (queue, widths)
    assert layout.repack == 1


def test_runs_with_stragglers_narrow_on_an_accelerator(monkeypatch):
    monkeypatch.setattr(Toy, "narrowest", 32)
    assert choose_layout(toy(), 4000, "gpu", None).widths == (4000, 1334, 445, 149, 50)
    assert choose_layout(toy(), 600, "gpu", None).widths == (600, 200, 67)
    assert choose_layout(toy(), 200, "gpu", None).widths == (200, 67)
    assert choose_layout(toy(), 95, "gpu", None).widths == (95,)
    assert choose_layout(toy(), 4000, "cpu", None).widths == (16,)
    assert choose_layout(toy(max_length=2), 4000, "gpu", None).widths == (4000,)  # all end together
    assert choose_layout(toy(max_length=1001), 8, "gpu", None).repack == 6  # of 501
    monkeypatch.setattr(Toy, "narrowest", 400)
    assert choose_layout(toy(), 1200, "gpu", None).widths == (1200, 400)
    assert choose_layout(toy(), 600, "gpu", None).widths == (600,)


def test_memory_limits_the_lanes_of_a_gpu(monkeypatch):
    monkeypatch.setattr(Toy, "lanes_on_gpu", 200)
    layout = choose_layout(toy(), 900, "gpu", None)
    assert (layout.queue, layout.widths) == (180, (180,))  # five queues, which several devices share
    assert choose_layout(toy(), 900, "gpu", 300).widths == (300,)  # as the user says
    assert choose_layout(toy(), 900, "cpu", None).widths == (16,)
    learners = (build(schema(), "float32").lanes_on_gpu for schema in (EMUQ, EMUQPublished, RFFQ))
    assert list(learners) == [800, 200, 4096]


def test_a_host_steps_all_runs_of_a_queue_together(monkeypatch):
    monkeypatch.setattr(Toy, "is_hosted", True)
    layout = choose_layout(toy(), 40, "cpu", None)
    assert layout.widths == (layout.queue,) == (10,) and layout.repack == 0
