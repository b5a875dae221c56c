"""What XLA chose for a program stays with its plan: the first process decides, the others follow."""

import base64
import subprocess
from collections import Counter
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bojax.config.sweep import load_config
from bojax.engine import autotuning, batch
from bojax.engine.autotuning import Choices, compile_again, fingerprint
from bojax.engine.errors import EngineError
from bojax.engine.program import Program
from bojax.engine.storage import FolderStorage
from bojax.engine.xla_choices import XLA_FOLDER
from bojax.results.folder import RunFolder, is_unfinished
from bojax.results.store import ResultsError, read_checked_json, read_manifest
from tests.engine.drive import run_sweep, run_toy
from tests.engine.test_program_cache import caching_in

DEVICE = jax.devices("cpu")[0]


class Made:
    """Stands for a compiled program."""

    def __init__(self, body: str, name: str = "jit_advance_1"):
        self._text = f'HloModule {name}\n\nFileNames\n1 "{name}.py"\n\nENTRY %main {{\n  %{body}\n}}'

    def as_text(self) -> str:
        return self._text


@pytest.fixture(autouse=True)
def xla(tmp_path):
    """XLA's folder, with what it has chosen so far."""
    with caching_in(tmp_path / "cache"):
        yield tmp_path / "cache" / XLA_FOLDER


def choose(folder, **kernels: str):
    for name, content in kernels.items():
        path = folder / "card" / f"{name}.pb"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode())


def chosen(folder):
    return {path.stem: path.read_text() for path in folder.rglob("*.pb")}


def never(*_):
    pytest.fail("compiled again")


def test_the_hash_of_a_program_leaves_out_names_and_places():
    made = Made('x = dot(a), metadata={op_name="dot" source_line=3}, backend_config={"tile": 8}')
    same = Made('x = dot(a), metadata={op_name="dot" source_line=9}, backend_config={"tile": 8}', "jit_2")
    other = Made('x = dot(a), metadata={op_name="dot" source_line=3}, backend_config={"tile": 16}')
    assert fingerprint(made) == fingerprint(same) != fingerprint(other)


def test_the_first_process_keeps_its_choices_and_later_ones_read_them(tmp_path, xla):
    choose(xla, dot="tile 8")
    first = Choices(tmp_path / "plan")
    first.settle("0-8-advance", Made("tile 8"), never)
    choose(xla, sum="tile 32")
    first.settle("0-8-fill", Made("tile 32"), never)
    kept = [
        set(read_checked_json(tmp_path / "plan" / f"0-8-{name}.json")["choices"])
        for name in ("advance", "fill")
    ]
    assert kept == [{"card/dot.pb"}, {"card/sum.pb"}]  # each choice once
    for path in xla.rglob("*.pb"):  # another machine
        path.unlink()
    second = Choices(tmp_path / "plan")
    second.offer()
    assert chosen(xla) == {"dot": "tile 8", "sum": "tile 32"}
    made = Made("tile 8")
    assert second.settle("0-8-advance", made, never) is made


def test_choices_are_offered_as_they_are_published_and_overwrite_none(tmp_path, xla):
    choose(xla, dot="mine", sum="theirs")
    Choices(tmp_path / "plan").settle("0-8-advance", Made("a"), never)
    (xla / "card" / "sum.pb").unlink()
    choose(xla, dot="another")
    later = Choices(tmp_path / "plan")
    later.offer()
    assert chosen(xla) == {"dot": "another", "sum": "theirs"}
    (xla / "card" / "sum.pb").unlink()
    later.offer()  # nothing new
    assert chosen(xla) == {"dot": "another"}


@pytest.mark.parametrize("name", ["../stolen.pb", "/stolen.pb", "a/../../stolen.pb", ".hidden.pb"])
def test_no_name_leads_out_of_xla_s_folder(tmp_path, xla, monkeypatch, name):
    monkeypatch.setattr(autotuning, "measured", lambda _: {name: base64.b64encode(b"x").decode()})
    Choices(tmp_path / "plan").settle("0-8-advance", Made("a"), never)
    before = {path for path in tmp_path.rglob("*")}
    Choices(tmp_path / "plan").offer()
    assert {path for path in tmp_path.rglob("*")} - before <= {xla, xla / "a"}


