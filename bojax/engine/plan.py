"""The plan of a sweep: its points are built, grouped and divided into chunks before anything runs."""

import functools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from bojax.config.errors import ConfigError, allowed_names, note_once, shown
from bojax.config.files import display
from bojax.config.limits import CHUNKS
from bojax.config.points import Point, Sweep
from bojax.engine.build import build
from bojax.engine.chunks import Chunk, Layout, choose_layout, cut
from bojax.engine.devices import Device, on_cpu, suited
from bojax.engine.groups import StaticGroup, nodes_with, static_groups
from bojax.engine.memory import check_memory
from bojax.engine.provenance import code_hashes, device_description, versions
from bojax.experiments.base import Experiment
from bojax.numerics.pallas import for_another_machine


@dataclass(frozen=True, eq=False)
class Plan:
    """What a sweep computes, divided into chunks."""

    sweep: Sweep
    modules: Sequence[Experiment]  # the experiment of each point
    groups: Sequence[StaticGroup]
    layouts: Sequence[Layout]  # how the runs of each group are divided and advanced
    chunks: Sequence[Chunk]  # all chunks, group by group
    device: Mapping[str, Any]  # description of the devices
    # Everything that the numbers of the sweep depend on, as plain values. A sweep can only be resumed with
    # equal content
    content: Mapping[str, Any]

    def experiment(self, group: StaticGroup) -> Experiment:
        """The experiment of the first point of a group."""
        return self.modules[group.points[0]]

    def name(self, group: StaticGroup) -> str:
        """The variants of a group, for messages."""
        names = list(dict.fromkeys(self.sweep.points[point].variant for point in group.points))
        return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"


def make_plan(sweep: Sweep, devices: Sequence[Device]) -> Plan:
    """Build, group and divide the points of a sweep, for those devices of this process that are `suited`.

    Raises:
        ConfigError: A point cannot be built or needs too much memory, there are too many chunks, or the
            report or a claim names a column that its table will not have.
        ResultsError: A saved learner cannot be read.
    """
    modules, groups = _grouped(sweep)
    _check_columns(sweep, [modules[group.points[0]] for group in groups])
    _note_equal_points(sweep)
    return _make_plan(sweep, modules, groups, device_description(suited(devices)))


def plan_made_elsewhere(sweep: Sweep, content: Mapping[str, Any], device: Mapping[str, Any]) -> Plan:
    """The plan that a worker has made of a sweep, on a machine that may have none of its devices.

    Its content has the settings that were left to the worker's machine.
    """
    points = [
        replace(point, config=type(point.config).model_validate(made["config"]))
        for point, made in zip(sweep.points, content["points"], strict=True)
    ]
    of_worker = replace(sweep, points=tuple(points))
    with for_another_machine():
        return replace(_make_plan(of_worker, *_grouped(of_worker), device), sweep=sweep)


def _check_columns(sweep: Sweep, modules: Sequence[Experiment]) -> None:
    """Refuse columns of the report and of claims that the tables will not have as numbers or Booleans."""
    file = display(sweep.source)
    known: dict[str, dict[str, None]] = {"runs": {}, "episodes": {}, "steps": {}}
    for module in modules:
        for table, columns in module.tables.items():
            numbers = {column.name: None for column in columns if column.dtype != "string"}
            known.setdefault(table, {}).update(numbers)

    def require(name: str, table: str, where: str) -> None:
        if name not in known[table]:
            allowed = allowed_names(name, known[table])
            raise ConfigError(
                f"{file}: {where}: got {shown(name)}; unknown column of {table}.parquet{allowed}"
            )

    for key in ("rank_by", "column"):
        if name := (sweep.report.get(key) or "").removeprefix("-"):
            require(name, "runs", f"report.{key}")
    known["runs"]["nans"] = None  # which the merged table has
    for claim in sweep.claims:
        for index, name in enumerate(claim.test.columns):
            setting = f"also.{index - 1}" if index else "column"
            require(name, claim.test.table, f"claims.{claim.id}.test.{setting}")


