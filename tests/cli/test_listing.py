"""`bojax list` shows every part, config and sweep, without JAX."""

import pytest

from bojax.cli.listing import _part
from bojax.cli.main import main
from bojax.config import catalog, thesis
from bojax.config.files import available


@pytest.fixture
def listed(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "110")  # lines are wrapped to the terminal; pytest-xdist says 80

    def run(*names: str) -> str:
        assert main(["list", *names]) == 0
        return capsys.readouterr().out

    return run


def test_every_name_is_listed_with_a_line(listed):
    out = listed()
    names = [kind for role in catalog.roles() for kind in catalog.kinds(role)]
    names += [*available("configs"), *available("sweeps"), *thesis.groups()]
    described = {words[0] for line in out.splitlines() if len(words := line.split()) > 1}
    assert set(names) <= described


def test_every_part_shows_its_settings(listed):
    assert _part("planner", catalog.kinds("planner")["kcbts"]) + "\n" == listed("kcbts")
    for role in catalog.roles():
        for kind, schema in catalog.kinds(role).items():
            out = _part(role, schema)
            for name in schema.model_fields:
                assert name == "kind" or f"\n  {name} " in out, (kind, name)


def test_a_part_a_config_and_a_sweep_of_one_name(listed):
    out = listed("parking")
    assert "half_width number > 0 4 half the side of the square domain, m" in " ".join(out.split())
    assert "bojax run parking" in out and "bojax sweep parking" in out
    assert "alias of fig-4.6" in out


def test_names_of_reproduce_are_listed_with_their_sweeps(listed):
    group = listed("reproductions")
    assert group.startswith("reproductions\n") and "\n  fig-5.3    fig-5.3-cliff, fig-5.3-taxi\n" in group
    out = " ".join(listed("table-5.3").split())
    assert "table-5.3-reacher, table-5.3-single-pendulum" in out and out.endswith("bojax reproduce table-5.3")
    for name, sweeps in thesis.groups().items():
        assert len(sweeps) >= 1 and thesis.sweeps_of(name) == sweeps


def test_a_broken_file_does_not_hide_the_others(listed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "mine.yaml").write_text("a: [")
    out = listed("configs")
    (tmp_path / "sweeps").mkdir()
    (tmp_path / "sweeps" / "fig-4.6.yaml").write_text("a: [")
    assert "fig-4.6" in thesis.sweeps_of("chapter4"), "starting it reports the error"
    assert "(invalid: configs/mine.yaml" in out and "Robot parking" in out
