"""Schema classes: strict types, slots, registration."""

from typing import Annotated, ClassVar, Literal

import pydantic
import pytest

from bojax.config import catalog
from bojax.config.component import Component, External, Registered, Schema, Slot, registry
from bojax.experiments.settings import Planning
from bojax.models.settings import Matern52
from bojax.motions.settings import ContinuousMotions, KernelTrajectories, Splines
from bojax.planning.settings import KCBTS, SBO
from tests.parts import REQUIRED


def test_dumping_and_reading_back_gives_the_same(data_files):
    for role in catalog.roles():
        for kind, schema in catalog.kinds(role).items():
            part = schema(**REQUIRED.get(kind, {}))
            assert Slot(role).validate(part.model_dump(mode="json")) == part


def test_only_integers_are_converted_and_to_floats_alone():
    assert SBO(exploration=3) == SBO(exploration=3.0)
    refused = [{"depth": value} for value in ("3", 3.0, 3.7, True, None, [3])]
    refused += [{"exploration": value} for value in ("3", True, None, float("nan"), float("inf"), [3.0])]
    for settings in refused:
        with pytest.raises(pydantic.ValidationError):
            SBO(**settings)


def test_a_slot_takes_a_name_a_mapping_or_a_component():
    slot = Slot("motions")
    for given in ("splines", {"kind": "splines"}, Splines()):
        assert slot.validate(given) == Splines()
    with pytest.raises(ValueError, match="allowed: a part of role motions, not of role kernel"):
        slot.validate(Matern52())


def test_omitted_settings_come_from_the_default_of_the_field():
    class Place(Schema, frozen=True):
        motions: Annotated[Component, Slot("motions")] = KernelTrajectories(length=2.0, num_segments=2)

    expected = KernelTrajectories(length=2.0, num_segments=5)
    assert Place.model_validate({"motions": {"num_segments": 5}}).motions == expected
    assert Place.model_validate({"motions": {"kind": "kernel", "num_segments": 5}}).motions == expected
    assert Place.model_validate({"motions": "kernel"}).motions == Place().motions
    assert Place.model_validate({"motions": "splines"}).motions == Splines()


def test_the_default_of_a_field_reaches_nested_parts():
    planning = Planning.model_validate({"planner": {"motions": {"length": 3}}})
    assert planning == Planning(planner=KCBTS(motions=KernelTrajectories(length=3.0)))


def test_an_import_path_is_not_imported_at_once():
    part = Slot("problem").validate({"kind": "mine.fields:Field", "width": 3})
    assert part == External(kind="mine.fields:Field", slot="problem", params={"width": 3})
    assert isinstance(part, External) and part.label == "Field"


def test_a_duplicate_kind_is_refused():
    class Once(Registered, frozen=True):
        role: ClassVar[str] = "test-role"
        kind: Literal["once"] = "once"

    try:
        assert registry["test-role"] == {"once": Once}
        with pytest.raises(TypeError, match="registered twice: Once, Twice"):

            class Twice(Registered, frozen=True):
                role: ClassVar[str] = "test-role"
                kind: Literal["once"] = "once"
    finally:
        del registry["test-role"]


def test_a_slot_may_name_the_class_from_which_its_parts_derive():
    slot = Slot("motions", only=ContinuousMotions)
    assert slot.validate("kernel") == slot.validate(KernelTrajectories()) == KernelTrajectories()
    for part in ("splines", Splines()):
        with pytest.raises(ValueError, match="unknown kind"):
            slot.validate(part)
    assert slot.validate("mine.motions:Arcs").kind == "mine.motions:Arcs"
