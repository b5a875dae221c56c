"""`bojax tune`: Bayesian optimisation of the numeric settings of an experiment, in rounds of sweeps."""

import argparse
import dataclasses
import os
import re
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bojax.cli.launching import LAUNCHING_USAGE, add_launching, check_launching, dry_run
from bojax.cli.parser import Parser, UsageError, column, integer, path
from bojax.cli.running import read_standard_input, resolved
from bojax.config.component import Component
from bojax.config.errors import allowed_names
from bojax.config.files import STANDARD_INPUT
from bojax.config.overrides import parse_overrides
from bojax.config.settings import Platform
from bojax.config.sweep import Source, Sweep, load_config, load_sweep
from bojax.config.tuning import EXAMPLE, Range, range_of, split_ranges
from bojax.results.folder import dated_folder

_EXAMPLES = """\
  bojax tune parking planner.exploration=0.1:100:log    one setting, searched by its logarithm
  bojax tune mountain-car learner.discount=0.8:1 learner.prior_precision=0.01:10:log \\
             --metric steps_to_goal --minimise --budget 800
  bojax tune my.yaml planner.exploration=1:50 planner.iterations=100 --runs 16
"""

_DESCRIPTION = """\
Search for the values of numeric settings with the best mean score, by Bayesian optimisation. A round is a
sweep of --batch points, which run together. key=low:high is a setting to tune, key=low:high:log one whose
range spans decades; key=value sets any other setting. The settings with the best mean in the model of the
scores are run again with another seed.
"""

_ALMOST = re.compile(r"=[-+.\d]+[^,:]*:")
"""An override that was probably meant as a range, such as 1:ten."""

MOST_POINTS = 1000
"""Largest number of points of a search: the model takes time of their cube."""


@dataclass(frozen=True)
class Task:
    """A search that was checked.

    Attributes:
        config: The experiment, a sweep of one point.
        ranges: The tuned settings.
        column: Column of `runs.parquet` whose mean is the score.
        is_least: Whether less is better.
        batch: Number of points of a round.
        rounds: Largest number of rounds.
        confirm: Number of fresh runs of each of the best settings; 0 for none.
        recompiled: Keys of tuned settings each value of which is another program.
    """

    config: Sweep
    ranges: tuple[Range, ...]
    column: str
    is_least: bool
    batch: int
    rounds: int
    confirm: int
    recompiled: tuple[str, ...]

    @cached_property
    def content(self) -> dict[str, Any]:
        """Everything that the proposals and the scores depend on; a search resumes with equal content."""
        return {
            "config": self.config.base,
            "settings": {each.key: dataclasses.asdict(each) for each in self.ranges},
            "metric": self.column,
            "minimise": self.is_least,
            "batch": self.batch,
            "runs": self.config.runs,
            "seed": self.config.seed,
        }

    def sweep(self, points: Sequence[Sequence[int | float]], name: str, **settings: Any) -> Sweep:
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


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    parser = _parser(name)
    args = parser.parse_intermixed_args(list(words))
    check_launching(args)
    from bojax.engine.signals import kept

    with kept():
        task = checked(args)
    if args.dry_run:
        from bojax.report.tuning import round_folder, round_name

        out = args.out or dated_folder(f"{task.config.name}-tune")
        return dry_run(args, [round_name(0)], [round_folder(out, 0)])
    return search(task, args, ["bojax", name, *words])


def search(task: Task, args: argparse.Namespace, command: list[str]) -> int:
    """Run or resume a search, and return the exit code."""
    from bojax.cli.launching import launcher_of
    from bojax.engine.signals import kept

    with kept():
        from bojax.cli.rounds import run_rounds

    launcher, devices = launcher_of(args, waits=True)
    with launcher or nullcontext():
        return run_rounds(task, args.out, args.resume, command, launcher, devices)


