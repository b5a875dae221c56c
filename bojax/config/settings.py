"""The top-level keys that experiments share: title, runs, seed, record and engine."""

from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

from pydantic import Field

from bojax.config.component import Schema


class Record(Schema, frozen=True):
    """Recorded runs, whose arrays are saved in addition to the tables."""

    runs: int = Field(
        default=8,
        ge=0,
        description="number of runs of every point, from the first, whose arrays (in learning, also steps) "
        "are saved",
    )
    learners: bool = Field(default=False, description="whether the learners of these runs are saved too")


Platform: TypeAlias = Literal["auto", "cpu", "gpu"]
"""A kind of device; `auto` is a GPU if there is one and the CPU is not quicker."""


class EngineConfig(Schema, frozen=True):
    """How runs are executed. These settings change the results by rounding at most."""

    device: Platform = Field(
        default="auto", description="device to run on; auto for the GPUs, or the CPU if there are none"
    )
    lanes_per_device: int | None = Field(
        default=None,
        ge=1,
        description="number of runs advanced together on each device; null for a measured default",
    )
    segment_seconds: float = Field(default=2.0, gt=0, description="time between progress reports, s")
    checkpoint_seconds: float = Field(default=60.0, gt=0, description="time between checkpoints, s")


class Settings(Schema, frozen=True):
    """The reserved top-level keys of an experiment file."""

    title: str = Field(default="", description="title in lists and reports, one line")
    runs: int = Field(
        default=1,
        ge=1,
        description="number of runs of every point, each with its own random key; of a sweep, 200 by default",
    )
    seed: int = Field(
        default=0, ge=0, le=2**32 - 1, description="seed from which the keys of all runs are derived"
    )
    record: Record = Field(default=Record(), description="runs whose arrays are saved")
    engine: EngineConfig = Field(default=EngineConfig(), description="how runs are executed")


RESERVED = tuple(Settings.model_fields)
"""Top-level keys that are not settings of the experiment."""


def split(mapping: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The reserved keys of a file, and its experiment, whose `kind` is the value of `experiment`."""
    settings = {name: value for name, value in mapping.items() if name in RESERVED}
    experiment = {"kind": mapping.get("experiment", "planning")}
    experiment |= {name: value for name, value in mapping.items() if name not in (*RESERVED, "experiment")}
    return settings, experiment
