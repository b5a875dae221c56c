"""What groups took in earlier sweeps on this machine, or on a reference machine, which only forecasts use."""

import contextlib
import functools
import json
import math
import statistics
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bojax.engine import program_cache
from bojax.engine.chunks import Layout
from bojax.engine.forecast import COMPILATION

REFERENCE = Path(__file__).with_name("paces.json")
"""By platform and kind: sizes of experiments, and the seconds of a compilation and of a run of each. Made by
benchmarks/reference_paces.py."""

SIZES = ("episodes", "iterations", "max_steps")
"""Settings to whose product the seconds of a run are taken to be proportional."""

FIXED_LANES = {"cpu": 4, "gpu": 100}
"""The fixed cost of an advance, as the number of lanes that would cost as much.

On a CPU it is 0 to 3 for the planners that take most of the time of a sweep and 5 to 50 for tabular learners,
see benchmarks/results/2026-11-24-forecast-cpu.md; for a GPU see benchmarks/results/2026-11-23-lanes.md.
"""


def reference(config: Mapping[str, Any], platform: str, layout: Layout) -> tuple[float, float | None]:
    """The seconds of a compilation and of a run on a reference machine.

    They are those of the experiment of the same kind whose size is the nearest, in proportion to the sizes.
    For another kind, the compilation is the median one, and nothing is known of the runs.

    Args:
        config: Config of a point, as plain values.
        platform: Platform of the devices.
        layout: How the runs are advanced.
    """
    kind, size = kind_and_size(config)
    known = _references().get(platform, {})
    if kind not in known:
        return statistics.median([each[0][1] for each in known.values()] or [COMPILATION]), None
    near, compilation, run = min(known[kind], key=lambda each: abs(math.log(size / each[0])))
    return compilation, run * size / near * cost_of_run(platform, layout.lanes, layout.queue)


def cost_of_run(platform: str, lanes: int, runs: int) -> float:
    """A number to which the seconds of a run are proportional in chunks with any number of lanes and runs.

    The runs of a chunk take the time of half a run more than if all lanes were busy all the time: the last
    ones end one by one.
    """
    return (FIXED_LANES.get(platform, 0) + lanes) * (runs / lanes + 0.5) / runs


@functools.cache
def _references() -> dict[str, Any]:
    with contextlib.suppress(OSError, ValueError):
        return json.loads(REFERENCE.read_text())
    return {}


def kind_and_size(config: Mapping[str, Any]) -> tuple[str, int]:
    """The kinds of an experiment and of its parts, and its size."""
    settings = list(_settings(config))
    kinds = [str(value) for name, value in settings if name == "kind"]
    sizes = [value for name, value in settings if name in SIZES and isinstance(value, int)]
    return " ".join(kinds), math.prod(max(1, size) for size in sizes)


def _settings(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """All settings of a config and of its parts, by name."""
    if isinstance(value, Mapping):
        for key in sorted(value):
            yield from _settings(value[key], key)
    elif not isinstance(value, list):
        yield name, value


def place_of(tag: str, platform: str, lanes: int) -> Path | None:
    """Where the seconds of a run are kept, beside the compiled programs; None if they are not kept.

    Unlike a program, they stay when the code changes.

    Args:
        tag: Name of the content of the group, see `program_cache.tag_of`.
        platform: Platform of the devices.
        lanes: Number of lanes with which a chunk starts.
    """
    folder = program_cache.folder_of("paces")
    return folder / f"{tag}-{platform}-{lanes}" if folder is not None and tag else None


def recall(place: Path | None) -> float | None:
    """The seconds of a run; None if they are not known."""
    with contextlib.suppress(OSError, ValueError):
        return float(place.read_text()) if place is not None and place.is_file() else None


def remember(place: Path | None, seconds: float) -> None:
    """Keep the seconds of a run, if that is possible."""
    if place is not None:
        with contextlib.suppress(OSError):
            place.parent.mkdir(parents=True, exist_ok=True)
            place.unlink(missing_ok=True)  # a pipe would block
            place.write_text(f"{seconds:.6g}\n")
            program_cache.drop_unused(place.parent)
