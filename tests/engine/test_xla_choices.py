"""Choices of kernels that come with bojax are given to XLA, and not kept with a plan again."""

import base64
import json
import lzma
import os

import jax
import pytest

from bojax.config.sweep import load_config
from bojax.engine import xla_choices
from bojax.engine.autotuning import Choices
from bojax.engine.xla_choices import XLA_FOLDER, archive_of, offer_shipped, pack, read_all, shipped
from bojax.results.store import read_checked_json
from tests.engine.drive import run_sweep
from tests.engine.test_autotuning import Made, choose, chosen, never
from tests.engine.test_program_cache import caching_in

DEVICE = jax.devices()[0]


@pytest.fixture
def xla(tmp_path, monkeypatch):
    """XLA's folder, and no archives at first."""
    monkeypatch.setattr(xla_choices, "ARCHIVES", tmp_path / "archives")
    shipped.cache_clear()
    with caching_in(tmp_path / "cache"):
        yield tmp_path / "cache" / XLA_FOLDER
    shipped.cache_clear()


def ship(**kernels: str):
    path = archive_of(DEVICE)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(lzma.compress(json.dumps({f"card/{key}.pb": kernels[key] for key in kernels}).encode()))
    shipped.cache_clear()


def test_without_an_archive_nothing_is_written(xla):
    offer_shipped(DEVICE)
    assert not xla.exists()


def test_what_was_measured_here_gives_way_to_what_comes_with_bojax(xla):
    choose(xla, dot="tile 8", own="tile 2")
    ship(dot="tile 16", sum="tile 32")
    offer_shipped(DEVICE)
    assert chosen(xla) == {"dot": "tile 16", "sum": "tile 32", "own": "tile 2"}


def test_the_files_are_written_once(xla):
    ship(dot="tile 16")
    offer_shipped(DEVICE)
    choose(xla, dot="tile 8")
    xla_choices._offer.cache_clear()  # another process
    offer_shipped(DEVICE)
    assert chosen(xla) == {"dot": "tile 8"}
    ship(dot="tile 32")  # another version of bojax
    xla_choices._offer.cache_clear()
    offer_shipped(DEVICE)
    assert chosen(xla) == {"dot": "tile 32"}


def test_a_plan_keeps_only_what_does_not_come_with_bojax(xla, tmp_path):
    ship(dot="tile 16")
    offer_shipped(DEVICE)
    choose(xla, own="tile 2")
    Choices(tmp_path / "plan").settle("0-8-advance", Made("tile 8"), never)
    assert set(read_checked_json(tmp_path / "plan" / "0-8-advance.json")["choices"]) == {"card/own.pb"}


def test_each_file_is_read_once_until_another_takes_its_place(xla, monkeypatch):
    reads, read = [], xla_choices.Path.read_bytes
    monkeypatch.setattr(xla_choices.Path, "read_bytes", lambda path: (reads.append(path.name), read(path))[1])
    choose(xla, dot="tile 8", sum="tile 32")
    assert [len(read_all()), len(read_all({"card/sum.pb"})), len(read_all())] == [2, 1, 2]
    assert sorted(reads) == ["dot.pb", "sum.pb"]
    (xla / "new").write_bytes(b"tile 16")
    (xla / "new").replace(xla / "card" / "dot.pb")
    assert base64.b64decode(read_all()["card/dot.pb"]) == b"tile 16"
    (xla / "card" / "link.pb").symlink_to(xla / "none")
    assert len(read_all()) == 2


def test_a_folder_is_listed_again_only_after_a_change(xla, monkeypatch):
    lists, scan = [], xla_choices.os.scandir
    monkeypatch.setattr(xla_choices.os, "scandir", lambda path: (lists.append(str(path)), scan(path))[1])
    choose(xla, dot="tile 8")
    for _ in range(2):  # it may change again within the resolution of its time
        assert set(read_all()) == {"card/dot.pb"}
    assert lists == [str(xla), str(xla / "card")] * 2
    for folder in (xla, xla / "card"):
        os.utime(folder, times=(1e9, 1e9))
    lists.clear()
    for _ in range(2):
        assert set(read_all()) == {"card/dot.pb"} and not read_all({"card/dot.pb"})
    assert lists == [str(xla), str(xla / "card")]
    choose(xla, sum="tile 32")
    assert set(read_all()) == {"card/dot.pb", "card/sum.pb"} and len(lists) == 3


def test_an_archive_is_made_of_all_choices(xla, capsys):
    ship(dot="tile 16")
    choose(xla, own="tile 2")
    assert "2 choices" in (pack(DEVICE), capsys.readouterr())[1].out
    shipped.cache_clear()
    offer_shipped(DEVICE)
    assert chosen(xla) == {"dot": "tile 16", "own": "tile 2"}
    assert set(shipped(DEVICE)) == {"card/dot.pb", "card/own.pb"}


@pytest.mark.skipif(not archive_of(DEVICE).exists(), reason="no choices come with bojax for this device")
@pytest.mark.parametrize("name", ["parking", "mountain-car"])
def test_every_choice_of_a_shipped_sweep_comes_with_bojax(tmp_path, name):
    """The misses would be measured anew on every machine, and may differ."""
    with caching_in(tmp_path / "cache"):
        run_sweep(load_config(name, [], 200, None), tmp_path / "sweep")
        assert set(read_all()) <= set(shipped(DEVICE))
