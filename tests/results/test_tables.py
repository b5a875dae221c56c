"""Tables: types from the schema, and a merged order that does not depend on the order of writing."""

import errno
import os
import shutil
from functools import partial
from hashlib import sha256

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bojax.results.chunk_folder import ChunkFolder
from bojax.results.merge import merge, sorted_rows
from bojax.results.schema import Column
from bojax.results.store import (
    WORK,
    ResultsError,
    explained,
    fingerprint,
    read_checked_json,
    read_json,
    read_manifest,
    read_table,
    write_checked_json,
    write_table,
    write_tables,
)
from bojax.results.tables import KEYS, count_nans, sort_rows, to_arrow
from tests.refusals import assert_refused, one_line

STEPS = (*KEYS, Column("step", "int32"), Column("reward", "float32", "m", "what the task pays"))


def steps(*rows):
    names = ("point", "run", "step", "reward")
    values = list(zip(*rows, strict=True)) if rows else [[]] * 4
    return to_arrow(STEPS, {name: np.asarray(column) for name, column in zip(names, values, strict=True)})


@pytest.mark.parametrize(
    ("column", "given", "kept"),
    [
        (Column("x", "int32", nullable=True), [3, -1], [3, None]),
        (Column("x", "int64"), [3, -1], [3, -1]),
        (Column("x", "float64", nullable=True), [np.nan, -1.0], [None, -1.0]),
        (Column("x", "float64"), [np.nan, -1.0], [pytest.approx(np.nan, nan_ok=True), -1.0]),
        (Column("x", "string", words=("train", "test")), [1, 0], ["test", "train"]),
    ],
)
def test_missing_numbers_are_null_in_a_nullable_column_and_a_code_becomes_its_word(column, given, kept):
    assert to_arrow((column,), {"x": np.array(given)})["x"].to_pylist() == kept


def test_only_columns_of_numbers_can_be_nullable_and_only_texts_have_words():
    nullable, words = partial(Column, "x", "bool", nullable=True), partial(Column, "x", "int32", words=("a",))
    assert_refused([(nullable, "nullable"), (words, "words")])


def test_types_and_units_are_those_of_the_schema():
    schema = steps((0, 0, 1, 0.5)).schema
    assert [str(field.type) for field in schema] == ["int32", "int32", "int32", "float"]
    assert schema.field("reward").metadata == {b"unit": b"m", b"doc": b"what the task pays"}


def test_rows_are_sorted_by_point_run_step():
    rows = [(p, r, s, 0.0) for p in (1, 0) for s in (2, 1) for r in (1, 0)]
    found = sort_rows(steps(*rows)).select(["point", "run", "step"]).to_pydict()
    assert list(zip(*found.values(), strict=True)) == sorted(row[:3] for row in rows)


def test_nans_are_counted_by_run():
    table = steps((0, 1, 1, np.nan), (0, 1, 2, np.nan), (1, 0, 1, 2.0), (1, 1, 1, np.nan))
    assert count_nans(table) == {(0, 1): 2, (1, 1): 1}


CHUNKS = {f"chunk-{index:05d}-0123456789ab": (0, -1) for index in range(2)}


def attempt(folder, index=0, number=1):
    """The files of an attempt at a chunk."""
    chunk = list(CHUNKS)[index]
    files = ChunkFolder(folder / WORK / f"{chunk}-{number}", folder, chunk)
    files.path.mkdir(parents=True)
    return files


def new_folder(path):
    """The folder of a chunk, without an attempt."""
    files = ChunkFolder(path / "chunk", path)
    files.path.mkdir()
    return files


def done(files, *parts, table="steps"):
    for part in parts:
        files.write_piece({table: part})
    files.state.is_done = True
    files.commit()
    return files


POINTS = [
    {"label": "kcbts", "variant": "fast", "swept": {}},
    {"label": "sbo", "variant": "slow", "swept": {}},
]


def test_merge_depends_on_the_rows_alone(tmp_path):
    a, b, c = steps((0, 0, 1, 0.0)), steps((1, 0, 1, 0.1), (1, 0, 2, 0.2)), steps((0, 1, 1, 0.3))
    done(attempt(tmp_path / "x"), a, b, c)
    done(attempt(tmp_path / "y"), c, b)
    done(attempt(tmp_path / "y", 1), steps(), a)
    found = [merge(tmp_path / name, CHUNKS, ["steps"], POINTS, seed=0) for name in ("x", "y")]
    merged = [(tmp_path / name / "steps.parquet").read_bytes() for name in ("x", "y")]
    assert merged[0] == merged[1]
    assert (
        found[0].sha256["steps.parquet"] == found[1].sha256["steps.parquet"] == sha256(merged[0]).hexdigest()
    )
    assert not found[0].nans and not found[0].errors and list(found[1].files) == [0, 1]
    table = read_table(tmp_path / "x" / "steps.parquet")
    assert table["label"].to_pylist() == ["kcbts", "kcbts", "sbo", "sbo"]


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([1, 2], pa.int64()),
        ([1, 0.5], pa.float64()),
        ([True, None], pa.bool_()),
        (["a", 1], pa.string()),
        ([[1, 2], None], pa.string()),
    ],
)
def test_swept_values_keep_their_type(tmp_path, values, kind):
    runs = to_arrow(KEYS, {"point": np.array([1, 0]), "run": np.array([0, 0])})
    done(attempt(tmp_path), runs, table="runs")
    points = [{"label": "kcbts", "variant": "", "swept": {"a.b": value}} for value in values]
    merge(tmp_path, CHUNKS, ["runs"], points, seed=9)
    table = read_table(tmp_path / "runs.parquet")
    assert table.column_names == ["point", "label", "variant", "a.b", "run", "seed", "nans"]
    assert table["a.b"].type == kind and table["seed"].to_pylist() == [9, 9]


