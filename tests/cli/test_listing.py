"""`bojax list` shows every part, config and sweep, without JAX."""

import pytest

from bojax.cli.listing import _example, _part
from bojax.cli.main import main
from bojax.config import catalog, thesis
from bojax.config.component import Component
from bojax.config.files import available
from bojax.config.sweep import load_config
from bojax.engine.build import build
from tests.tiers import by_tier


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
    assert max(map(len, listed("pomcpow").splitlines())) <= 110  # first_action has nine words
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


@pytest.mark.parametrize("role", by_tier(catalog.roles(), normal=["acquisition", "experiment"]))
def test_an_example_stands_with_every_group_and_part_and_is_a_valid_config(listed, role):
    # They need an id, a file or a number.
    without = {"brax", "gymnasium", "grid", "scattered", "until-target", "outline", "route"}
    lines = [line.strip() for line in listed(catalog.roles()[role].plural).splitlines()]
    assert lines[-1].startswith("bojax survey " if role == "area" else "bojax run "), role
    for kind in catalog.kinds(role):
        example = _example(role, kind)
        assert bool(example) == (kind not in without and role != "experiment"), (role, kind)
        if example:
            name, *overrides = example.removeprefix("bojax run ").split()
            config = load_config(name, overrides).points[0].config
            assert kind in parts(config), example
            build(config)  # its parts fit each other
            assert example in listed(kind)


def parts(config) -> set[str]:
    """The kinds of all parts of an experiment."""
    found = {config.kind}
    for name in type(config).model_fields:
        if isinstance(value := getattr(config, name), Component):
            found |= parts(value)
    return found


def test_extras_say_what_needs_which_package(listed, monkeypatch):
    monkeypatch.setattr("bojax.cli.listing.find_spec", lambda module: None if module == "wandb" else object())
    out = " ".join(listed("extras").split())
    assert "environments of Gymnasium: needs gymnasium, installed" in out
    assert "bojax export --to wandb: needs wandb, not installed" in out
    assert "pip install -e '.[wandb]'" in listed("wandb")


def test_names_of_reproduce_are_listed_with_their_sweeps(listed):
    group = listed("reproductions")
    assert group.startswith("reproductions\n") and "\n  fig-5.3    fig-5.3-cliff, fig-5.3-taxi\n" in group
    out = " ".join(listed("table-5.3").split())
    assert "table-5.3-reacher, table-5.3-single-pendulum" in out and out.endswith("bojax reproduce table-5.3")
    assert thesis.sweeps_of("fig-5.4") == ["fig-5.4-top", "table-5.1"]  # which has claims of its lower half
    assert thesis.sweeps_of("table-3.1") == ["fig-3.3"] and thesis.sweeps_of("parking") == ["fig-4.6"]
    for name, sweeps in thesis.groups().items():
        assert len(sweeps) >= 1 and thesis.sweeps_of(name) == sweeps


def test_a_broken_file_does_not_hide_the_others(listed, here):
    (here / "configs").mkdir()
    (here / "configs" / "mine.yaml").write_text("a: [")
    out = listed("configs")
    (here / "sweeps").mkdir()
    (here / "sweeps" / "fig-4.6.yaml").write_text("a: [")
    assert "fig-4.6" in thesis.sweeps_of("chapter4"), "starting it reports the error"
    assert "(invalid: configs/mine.yaml" in out and "Robot parking" in out
