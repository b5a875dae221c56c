"""`bojax reproduce`: the sweeps of a figure, a chapter or the thesis as one plan, and one page over all."""

import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from bojax.cli.launching import LAUNCHING_USAGE, add_launching, add_running, check_launching, dry_run
from bojax.cli.league import ID
from bojax.cli.parser import Parser, UsageError, at_least, path
from bojax.cli.running import run
from bojax.config.errors import ConfigError
from bojax.config.sweep import load_sweep
from bojax.config.thesis import ALL, sweeps_of
from bojax.engine.resolve import resolved
from bojax.results.folder import ROOT, dated_folder, is_unfinished, require_empty

NAME = "reproduction"
"""Name of the folder in `results` that has the reproductions without `--out`."""

_DESCRIPTION = """\
Run the sweeps of the thesis as one plan, and write the report of each sweep, one page with all claims, and a
page for each chapter. The number of the thesis, the number found here and the verdict stand side by side.

ID is a sweep (fig-4.6), a figure or table (fig-5.4, table-3.1) for the sweeps that test its claims, chapter3,
chapter4, chapter5, or all: every sweep with claims of the thesis. pomdp is a group of its own: published
returns of POMDP solvers. Studies are run by name. surveys is no sweep: it is the league of routes of surveys,
whose runs are starts, at most 20; it is run in one process, one start after the other.

--page runs nothing: it makes the page from results of several commands, of whatever age and machine. DIR is a
results folder, or a folder above some. The newest results of each sweep count, and are judged by the claims
and tests of this version. Results of studies are quoted by the explanations.
"""

_EXAMPLES = """\
  bojax reproduce fig-4.6 table-5.1                     a figure and a table
  bojax reproduce chapter5 --runs 20                    a quick look at a chapter
  bojax reproduce all --out results/thesis              the whole thesis
  bojax reproduce all --out results/thesis --resume     go on after an interruption
  bojax reproduce --multiverse 4.4                      do the claims of a group depend on open choices?
  bojax reproduce surveys --runs 8                      the league of surveys, from eight starts
  bojax reproduce --page results/thesis results/fig-4.6 --out page.md
                                                        one page from results of several commands
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    parser = _parser(name)
    args = parser.read(words)
    if args.page:
        for option, value in vars(args).items():
            if option not in ("page", "out", "count_in") and value not in (parser.get_default(option), []):
                given = "ID" if option == "ids" else f"--{option.replace('_', '-')}"
                parser.error(f"{given}: not allowed with --page, which runs nothing")
        return _join(args)
    if args.multiverse is not None:
        if args.ids or args.count_in:
            parser.error("--multiverse: not allowed with ID or --count-in: its file names the sweeps")
        from bojax.cli.multiverse import main as run_multiverse

        return run_multiverse(name, args, words)
    if args.configurations is not None:
        parser.error("--configurations: needs --multiverse")
    if ID in args.ids:
        for option, value in vars(args).items():
            if option not in ("ids", "runs", "out", "resume") and value != parser.get_default(option):
                parser.error(f"--{option.replace('_', '-')}: not allowed with {ID}")
        if len(args.ids) > 1:
            parser.error(f"{ID}: not allowed with other IDs: it is no sweep")
        from bojax.cli.league import main as run_league

        return run_league(name, args, words)
    if not args.ids:
        parser.error("the following arguments are required: ID")
    if args.count_in:
        parser.error("--count-in: needs --page")
    check_launching(args)
    sweeps = [load_sweep(sweep, (), args.runs, args.seed) for sweep in selected(args.ids)]
    names = [sweep.name for sweep in sweeps]
    out = args.out or (_newest(ROOT / NAME, names) if args.resume else dated_folder(NAME))
    if args.out and not args.resume:
        require_empty(out, "give another --out, or --resume a reproduction")
    folders = [out / name for name in names]
    if args.dry_run:
        return dry_run(args, names, folders)
    if not args.out:  # so that the printed command resumes this folder
        words = [*words, "--out", str(out)]
    start = time.monotonic()
    command = ["bojax", name, *words]
    code = run([resolved(sweep) for sweep in sweeps], folders, args.resume, command, launching=args)
    if code not in (0, 1) or not all((folder / "manifest.json").exists() for folder in folders):
        return code

    from bojax.claims.reproduction import reproduction

    print(reproduction(out, folders, time.monotonic() - start))
    return code


def _join(args: Namespace) -> int:
    """Make the page from results that are there."""
    from bojax.claims.reproduction import PAGE, TEXT, joined_reproduction
    from bojax.report.verdicts import in_words

    out = args.out or dated_folder(NAME)
    pages = [out] if out.suffix in (".html", ".md") else [out / TEXT, out / PAGE]
    print(in_words(joined_reproduction(pages, args.page, selected([ALL]), args.count_in)), file=sys.stderr)
    print(pages[-1])
    return 0


def selected(ids: Sequence[str]) -> list[str]:
    """The names of the sweeps that are meant.

    Raises:
        UsageError: An id means no sweep.
    """
    found: dict[str, None] = {}
    for each in ids:
        if "=" in each:
            raise UsageError(
                f"bojax reproduce: got {each}; allowed: no settings, since those of the thesis are "
                "reproduced; bojax sweep changes settings"
            )
        try:
            found |= dict.fromkeys(sweeps_of(each))
        except ConfigError as error:
            raise UsageError(f"bojax reproduce: {error}") from error
    return list(found)


def _newest(folder: Path, names: Sequence[str]) -> Path:
    """The newest reproduction with an unfinished one of these sweeps, or else with any of them.

    A reproduction that ended before its page was written has finished sweeps only. Folders without any are
    those of other sweeps, or of a page that `--page` made.
    """
    found = sorted(folder.iterdir(), reverse=True) if folder.is_dir() else []
    begun = [each for each in found if any((each / name).is_dir() for name in names)]
    if not begun:
        raise UsageError(f"{folder}: no reproduction to resume; to start one, leave out --resume")
    return next((each for each in begun if any(is_unfinished(each / name) for name in names)), begun[0])


def _parser(name: str) -> Parser:
    parser = Parser(
        name,
        f"ID... [--runs N] [--seed S] [--out DIR] [--resume]{LAUNCHING_USAGE}\n"
        f"       bojax {name} --page DIR... [--out DIR | --out FILE] [--count-in FILE]\n"
        f"       bojax {name} --multiverse NAME [--configurations N] [--runs N] [--out DIR] [--resume]",
        _DESCRIPTION,
        _EXAMPLES,
    )
    parser.option("ids", "ID", "sweeps, figures, tables, chapters, or all", nargs="*")
    out = f"folder of the results, or with --page also an .html or .md file (default: {ROOT / NAME}/TIME)"
    add_running(parser, out, "go on with interrupted or failed sweeps")
    page = "run nothing, but make the page from these results"
    parser.option("--page", "DIR", page, path, nargs="+", action="extend", default=[])
    count = "with --page: also update the numbers of claims in a sentence of these files: Of N claims ..., N "
    count += (
        "are reproduced, N are not, and N are inconclusive; N of them rest on a bound that the thesis does "
    )
    count += "not print"
    parser.option("--count-in", "FILE", count, path, nargs="+", default=[])
    multiverse = (
        "test the claims under the choices that a paper leaves open: a file, or a name in sweeps/multiverse"
    )
    parser.option("--multiverse", "NAME", multiverse)
    most = "with --multiverse: run at most this many further configurations (default: all)"
    parser.option("--configurations", "N", most, at_least(0))
    add_launching(parser)
    return parser