def _note_equal_points(sweep: Sweep) -> None:
    """Say that points are the same experiment under two names, whose runs are equal."""
    known: dict[str, Point] = {}
    pairs = [(known.setdefault(point.config.model_dump_json(), point), point) for point in sweep.points]
    if pairs := [pair for pair in pairs if pair[0] is not pair[1]]:
        names = [", ".join(f"{key} {value}" for key, value in point.swept.items()) for point in pairs[0]]
        more = f" (and {len(pairs) - 1} more)" if len(pairs) > 1 else ""
        note_once(f"note: points with the same settings have equal runs: {'; '.join(names)}{more}")


def _grouped(sweep: Sweep) -> tuple[list[Experiment], list[StaticGroup]]:
    """The experiment of each point, and the groups of these experiments."""
    with on_cpu():  # the numbers of a point become NumPy arrays, which go to the device group by group
        modules = [_build(sweep, point) for point in sweep.points]
        return modules, static_groups(modules)


def _make_plan(
    sweep: Sweep, modules: Sequence[Experiment], groups: Sequence[StaticGroup], device: Mapping[str, Any]
) -> Plan:
    layouts = []
    for group in groups:
        first, num_runs = group.points[0], len(group.points) * sweep.runs
        check_memory(modules[first], sweep.points[first].config, functools.partial(sweep.locate, first))
        lanes = sweep.engine.lanes_per_device
        layouts.append(choose_layout(modules[first], num_runs, device["platform"], lanes))
    content = _content(sweep, modules, device, groups, layouts)
    return Plan(sweep, modules, groups, layouts, _cut(sweep, groups, layouts, content), device, content)


def _build(sweep: Sweep, point: Point) -> Experiment:
    """The module of a point; its errors name the file or the command line that gave the setting."""
    locate = functools.partial(sweep.locate, point.index)
    return build(point.config, getattr(point.config, "dtype", "float64"), locate)


def _cut(
    sweep: Sweep, groups: Sequence[StaticGroup], layouts: Sequence[Layout], content: Mapping[str, Any]
) -> list[Chunk]:
    configs = [point["config"] for point in content["points"]]
    context = {key: content[key] for key in ("seed", "record", "device", "versions", "code")}
    numbers = [
        math.ceil(len(group.points) * sweep.runs / layout.queue)
        for group, layout in zip(groups, layouts, strict=True)
    ]
    CHUNKS.check(sum(numbers), "engine.lanes_per_device")
    chunks: list[Chunk] = []
    for group, layout in zip(groups, layouts, strict=True):
        chunks += cut(group, range(sweep.runs), layout, configs, context, first_index=len(chunks))
    return chunks


def _content(
    sweep: Sweep,
    modules: Sequence[Experiment],
    device: Mapping[str, Any],
    groups: Sequence[StaticGroup],
    layouts: Sequence[Layout],
) -> dict[str, Any]:
    """Runs, seed, resolved configs, kind of device, groups and their layouts, versions and code.

    The length of segments, the settings of the report and the number of devices are left out, since they may
    change on resume.
    """
    used = versions()
    return plain(
        {
            "runs": sweep.runs,
            "seed": sweep.seed,
            "record": sweep.record.model_dump(),
            "config": sweep.base,
            "points": [
                {"label": point.label, "variant": point.variant, "swept": point.swept}
                | {"config": resolved(point.config.model_dump(mode="json"), module)}
                for point, module in zip(sweep.points, modules, strict=True)
            ],
            "device": {key: device[key] for key in ("platform", "kind")},
            "groups": [list(group.points) for group in groups],
            "layouts": [asdict(layout) for layout in layouts],
            "versions": {name: used[name] for name in ("jax", "jaxlib", "bojax") if name in used},
            "code": {name: value[:16] for name, value in code_hashes(modules).items()},
        }
    )


def resolved(config: dict[str, Any], module: Experiment) -> dict[str, Any]:
    """The config of a point, with the values that its modules chose for settings left to them.

    A module states them by `resolved_settings`, by dotted path.
    """
    for path, node in nodes_with(module, "resolved_settings").items():
        for name, value in node.resolved_settings.items():
            *folders, last = [key.name for key in path] + name.split(".")
            part = functools.reduce(lambda part, folder: part[folder], folders, config)
            part[last] = value
    return config


def plain(value: Any) -> Any:
    """A copy made of JSON's types only."""
    return json.loads(json.dumps(value, default=_plain))


def _plain(value: Any) -> Any:
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return dict(value)
    return str(value)
