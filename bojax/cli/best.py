"""`bojax best`: the best point of a sweep as a config, and its score on fresh runs."""

import dataclasses
from collections.abc import Sequence

from bojax.cli.parser import Parser, UsageError, at_least, column, path
from bojax.cli.running import run
from bojax.config.errors import dotted, printable
from bojax.config.sweep import load_config
from bojax.config.yaml_file import dump
from bojax.engine.resolve import resolved

_EXAMPLES = """\
  bojax best results/grid > best.yaml          the config of the point with the best mean return
  bojax best results/grid --by=-rmse           that with the least mean error; a minus sign: less is better
  bojax best results/grid --confirm 200        its score in 200 fresh runs
  bojax best results/grid | bojax run -        the same with as many runs as in the sweep
"""

_DESCRIPTION = """\
Print the config of the best point of a finished sweep. That point was chosen by the mean of its runs, which
is therefore optimistic. The printed config has another seed: --confirm runs it and prints the mean of the new
runs, which is unbiased.
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = _parser(name).read(words)
    if args.confirm is None and (args.out is not None or args.resume):
        raise UsageError(f"bojax {name}: --out and --resume: allowed only with --confirm")

    from bojax.report.ranking import best_of, config_of, measure_of, scored
    from bojax.report.source import load
    from bojax.results.folder import reserve_folder
    from bojax.results.store import MANIFEST

    results = load(args.folder)
    measure = measure_of(results, args.by)
    best = best_of(results, measure)
    config = config_of(results, best.point)
    chosen = load_config(config, runs=args.confirm)  # a config that this version refuses is not printed
    is_chosen = len(results.points) > 1
    among = f"the best of {len(results.points)} points" if is_chosen else "the only point"
    optimism = "; chosen by these same runs, so this mean is optimistic" if is_chosen else ""
    print(f"# {printable(best.point.name)}, {among} in {args.folder}")
    print(f"# {scored(measure, best)}{optimism}")
    print(dump(config), end="", flush=True)
    if args.confirm is None:
        return 0
    place = f"{args.folder / MANIFEST}: points.{best.point.index}.config"
    chosen = dataclasses.replace(
        chosen,
        name=f"{results.manifest.name}-best",
        locate=lambda _, location: f"{place}.{dotted(location)}",  # the module that it names is announced
    )
    folder, _ = reserve_folder(chosen.name, args.out, resume=args.resume)
    code = run([resolved(chosen)], [folder], args.resume, ["bojax", name, *words])
    if code == 0:
        print(scored(measure, best_of(load(folder), measure)))
    return code


def _parser(name: str) -> Parser:
    parser = Parser(name, "DIR [--by COLUMN] [--confirm N [--out DIR] [--resume]]", _DESCRIPTION, _EXAMPLES)
    parser.option("folder", "DIR", "results folder", path)
    by = "column of runs.parquet, with a minus sign if less is better (default: report.rank_by; without it "
    by += "-steps_to_goal if a learner reached a goal, otherwise return)"
    parser.option("--by", "COLUMN", by, column)
    parser.option("--confirm", "N", "run the best point with N fresh runs", at_least(1))
    parser.option("--out", "DIR", "folder of these runs (default: results/NAME-best/TIME)", path)
    parser.flag("--resume", "resume interrupted runs of --confirm")
    return parser
