"""Top-level settings of a file that are not the experiment's: runs, seed, record, engine."""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from bojax.config.component import Schema


class Record(Schema, frozen=True):
    """Which runs leave more than their tables."""

    runs: int = Field(default=8, ge=0, description="arrays are kept of runs with an index below this")
    learners: bool = Field(default=False, description="whether what those runs learned is kept too")


class EngineConfig(Schema, frozen=True):
    """How runs are executed; none of it changes what they compute, up to rounding."""

    device: Literal["auto", "cpu", "gpu"] = Field(default="auto", description="what to run on")
    lanes_per_device: int | None = Field(
        default=None, ge=1, description="runs in one program on each device; null: a measured default"
    )
    segment_seconds: float = Field(default=2.0, gt=0, description="time between reports of progress, s")
    checkpoint_seconds: float = Field(default=60.0, gt=0, description="time between checkpoints, s")
    latency: bool = Field(default=True, description="whether a single run is timed apart at the end")


class Settings(Schema, frozen=True):
    """The reserved top-level keys of an experiment file."""

    title: str = Field(default="", description="one line for lists and reports")
    runs: int = Field(ge=1, description="runs of every point, each with a key of its own")
    seed: int = Field(default=0, ge=0, le=2**32 - 1, description="seed of all run keys")
    record: Record = Field(default=Record(), description="which runs leave arrays")
    engine: EngineConfig = Field(default=EngineConfig(), description="how runs are executed")


RESERVED = tuple(Settings.model_fields)
"""Top-level keys that belong to the file, not to the experiment."""


def split(mapping: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The settings of a file, and the experiment (`experiment: NAME` is its `kind`)."""
    settings = {name: value for name, value in mapping.items() if name in RESERVED}
    experiment = {"kind": mapping.get("experiment", "planning")}
    experiment |= {name: value for name, value in mapping.items() if name not in (*RESERVED, "experiment")}
    return settings, experiment
