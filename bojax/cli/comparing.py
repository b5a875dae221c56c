"""`bojax compare`: several results folders, and curves of other libraries, on one page."""

import shlex
from collections.abc import Sequence

from bojax.cli.parser import Parser, UsageError, at_least, column, one_of, path

_DESCRIPTION = """\
Compare finished results on one page: curves with bands, final scores with intervals, probabilities of
improvement, and the settings that differ. Runs of the same seed are paired by their index.

--csv reads curves as other libraries write them: monitor.csv, progress.csv and evaluations.npz of
Stable-Baselines3, CSV exports of Weights & Biases, folders with event files of TensorBoard, score matrices as
rliable takes them (.npz). Runs whose names end in a number, as ppo-seed-0, are runs of one method; NAME=PATH
gives all runs of a path one name. Any other CSV file has one row per value and the columns label, run, x,
value: x is the number of the episode, or the number of steps so far with --x step and in planning.

Scores are taken at the largest step or episode that all methods have, or at --at STEP. A run that its
success ended keeps its last value; the page names runs that were cut off.
"""

_EXAMPLES = """\
  bojax compare results/a results/b                      two results folders
  bojax compare results/a --csv dqn.csv --x step         with curves of another library, by environment step
  bojax compare results/a --csv logs/ppo_1 logs/ppo_2    with two runs of Stable-Baselines3
  bojax compare --csv runs --metric losses/value_loss    TensorBoard folders, by another tag
  bojax compare results/a results/b --metric=-rmse       another score; a minus sign: less is better
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = _parser(name).read(words)
    if not args.folders and not args.csv:
        allowed = f"results folders or --csv files (see: bojax {name} --help)"
        raise UsageError(f"bojax {name}: got none; allowed: {allowed}")
    sources = [*args.folders, *args.csv]
    if duplicates := [source for source in sources if sources.count(source) > 1]:
        raise UsageError(f"bojax {name}: got {duplicates[0]} twice; allowed: distinct sources")

    from bojax.report.comparing.build import compare
    from bojax.report.comparing.methods import Options
    from bojax.results.folder import dated_folder, require_empty
    from bojax.results.store import MANIFEST, WORK

    for folder in args.folders:
        if folder.is_dir() and not any((*folder.glob(f"**/{MANIFEST}"), *folder.glob(WORK))):
            allowed = "a results folder; curves of other libraries follow --csv"
            raise UsageError(f"{folder}: not a results folder (no {MANIFEST}); allowed: {allowed}")
    out = args.out or dated_folder(name)
    require_empty(out)
    options = Options(args.metric, args.x, args.phase, args.last, args.at, args.reference, args.column)
    print(compare(args.folders, args.csv, out, options, shlex.join(["bojax", name, *words])))
    return 0


def _parser(name: str) -> Parser:
    parser = Parser(
        name,
        "DIR... [--csv PATH ...] [--metric COLUMN] [--column NAME] [--x AXIS]\n"
        "                     [--phase PHASE] [--last N] [--at STEP] [--reference NAME] [--out DIR]",
        _DESCRIPTION,
        _EXAMPLES,
    )
    parser.option("folders", "DIR", "results folders", path, nargs="*")
    parser.option(
        "--csv",
        "PATH",
        "curves of other libraries, files or folders",
        path,
        nargs="+",
        action="extend",
        default=[],
    )
    metric = "column of episodes.parquet or runs.parquet, with a minus sign if less is better (default: "
    parser.option("--metric", "COLUMN", f"{metric}return; accumulated_reward in planning)", column)
    of_logs = "column or tag in logs of other libraries (default: the one that corresponds to the metric)"
    parser.option("--column", "NAME", of_logs, column)
    axis = "axis of curves: episode or step (default: episode; step in planning and with logs)"
    parser.option("--x", "AXIS", axis, one_of(("episode", "step")))
    phase = "phase of the episodes whose curves are drawn: train or test (default: train)"
    parser.option("--phase", "PHASE", phase, one_of(("train", "test")), default="train")
    last = "number of the last values of a run whose mean is its score (default: a tenth; 1 in planning)"
    parser.option("--last", "N", last, at_least(1))
    at = "step, or episode where that is the axis, up to which values count (default: the largest that all "
    parser.option("--at", "STEP", f"{at}methods have)", at_least(1))
    parser.option("--reference", "NAME", "method that others are compared with (default: the first)")
    parser.option("--out", "DIR", "folder of the page, new or empty (default: results/compare/TIME)", path)
    return parser