def _parser(name: str) -> Parser:
    parser = Parser(
        prog=f"bojax {name}",
        usage=f"bojax {name} CONFIG key=low:high ... [key=value ...] [--metric COLUMN] [--minimise]\n"
        "                  [--budget RUNS] [--batch POINTS] [--runs N] [--seed S] [--confirm N] [--out DIR] "
        f"[--resume]{LAUNCHING_USAGE}",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument(
        "words", nargs="*", metavar="CONFIG", help="a file or a name in configs/; with ranges and settings"
    )
    parser.add_argument(
        "--metric",
        type=column,
        metavar="COLUMN",
        help="column of runs.parquet (default: return; of learners, last_return)",
    )
    parser.add_argument("--minimise", action="store_true", help="less is better")
    parser.add_argument(
        "--budget", type=integer, metavar="RUNS", help="runs of the search in all (default: 10 rounds)"
    )
    parser.add_argument(
        "--batch", type=integer, metavar="POINTS", default=8, help="points of a round (default: 8)"
    )
    parser.add_argument(
        "--runs", type=integer, metavar="N", help="runs of each point (default: as in the file)"
    )
    parser.add_argument(
        "--seed",
        type=integer,
        metavar="S",
        help="seed of the search and of its runs (default: as in the file)",
    )
    parser.add_argument(
        "--confirm",
        type=integer,
        metavar="N",
        default=100,
        help="fresh runs of each of the best 3 settings (default: 100; 0 for none)",
    )
    parser.add_argument(
        "--out", type=path, metavar="DIR", help="folder of the search (default: results/NAME-tune/TIME)"
    )
    parser.add_argument(
        "--resume", action="store_true", help="resume an interrupted search, or extend one by a larger budget"
    )
    add_launching(parser)
    return parser


def checked(args: argparse.Namespace) -> Task:
    """The search that the arguments ask for.

    Raises:
        ConfigError: A setting, a range or the metric is wrong.
        UsageError: An option is wrong.
    """
    asked, words = split_ranges(args.words)
    overrides = [word for word in words if "=" in word and not os.path.isfile(word)]
    sources = [word for word in words if word not in overrides]
    parse_overrides(overrides)
    if len(sources) != 1:
        got = ", ".join(sources) or "none"
        raise UsageError(f"bojax tune: got {got}; allowed: one config (bojax list shows the names)")
    if not asked:
        got = next((word for word in overrides if _ALMOST.search(word)), "no range")
        allowed = f"key=low:high with two numbers, such as {EXAMPLE}"
        for word in overrides:
            if "," in word and not set(word) & set("[{"):
                got = word
                allowed += "; compare several values by a sweep (axes: {KEY: [...]})"
                break
        raise UsageError(f"bojax tune: got {got}; allowed: {allowed}")
    for option, value, least in (("--batch", args.batch, 1), ("--confirm", args.confirm, 0)):
        if value < least:
            raise UsageError(f"bojax tune: {option}: got {value}; allowed: >= {least}")
    source: Source = read_standard_input() if sources[0] == STANDARD_INPUT else sources[0]

    def at(*changes: str) -> Sweep:
        return resolved(load_config(source, [*overrides, *changes], args.runs, args.seed))

    config = at()
    ends = [[at(f"{each.key}={bound}").points[0].config for bound in (each.low, each.high)] for each in asked]
    ranges = tuple(range_of(each, *configs) for each, configs in zip(asked, ends, strict=True))
    rounds = _rounds(args.budget, args.batch, config.runs)
    # With a launcher, this process leaves the accelerators to the workers.
    device = config.engine.device if args.launcher == "inline" else "cpu"
    metric = _metric(args.metric, config, device)
    return Task(
        config=config,
        ranges=ranges,
        column=metric,
        is_least=args.minimise,
        batch=args.batch,
        rounds=rounds,
        confirm=args.confirm,
        recompiled=_recompiled(ranges, ends, device),
    )


def _rounds(budget: int | None, batch: int, runs: int) -> int:
    """The number of whole rounds in a budget."""
    if budget is None:
        budget = 10 * batch * runs
    if budget < batch * runs:
        raise UsageError(
            f"bojax tune: --budget: got {budget}; allowed: >= {batch * runs}, the runs of one round "
            f"(--batch {batch} x --runs {runs})"
        )
    rounds = budget // (batch * runs)
    if rounds * batch > MOST_POINTS:
        raise UsageError(
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
        raise UsageError(f"bojax tune: --metric: got {column}; unknown column{allowed_names(column, known)}")
    return column


def _recompiled(
    ranges: Sequence[Range], ends: Sequence[Sequence[Component]], device: Platform
) -> tuple[str, ...]:
    """The keys whose values at both bounds are different programs."""
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
