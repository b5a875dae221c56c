"""`bojax compare`: several results folders, and curves of other libraries, on one page."""

import shlex
from collections.abc import Sequence

from bojax.cli.parser import Parser, UsageError, column, integer, one_of, path

_DESCRIPTION = """\
Compare finished results on one page: curves with bands, final scores with intervals, probabilities of
improvement, and the settings that differ. Runs of the same seed are paired by their index.

A CSV file has one row per value and the columns label, run, x, value: x is the number of the episode, or the
number of steps so far with --x step and in planning.

Scores are taken at the largest step or episode that all methods have, or at --at STEP. A run that its
success ended keeps its last value; the page names runs that were cut off.
"""

_EXAMPLES = """\
  bojax compare results/a results/b                      two results folders
  bojax compare results/a --csv dqn.csv --x step         with curves of another library, by environment step
  bojax compare results/a results/b --metric=-rmse       another score; a minus sign: less is better
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = _parser(name).parse_intermixed_args(list(words))
    if not args.folders and not args.csv:
        raise UsageError(
            f"bojax {name}: got none; allowed: results folders or --csv files (see: bojax {name} --help)"
        )
    if args.last is not None and args.last < 1:
        raise UsageError(f"--last: got {args.last}; allowed: >= 1")
    if args.at is not None and args.at < 1:
        raise UsageError(f"--at: got {args.at}; allowed: >= 1")
    sources = [*args.folders, *args.csv]
    if duplicates := [source for source in sources if sources.count(source) > 1]:
        raise UsageError(f"bojax {name}: got {duplicates[0]} twice; allowed: distinct sources")

    from bojax.report.comparing.build import compare
    from bojax.results.folder import dated_folder, require_empty

    out = args.out or dated_folder(name)
    require_empty(out)
    page = compare(
        args.folders,
        args.csv,
        out,
        metric=args.metric,
        axis=args.x,
        phase=args.phase,
        last=args.last,
        at=args.at,
        reference=args.reference,
        command=shlex.join(["bojax", name, *words]),
    )
    print(page)
    return 0


def _parser(name: str) -> Parser:
    parser = Parser(
        prog=f"bojax {name}",
        usage=f"bojax {name} DIR... [--csv FILE ...] [--metric COLUMN] [--x AXIS] [--phase PHASE]\n"
        "                     [--last N] [--at STEP] [--reference NAME] [--out DIR]",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("folders", nargs="*", metavar="DIR", type=path, help="results folders")
    parser.add_argument(
        "--csv", nargs="+", action="extend", metavar="FILE", type=path, default=[], help="curves in CSV files"
    )
    parser.add_argument(
        "--metric",
        type=column,
        metavar="COLUMN",
        help="column of episodes.parquet or runs.parquet, with a minus sign if less is better (default: "
        "return; accumulated_reward in planning)",
    )
    parser.add_argument(
        "--x",
        metavar="AXIS",
        type=one_of(("episode", "step")),
        help="axis of curves: episode or step (default: episode; step in planning)",
    )
    parser.add_argument(
        "--phase",
        metavar="PHASE",
        type=one_of(("train", "test")),
        default="train",
        help="phase of the episodes whose curves are drawn: train or test (default: train)",
    )
    parser.add_argument(
        "--last",
        type=integer,
        metavar="N",
        help="number of the last values of a run whose mean is its score (default: a tenth; 1 in planning)",
    )
    parser.add_argument(
        "--at",
        type=integer,
        metavar="STEP",
        help="step, or episode where that is the axis, up to which values count (default: the largest that "
        "all methods have)",
    )
    parser.add_argument(
        "--reference", metavar="NAME", help="method that others are compared with (default: the first)"
    )
    parser.add_argument(
        "--out",
        type=path,
        metavar="DIR",
        help="folder of the page, new or empty (default: results/compare/TIME)",
    )
    return parser
