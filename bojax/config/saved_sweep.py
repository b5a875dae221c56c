"""A sweep as plain values in its results folder, from which a worker on any machine makes its plan."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bojax.config.points import Point, Sweep
from bojax.config.settings import EngineConfig, Record
from bojax.config.sweep import validate_experiment


def saved(sweep: Sweep) -> dict[str, Any]:
    """Everything that the runs of a sweep depend on, and how they are executed, as plain values."""
    return {
        "name": sweep.name,
        "source": str(sweep.source),
        "runs": sweep.runs,
        "seed": sweep.seed,
        "record": sweep.record.model_dump(mode="json"),
        "engine": sweep.engine.model_dump(mode="json"),
        "config": sweep.base,
        "points": [
            {"label": each.label, "variant": each.variant, "swept": each.swept}
            | {"config": each.config.model_dump(mode="json")}
            for each in sweep.points
        ],
    }


def loaded(content: Mapping[str, Any]) -> Sweep:
    """The sweep that `saved` described, without its report and claims.

    Parts given by import path are not imported.

    Raises:
        pydantic.ValidationError: Another version of bojax wrote it.
    """
    points = tuple(
        Point(index, point["label"], point["variant"], point["swept"], validate_experiment(point["config"]))
        for index, point in enumerate(content["points"])
    )
    return Sweep(
        name=content["name"],
        title="",
        points=points,
        runs=content["runs"],
        seed=content["seed"],
        record=Record.model_validate(content["record"]),
        engine=EngineConfig.model_validate(content["engine"]),
        report={},
        claims=(),
        base=content["config"],
        source=Path(content["source"]),
    )
