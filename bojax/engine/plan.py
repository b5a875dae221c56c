"""The plan of a sweep: everything that its numbers depend on. A resumed sweep must have the same plan."""

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bojax.engine.provenance import code_hashes, versions
from bojax.experiments.base import Experiment

if TYPE_CHECKING:
    from bojax.config.sweep import Sweep


def make_plan(
    sweep: "Sweep",
    modules: Sequence[Experiment],
    device: Mapping[str, Any],
    lanes_per_device: Sequence[int],
) -> dict[str, Any]:
    """Runs, seed, resolved configs, device, lanes, versions and code.

    The length of segments and the settings of the report are left out, since they may change on resume.
    """
    used = versions()
    return plain(
        {
            "runs": sweep.runs,
            "seed": sweep.seed,
            "record": sweep.record.model_dump(),
            "config": sweep.base,
            "points": [
                {
                    "label": point.label,
                    "variant": point.variant,
                    "swept": point.swept,
                    "config": point.config.model_dump(mode="json"),
                }
                for point in sweep.points
            ],
            "device": {key: device[key] for key in ("platform", "kind", "count")},
            "lanes_per_device": list(lanes_per_device),
            "versions": {name: used[name] for name in ("jax", "jaxlib", "bojax") if name in used},
            "code": {name: value[:16] for name, value in code_hashes(modules).items()},
        }
    )


def plain(value: Any) -> Any:
    """A copy made of JSON's types only."""
    return json.loads(json.dumps(value, default=_plain))


def _plain(value: Any) -> Any:
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return dict(value)
    return str(value)