def test_runs_that_deserve_a_warning_are_counted(tmp_path):
    counted = {
        "ignored_samples": [0, 3, 1],
        "collapses": [2, 1, 1],
        "outside_actions": [0, 0, 0],
        "sampled_gradient": [0.0, 0.3, np.nan],
    }
    for name, columns, expected in (("without", {}, [0, 0, 0, 0]), ("with", counted, [2, 3, 0, 1])):
        runs = {"point": np.zeros(3, np.int32), "run": np.arange(3, dtype=np.int32), **columns}
        done(attempt(tmp_path / name), pa.table(runs), table="runs")
        merged = merge(tmp_path / name, CHUNKS, ["runs"], POINTS, seed=0)
        assert merged.notable == dict(zip(counted, expected, strict=True))


def test_tables_whose_names_share_a_suffix_stay_separate(tmp_path):
    chunk = new_folder(tmp_path)
    chunk.write_piece({"steps": steps((0, 0, 1, 0.0)), "more-steps": steps((0, 0, 2, 0.0))})
    chunk.commit()
    assert [read_table(path)["step"].to_pylist() for path in chunk.pieces("steps")] == [[1]]


def test_snapshots_are_moved_once(tmp_path):
    def moved():
        with np.load(tmp_path / "arrays" / "0-1-walk-end.npz") as arrays:
            return arrays["x"].tolist()

    chunk = attempt(tmp_path)
    chunk.write_snapshot(0, 1, "walk", {"x": np.arange(3)})
    done(chunk)
    for _ in range(2):  # a merge may be cut off, or repeated when failed chunks have been computed
        merge(tmp_path, CHUNKS, [], POINTS, seed=0)
        assert moved() == [0, 1, 2]
    shutil.rmtree(chunk.path)
    again = attempt(tmp_path, number=2)  # the chunk was deleted and computed again
    again.write_snapshot(0, 1, "walk", {"x": np.arange(4)})
    done(again)
    merge(tmp_path, CHUNKS, [], POINTS, seed=0)
    assert moved() == [0, 1, 2, 3]
    (tmp_path / "arrays" / "0-1-walk-end.npz").write_bytes(b"")
    with pytest.raises(ResultsError, match="0-1-walk-end.npz: changed"):
        merge(tmp_path, CHUNKS, [], POINTS, seed=0)


def add_folder(chunk, text):
    """Stage what Orbax would write."""
    folder = chunk.add_checkpoint()
    (folder / "state").mkdir(parents=True)
    (folder / "state" / "array").write_text(text)
    return chunk.stage()


def test_the_checkpoint_before_stays_until_the_next_one_is_committed(tmp_path):
    def read():
        files = ChunkFolder(tmp_path / "chunk", tmp_path)
        assert files.read()
        return files.state.advances, (files.checkpoint() / "state" / "array").read_text()

    chunk = new_folder(tmp_path)
    chunk.state.advances = 1
    chunk.commit(add_folder(chunk, "first"))
    chunk.write_piece({"steps": steps((0, 0, 1, 0.0))})
    chunk.state.advances = 2
    second = add_folder(chunk, "second")
    chunk.state.advances = 3  # the chunk goes on before the second one is committed
    chunk.write_piece({"steps": steps((0, 0, 2, 0.0))})
    assert read() == (1, "first")
    chunk.commit(second)
    assert read() == (2, "second")
    assert [path.name for path in tmp_path.glob("chunk/checkpoint-*")] == ["checkpoint-00000002"]
    chunk.commit()
    assert len(list(chunk.pieces("steps"))) == 2


@pytest.mark.parametrize("damage", ["deleted", "flipped"])
def test_a_damaged_piece_is_not_merged(tmp_path, damage):
    files = done(attempt(tmp_path), steps((0, 0, 1, 0.0)), steps((0, 0, 2, 0.0)))
    path = files.path / "piece-000001-steps.parquet"
    if damage == "deleted":
        path.unlink()
    else:
        flip(path, 10)
    with pytest.raises(ResultsError, match="piece-000001-steps.parquet: .* delete the folder"):
        merge(tmp_path, CHUNKS, ["steps"], POINTS, seed=0)
    assert not (tmp_path / "steps.parquet").exists()


def flip(path, position):
    content = bytearray(path.read_bytes())
    content[position] ^= 1
    path.write_bytes(bytes(content))


