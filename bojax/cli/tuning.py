"""`bojax tune`: Bayesian optimisation of settings of an experiment, in rounds of sweeps."""

import argparse
import re
from collections.abc import Sequence
from contextlib import nullcontext

from bojax.cli.launching import (
    LAUNCHING_USAGE,
    add_launching,
    add_running,
    check_launching,
    dry_run,
    launcher_of,
)
from bojax.cli.parser import Parser, UsageError, at_least, column, integer
from bojax.cli.running import read_source, split_words
from bojax.engine.signals import kept
from bojax.results.folder import dated_folder
from bojax.tuning.ranges import EXAMPLE, split_ranges
from bojax.tuning.task import Task, make_task

_EXAMPLES = """\
  bojax tune parking planner.exploration=0.1:100:log    one setting, searched on a logarithmic scale
  bojax tune mountain-car learner.discount=0.8:1 learner.prior_precision=0.01:10:log \\
             --metric steps_to_goal --budget 800
  bojax tune parking planner=kcbts,sbo planner.exploration=1:1000:log    choices are part of the search
  bojax tune my.yaml planner.exploration=1:50 planner.iterations=100 --runs 16
"""

_DESCRIPTION = """\
Search for the settings with the best mean score, by Bayesian optimisation. A round is a sweep of --batch
points, which run together. key=low:high is a number to tune, key=low:high:log one whose range spans decades,
key=a,b,c a choice, also between parts; key=value sets any other setting. The settings with the best mean in
the model of the scores are run again with another seed.
"""

_ALMOST = re.compile(r"=[-+.\d]+[^,:]*:")
"""An override that was probably meant as a range, such as 1:ten."""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = _parser(name).read(words)
    check_launching(args)
    with kept():
        task = checked(args)
    if args.dry_run:
        from bojax.tuning.page import round_folder, round_name

        out = args.out or dated_folder(f"{task.config.name}-tune")
        return dry_run(args, [round_name(0)], [round_folder(out, 0)])
    return search(task, args, ["bojax", name, *words])


def search(task: Task, args: argparse.Namespace, command: list[str]) -> int:
    """Run or resume a search, and return the exit code."""
    with kept():
        from bojax.tuning.rounds import run_rounds

    launcher, devices = launcher_of(args, waits=True)
    with launcher or nullcontext():
        return run_rounds(task, args.out, args.resume, command, launcher, devices)


def _parser(name: str) -> Parser:
    parser = Parser(
        name,
        "CONFIG key=low:high|key=a,b ... [key=value ...] [--metric COLUMN] [--minimise]\n"
        "                  [--budget RUNS] [--batch POINTS] [--runs N] [--seed S] [--confirm N] [--out DIR] "
        f"[--resume]{LAUNCHING_USAGE}",
        _DESCRIPTION,
        _EXAMPLES,
    )
    parser.option("words", "CONFIG", "a file or a name in configs/; with ranges and settings", nargs="*")
    metric = "column of runs.parquet (default: return; of learners, last_return)"
    parser.option("--metric", "COLUMN", metric, column)
    parser.flag("--minimise", "less is better, as it always is of a time to a goal or target")
    parser.option("--budget", "RUNS", "runs of the search in all (default: 10 rounds)", integer)
    parser.option("--batch", "POINTS", "points of a round (default: 8)", at_least(1), default=8)
    confirm = "fresh runs of each of the best 3 settings (default: 100; 0 for none)"
    parser.option("--confirm", "N", confirm, at_least(0), default=100)
    out = "folder of the search (default: results/NAME-tune/TIME)"
    add_running(parser, out, "resume an interrupted search, or extend one by a larger budget")
    add_launching(parser)
    return parser


def checked(args: argparse.Namespace) -> Task:
    """The search that the arguments ask for.

    Raises:
        ConfigError: A setting, a range or the metric is wrong.
        UsageError: An option is wrong.
    """
    asked, words = split_ranges(args.words)
    overrides, sources = split_words(words)
    if len(sources) != 1:
        got = ", ".join(sources) or "none"
        raise UsageError(f"bojax tune: got {got}; allowed: one config (bojax list shows the names)")
    if not asked:
        got = next((word for word in overrides if _ALMOST.search(word)), "no range")
        allowed = f"key=low:high with two numbers, such as {EXAMPLE}, or choices, such as planner=kcbts,sbo"
        raise UsageError(f"bojax tune: got {got}; allowed: {allowed}")
    return make_task(read_source(sources[0]), asked, overrides, args)
