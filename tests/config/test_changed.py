"""The settings in which a sweep differs from the published sweep of the same name."""

from bojax.config.changed import changed_from_published
from bojax.config.files import shipped
from bojax.config.sweep import load_sweep


def published(name: str) -> str:
    """The text of a shipped sweep."""
    return (shipped("sweeps") / f"{name}.yaml").read_text()


def test_the_published_sweep_is_unchanged(write):
    for name in ("fig-4.6", "parking", "fig-5.6b", "table-5.1"):
        assert changed_from_published(load_sweep(name)) == {}
        assert changed_from_published(load_sweep(str(shipped("sweeps") / f"{name}.yaml"))) == {}
    write("fig-4.6.yaml", published("fig-4.6"))
    assert changed_from_published(load_sweep("fig-4.6.yaml")) == {}, "a copy"


def test_overrides_are_changes():
    sweep = load_sweep("parking", ["problem.half_width=3", "planner.depth=2"], runs=20, seed=7)
    settings = {"problem.half_width": [4.0, 3.0], "planner.depth": [3, 2]}
    assert changed_from_published(sweep) == {"runs": [200, 20], "seed": [0, 7], **settings}


def test_a_setting_that_differs_between_points_lists_its_values():
    planners = [point.config.planner for point in load_sweep("fig-4.6").points]
    before = {planner.iterations for planner in planners if hasattr(planner, "iterations")}
    changed = changed_from_published(load_sweep("fig-4.6", ["planner.iterations=7"]))
    assert changed == {"planner.iterations": [before.pop() if len(before) == 1 else list(before), 7]}


def test_settings_without_effect_on_numbers_are_not_compared():
    settings = ["engine.device=cpu", "engine.segment_seconds=9", "record.runs=0", "title=mine"]
    assert changed_from_published(load_sweep("fig-4.6", settings)) == {}
    same = load_sweep("fig-4.6", ["planner.depth=3", "runs=200"])
    assert changed_from_published(same) == {}


def test_an_edited_copy_under_the_same_name(write):
    text = published("fig-4.6").replace("actions: 17", "actions: 9")
    write("fig-4.6.yaml", text.replace("within: 6, above: 0.5", "above: 0") + "\n")
    changed = changed_from_published(load_sweep("fig-4.6.yaml"))
    assert changed.pop("planner.motions.actions") == [17, 9]
    assert {path.split("/")[1] for path in changed} == {"kcbts-parks", "sbo-parks"}
    before, after = changed["claims.fig-4.6/sbo-parks"]
    assert [(each["within"], each["above"]) for each in (before, after)] == [(6, 0.5), (None, 0.0)]


def test_axes_with_other_values(write):
    original = load_sweep("fig-5.6b")
    (axis,) = (name for name in original.points[0].swept if name != "learner")
    values = list(dict.fromkeys(point.swept[axis] for point in original.points))
    (line,) = (line for line in published("fig-5.6b").splitlines() if line.strip().startswith(f"{axis}:"))
    write("fig-5.6b.yaml", published("fig-5.6b").replace(line, f"  {axis}: {values[:-1]}"))
    assert changed_from_published(load_sweep("fig-5.6b.yaml")) == {f"axes.{axis}": [values, values[:-1]]}


def test_the_same_values_in_another_combination(write, tmp_path, monkeypatch):
    axes = "base: {}, axes: {planner.depth: [1, 2], planner.iterations: [10, 20]}"
    write("published/pair.yaml", f"{{{axes}, combine: zip}}")
    write("pair.yaml", f"{{{axes}}}")
    monkeypatch.setattr("bojax.config.sweep.shipped", lambda folder: tmp_path / "published")
    mixed = [{"planner.depth": a, "planner.iterations": b} for a, b in ((1, 20), (2, 10))]
    assert changed_from_published(load_sweep("pair.yaml")) == {"points": [[], mixed]}


def test_a_sweep_of_another_name_is_not_compared(write):
    write("mine.yaml", published("fig-4.6"))
    assert changed_from_published(load_sweep("mine.yaml", ["planner.depth=2"], runs=3)) == {}


def test_an_alias_is_compared_with_the_published_sweep(write):
    write("mine.yaml", "alias: fig-4.6")
    assert changed_from_published(load_sweep("mine.yaml", runs=3)) == {"runs": [200, 3]}
