"""What a search over settings is asked for, checked before anything runs. Imports JAX only to check it."""

import dataclasses
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pydantic_core import to_jsonable_python

from bojax.config.component import Component
from bojax.config.errors import ConfigError, allowed_names
from bojax.config.points import Sweep
from bojax.config.settings import Platform
from bojax.config.sweep import load_config, load_sweep
from bojax.config.sweep_file import Source
from bojax.engine.resolve import resolved
from bojax.optimisation.space import Axis
from bojax.report.ranking import signed
from bojax.tuning.ranges import Asked, axis_of

MOST_POINTS = 1000
"""Maximum number of points of a search: the time of the model grows with their cube."""


@dataclass(frozen=True)
class Task:
    """A search that was checked."""

    config: Sweep  # the experiment, a sweep of one point
    ranges: tuple[Axis, ...]  # the tuned settings
    column: str  # column of `runs.parquet` whose mean is the score
    is_least: bool  # whether less is better
    batch: int  # number of points of a round
    rounds: int  # maximum number of rounds
    confirm: int  # number of fresh runs of each of the best settings; 0 for none
    recompiled: tuple[str, ...]  # keys of the tuned settings that fix the shape of a program

    @cached_property
    def content(self) -> dict[str, Any]:
        """Everything that the proposals and the scores depend on; a search resumes with equal content."""
        return {
            "config": self.config.base,
            "settings": {each.key: to_jsonable_python(each) for each in self.ranges},
            "metric": self.column,
            "minimise": self.is_least,
            "batch": self.batch,
            "runs": self.config.runs,
            "seed": self.config.seed,
        }

    def sweep(self, points: Sequence[Sequence[Any]], name: str, **settings: Any) -> Sweep:
        """A sweep of the experiment over values of the tuned settings, in the order of the points."""
        config, keys = self.config, [each.key for each in self.ranges]
        content = {
            "title": config.title,
            "runs": config.runs,
            "seed": config.seed,
            "record": {"runs": 0},
            "engine": config.engine.model_dump(mode="json"),
            "base": config.base,
            "axes": dict(zip(keys, map(list, zip(*points, strict=True)), strict=True)),
            "combine": "zip",
            "report": {"rank_by": f"-{self.column}" if self.is_least else self.column},
        }
        sweep = load_sweep({**content, **settings})
        return resolved(dataclasses.replace(sweep, name=name, source=config.source))


def make_task(source: Source, asked: Sequence[Asked], overrides: Sequence[str], options: Namespace) -> Task:
    """Check a search with the options of `bojax tune`.

    Raises:
        ConfigError: A setting, a range or an option is wrong.
    """

    def at(*changes: str) -> Sweep:
        return resolved(load_config(source, [*overrides, *changes], options.runs, options.seed))

    config = at()
    # A part comes before its settings, which it would overwrite in a sweep.
    asked = sorted(asked, key=lambda each: each.key.count("."))
    # A setting may exist with some parts only: each value is checked beside the first ones of the others.
    firsts = {each.key: each.values[0] for each in asked}
    ends = []
    for each in asked:
        changes = ({**firsts, each.key: given}.items() for given in each.values)
        sweeps = [at(*(f"{key}={value}" for key, value in items)) for items in changes]
        ends.append([sweep.points[0].config for sweep in sweeps])
    written = config.points[0].config
    ranges = tuple(axis_of(each, configs, written) for each, configs in zip(asked, ends, strict=True))
    rounds = _rounds(options.budget, options.batch, config.runs)
    # With a launcher, this process leaves the accelerators to workers.
    device = config.engine.device if options.launcher == "inline" else "cpu"
    column = _metric(options.metric, config, device)
    return Task(
        config=config,
        ranges=ranges,
        column=column,
        is_least=options.minimise or signed(column)[1],
        batch=options.batch,
        rounds=rounds,
        confirm=options.confirm,
        recompiled=_recompiled(ranges, ends, device),
    )


def _rounds(budget: int | None, batch: int, runs: int) -> int:
    """The number of whole rounds in a budget."""
    budget = 10 * batch * runs if budget is None else budget
    if budget < batch * runs:
        raise ConfigError(
            f"bojax tune: --budget: got {budget}; allowed: >= {batch * runs}, the runs of one round "
            f"(--batch {batch} x --runs {runs})"
        )
    rounds = budget // (batch * runs)
    if rounds * batch > MOST_POINTS:
        raise ConfigError(
            f"bojax tune: --budget: got {budget}, which is {rounds * batch} points; allowed: "
            f"<= {MOST_POINTS} points; more --runs make each of them more precise"
        )
    return rounds


def _metric(asked: str | None, config: Sweep, device: Platform) -> str:
    """The column whose mean is the score: by default the return of a run, or of its last episode."""
    columns = _module(config.points[0].config, device).tables["runs"]
    known = [each.name for each in columns if each.dtype != "string"]
    column = asked if asked is not None else "last_return" if "last_return" in known else "return"
    if column not in known:
        raise ConfigError(f"bojax tune: --metric: got {column}; unknown column{allowed_names(column, known)}")
    return column


def _recompiled(
    ranges: Sequence[Axis], ends: Sequence[Sequence[Component]], device: Platform
) -> tuple[str, ...]:
    """The keys whose choices, or values at both bounds, are different programs."""
    from bojax.engine.groups import static_groups

    return tuple(
        each.key
        for each, configs in zip(ranges, ends, strict=True)
        if len(static_groups([_module(experiment, device) for experiment in configs])) > 1
    )


def _module(experiment: Component, device: Platform) -> Any:
    from bojax.engine.build import build
    from bojax.engine.devices import prepare

    prepare(device)
    return build(experiment, getattr(experiment, "dtype", "float64"))