def test_a_process_that_was_not_the_first_compiles_again_with_the_choices_of_the_first(
    tmp_path, xla, monkeypatch
):
    run, calls = subprocess.run, Counter()

    def counted(*given, **options):
        calls["run"] += 1
        return run(*given, **options)

    matrix = jax.ShapeDtypeStruct((3, 3), np.float32)
    program = Program.of_trees(lambda x: {"y": jnp.linalg.cholesky(x @ x.T)}, matrix).export(DEVICE)
    choose(xla, dot="tile 8")
    first = program.compile("factor", DEVICE)
    Choices(tmp_path / "plan").settle("0-8-advance", first, never)
    choose(xla, dot="tile 16")
    monkeypatch.setattr(autotuning.subprocess, "run", counted)
    again = Choices(tmp_path / "plan").settle(
        "0-8-advance", Made("tile 16"), partial(compile_again, program, DEVICE)
    )
    assert calls == {"run": 1} and isinstance(again, jax.stages.Compiled)
    np.testing.assert_array_equal(again(np.eye(3, dtype=np.float32) * 2)["y"], 2 * np.eye(3))
    (given,) = (tmp_path / "cache" / "choices").iterdir()
    assert chosen(given) == {"dot": "tile 8"}
    assert any(path.name.startswith("jit_compiled_again-") for path in (tmp_path / "cache").iterdir())


@pytest.mark.parametrize("again", [None, Made("something else")])
def test_a_program_that_cannot_be_made_again_is_an_error(tmp_path, again):
    Choices(tmp_path / "plan").settle("0-8-advance", Made("tile 8"), never)
    with pytest.raises(EngineError, match=r"^0-8-advance: XLA does not compile .* start the sweep anew"):
        Choices(tmp_path / "plan").settle("0-8-advance", Made("tile 16"), lambda _: again)


def test_without_a_cache_nothing_is_compiled_again():
    program = Program.of_trees(jnp.sin, jax.ShapeDtypeStruct((3,), np.float32))
    jax.config.update("jax_compilation_cache_dir", None)
    assert compile_again(program, DEVICE, {}) is None


def test_a_sweep_keeps_its_choices_and_its_manifest_names_what_was_compiled(tmp_path, monkeypatch):
    # A CPU has none: here it stands for an accelerator.
    made = []

    def choices_of(share):
        made.append(Choices(share.folder.choices))
        return made[-1]

    monkeypatch.setattr(FolderStorage, "choices", property(choices_of, lambda *_: None))
    sweep = load_config("chain", ["episodes=2"], 4, None)
    assert run_sweep(sweep, tmp_path / "first") == run_sweep(sweep, tmp_path / "second") == 0
    first, second = (read_manifest(tmp_path / name)["programs"] for name in ("first", "second"))
    assert first == second and set(first) == {"0-4-advance", "0-4-fill", "0-4-summary"}
    assert made and (tmp_path / "first" / "runs.parquet").exists()


def test_a_program_of_other_code_is_compiled_again_as_when_the_plan_began(tmp_path, monkeypatch):
    # Programs of a user's module are in no cache; what XLA makes of them and of their exports differs.
    plan = Choices(tmp_path / "plan")
    monkeypatch.setattr(FolderStorage, "choices", property(lambda _: plan, lambda *_: None))
    toys = {"runs": 2, "lanes_per_device": 2}
    assert run_toy(tmp_path / "first", {"max_length": 30}, **toys) == 0
    known = iter(["tile 16"])  # what this process remembers for the first program
    monkeypatch.setattr(autotuning, "fingerprint", lambda made: next(known, None) or fingerprint(made))
    assert run_toy(tmp_path / "second", {"max_length": 30}, **toys) == 0
    assert next(known, None) is None
    runs = [(tmp_path / name / "runs.parquet").read_bytes() for name in ("first", "second")]
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    "call",
    [
        lambda x: jax.pure_callback(lambda x: x, jax.ShapeDtypeStruct((3,), np.float32), x),
        lambda x: jax.ffi.ffi_call("of_the_user", jax.ShapeDtypeStruct((3,), np.float32))(x),
    ],
)
def test_a_program_that_cannot_be_exported_is_compiled_as_it_was_traced(call):
    program = Program.of_trees(call, jax.ShapeDtypeStruct((3,), np.float32))
    assert batch._exported(program, DEVICE) is program
    assert compile_again(program, DEVICE, {}) is None


def test_programs_that_move_numbers_have_no_choices(tmp_path):
    made = Made("copy")
    folder = RunFolder(tmp_path)
    for name in ("empty", "select", "recorded"):
        assert Choices(folder.choices).settle(f"0-8-{name}", made, never) is made
    assert not folder.choices.exists() and folder.programs() == {}


def test_a_damaged_file_is_an_error_that_names_it(tmp_path):
    folder = RunFolder(tmp_path)
    folder.work.mkdir()
    Choices(folder.choices).settle("0-8-advance", Made("tile 8"), never)
    assert set(folder.programs()) == {"0-8-advance"}
    (folder.choices / "0-8-advance.json").write_text("{}")
    with pytest.raises(ResultsError, match=r"0-8-advance\.json"):
        Choices(folder.choices).offer()


def test_a_program_that_is_compiled_after_the_end_of_its_sweep_brings_no_folder_back(tmp_path):
    folder, made = RunFolder(tmp_path), Made("tile 8")
    assert Choices(folder.choices).settle("0-2-advance", made, never) is made
    assert not is_unfinished(tmp_path)
