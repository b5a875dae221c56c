"""The content of `manifest.json` and `timings.parquet`."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from bojax.config.changed import changed_from_published
from bojax.config.errors import ConfigError
from bojax.config.points import Sweep
from bojax.engine.chunks import Chunk, digest
from bojax.engine.devices import setting
from bojax.engine.plan import plain
from bojax.engine.provenance import git_revision, versions
from bojax.results.chunk_folder import ChunkState
from bojax.text import error_line

States = Sequence[tuple[Chunk, ChunkState]]
"""Every chunk of the sweep with its state."""


def outline_of(module: Any) -> dict[str, Any]:
    """The outline of the problem's world, which figures draw: `{"outline": ...}`, or `{}` without one.

    Raises:
        ConfigError: The problem's `outline` fails, or returns something else than an outline.
    """
    try:
        outline_of_problem = getattr(getattr(module, "problem", None), "outline", None)
        outline = outline_of_problem() if outline_of_problem else None
        return {} if outline is None else {"outline": outline.as_numbers()}
    except Exception as error:  # the user's code
        raise ConfigError(f"{type(module.problem).__name__}.outline: {error_line(error)}") from error


def describe_sweep(
    sweep: Sweep,
    plan: Mapping[str, Any],
    outlines: Sequence[Mapping[str, Any]],
    command: str,
    status: str,
) -> dict[str, Any]:
    """The sweep, the command that started it, and the software that ran it."""
    points = zip(plan["points"], outlines, strict=True)
    return {
        "name": sweep.name,
        "title": sweep.title,
        "status": status,
        "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "command": command,
        "runs": sweep.runs,
        "seed": sweep.seed,
        "config": plan["config"],
        "config_hash": digest({key: plan[key] for key in ("runs", "seed", "record", "points")}),
        "points": [{"index": index, **point, **outline} for index, (point, outline) in enumerate(points)],
        "report": plain(sweep.report),
        "claims": plain(sweep.claims),
        "changed": plain(changed_from_published(sweep)),
        "is_published": sweep.is_published,
        "engine": plain(sweep.engine),
        "versions": versions(),
        "git": git_revision(),
        "precision": {
            "x64": bool(setting("jax_enable_x64")),
            "dtypes": sorted({point["config"].get("dtype", "float64") for point in plan["points"]}),
            "matmul": setting("jax_default_matmul_precision") or "set by each operation",
        },
        "plan": plan,
    }


def describe_groups(groups: Sequence[Mapping[str, Any]], states: States) -> list[dict[str, Any]]:
    """Seconds and steps of the static groups: compilation and advances.

    Args:
        groups: What is known of each group besides its advances.
        states: Every chunk with its state.
    """
    run_seconds, active_steps = [0.0] * len(groups), [0] * len(groups)
    for chunk, state in states:
        for _, steps, seconds in state.segments:
            run_seconds[chunk.group] += seconds
            active_steps[chunk.group] += int(steps)
    return [
        {"group": index, **group, "run_seconds": run_seconds[index], "active_steps": active_steps[index]}
        for index, group in enumerate(groups)
    ]


def describe_chunk(chunk: Chunk, state: ChunkState, error: str | None) -> dict[str, Any]:
    """The status of a chunk, and its error if it failed."""
    return {
        "chunk": chunk.index,
        "group": chunk.group,
        "point": chunk.point,
        "runs": chunk.num_runs,
        "identity": chunk.identity,
        "status": "failed" if error else "done" if state.is_done else "unfinished",
        "error": error,
    }
