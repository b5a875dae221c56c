"""`bojax bench`: the benchmarks of the repository, which compare bojax with other packages."""

import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from bojax.cli.parser import Parser, UsageError
from bojax.config.errors import allowed_names
from bojax.config.files import shipped

_EXAMPLES = """\
  bojax bench          all benchmarks
  bojax bench kcbts    one benchmark
  bojax bench latency results/table-4.1-times    one benchmark with an argument
"""

_PREFIX = "bench_"


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    parser = Parser(
        name,
        f"[NAME ...] | {name} NAME ARGUMENT ...",
        "Run benchmarks: ./benchmarks/bench_NAME.py, or those of the repository of bojax.\n"
        "Their options are those of the scripts: python benchmarks/bench_NAME.py --help",
        _EXAMPLES,
    )
    parser.option("names", "NAME", "name of a benchmark (default: all)", nargs="*")
    args = parser.read(words)
    benchmarks = find_benchmarks()
    if not benchmarks:
        raise UsageError(
            "no benchmarks found; run this command in a clone of bojax, which has them in benchmarks/"
        )
    names, arguments = args.names, []
    if len(names) > 1 and names[1] not in benchmarks:
        names, arguments = names[:1], names[1:]
    for wanted in names:
        if wanted not in benchmarks:
            raise UsageError(f"unknown benchmark {wanted}{allowed_names(wanted, benchmarks)}")
    if not names:
        print("benchmarks: " + ", ".join(benchmarks), flush=True)
    return max([_load(benchmarks[wanted]).main(arguments) for wanted in names or benchmarks])


def find_benchmarks() -> dict[str, Path]:
    """The benchmarks by name: those in ./benchmarks, or else those of the repository of bojax."""
    for folder in (Path("benchmarks"), shipped("benchmarks")):
        files = sorted(folder.glob(f"{_PREFIX}*.py"))
        if files:
            return {path.stem.removeprefix(_PREFIX).replace("_", "-"): path for path in files}
    return {}


def _load(path: Path) -> ModuleType:
    folder = str(path.parent.resolve())
    if folder not in sys.path:  # the benchmarks import shared modules of this folder
        sys.path.insert(0, folder)
    return importlib.import_module(path.stem)