def test_a_flipped_bit_in_a_page_is_detected(tmp_path):
    path, table = tmp_path / "a.parquet", steps(*((0, 0, step, step / 7) for step in range(500)))
    write_table(path, table)
    whole = path.read_bytes()
    group = pq.read_metadata(path).row_group(0)
    columns = [group.column(index) for index in range(group.num_columns)]
    refused = 0
    for column in columns:
        start = column.dictionary_page_offset or column.data_page_offset
        for position in range(start, start + column.total_compressed_size, 23):
            flip(path, position)
            try:
                assert read_table(path).equals(table)  # a bit that does not matter
            except ResultsError as error:
                assert "\n" not in str(error)
                refused += 1
            path.write_bytes(whole)
    assert refused > 100


def test_a_changed_digit_in_a_checked_file_is_detected(tmp_path):
    path = tmp_path / "a.json"
    write_checked_json(path, {"x": 1.25, "y": [float("nan"), {"z": "text"}]})
    assert read_checked_json(path) == {"x": 1.25, "y": [None, {"z": "text"}]}
    text = path.read_text()
    for old, new in (("1.25", "1.35"), ("text", "next"), ('"z"', '"w"'), ("null", "0")):
        path.write_text(text.replace(old, new))
        with pytest.raises(ResultsError, match="checksum"):
            read_checked_json(path)
    path.write_text(text)
    path.rename(tmp_path / "b.json")  # whole, in the place of another file
    with pytest.raises(ResultsError, match="checksum"):
        read_checked_json(tmp_path / "b.json")


def test_fingerprint(tmp_path):
    (tmp_path / "a").write_text("one")
    first = fingerprint(tmp_path / "a")
    assert first is not None and first["size"] == 3
    (tmp_path / "a").write_text("ome")
    assert fingerprint(tmp_path / "a") != first
    assert fingerprint(tmp_path / "none") is None and fingerprint(tmp_path) is None


@pytest.mark.parametrize("text", ["[" * 10**5, f"[{'1' * 10**4}]", "[1", ""])
def test_json_that_cannot_be_read_is_one_line(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with one_line(ResultsError, "cannot be read"):
        read_json(tmp_path / "a.json")


def test_unreadable_files_are_one_line(tmp_path):
    (tmp_path / "manifest.json").write_text('{"name": ')
    os.mkfifo(tmp_path / "pipe")
    refused = [
        (read_manifest, "", "truncated"),
        (read_table, "manifest.json", "truncated"),
        (read_json, "pipe", "not a regular file"),
        (read_table, "pipe", "not a regular file"),
        (read_manifest, "nowhere", "not a results folder"),
        (read_table, "nowhere.parquet", "no such file"),
    ]
    assert_refused(((partial(read, tmp_path / name), told) for read, name, told in refused), ResultsError)


@pytest.mark.parametrize(
    ("number", "code"),
    [(errno.ENOSPC, 1), (errno.EIO, 1), (errno.EFBIG, 1), (errno.EACCES, 2), (errno.EROFS, 2)],
)
def test_the_exit_code_distinguishes_a_wrong_path_from_a_failure_of_the_machine(tmp_path, number, code):
    with pytest.raises(ResultsError) as raised, explained(tmp_path):
        raise OSError(number, os.strerror(number))
    assert raised.value.exit_code == code and "\n" not in str(raised.value)


def test_rows_are_merged_as_a_stream(tmp_path, monkeypatch):
    """Parts in any order, of groups of interleaved points, with a bound of a few rows."""
    draw = np.random.default_rng(0)
    keys = [(point, run) for point in range(6) for run in range(20)]
    groups = [[key for key in keys if key[0] % 2 == parity] for parity in (0, 1)]
    parts, whole = [], []
    for group in groups:
        for start in range(0, len(group), 7):
            rows = [(*key, step, draw.normal()) for key in group[start : start + 7] for step in (1, 2, 3)]
            draw.shuffle(rows)
            for half in (rows[::2], rows[1::2]):
                parts.append(tmp_path / f"piece-{len(parts)}.parquet")
                whole.append(steps(*((int(p), int(r), int(s), x) for p, r, s, x in half)))
                write_table(parts[-1], whole[-1])
    expected = sort_rows(pa.concat_tables(whole))
    monkeypatch.setattr("bojax.results.merge.HELD_ROWS", 50)
    found = list(sorted_rows(parts))
    assert len(found) > 3 and max(table.num_rows for table in found) < expected.num_rows / 2
    assert pa.concat_tables(found).equals(expected)


@pytest.mark.parametrize("sizes", [[3], [65536], [65535, 2], [100_000, 5, 40_000], [0, 70_000, 0]])
def test_tables_one_after_the_other_are_the_bytes_of_one(tmp_path, sizes):
    whole = pa.table({"x": np.arange(sum(sizes)), "y": [f"{i % 7}" for i in range(sum(sizes))]})
    starts = np.cumsum([0, *sizes])
    write_table(tmp_path / "one", whole)
    write_tables(tmp_path / "many", (whole.slice(a, n) for a, n in zip(starts, sizes, strict=False)))
    assert (tmp_path / "one").read_bytes() == (tmp_path / "many").read_bytes()
