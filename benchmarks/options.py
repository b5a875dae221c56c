"""The options that every benchmark has."""

import argparse
from pathlib import Path


def make_parser(file: str, doc: str | None, examples: str) -> argparse.ArgumentParser:
    """A parser of the common options; a benchmark adds its own.

    Args:
        file: `__file__` of the benchmark.
        doc: Its docstring, whose first line describes it.
        examples: Commands with what they do.
    """
    parser = argparse.ArgumentParser(
        prog=Path(file).name,
        description=(doc or "").split("\n")[0],
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto", help="where bojax runs")
    parser.add_argument("--cores", type=positive, default=1, help="cores on a CPU (1)")
    parser.add_argument("--repeats", type=positive, default=7, help="repeats: the median counts (7)")
    parser.add_argument("--seed", type=int, default=0, help="seed of all that is random (0)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep the results in a file")
    return parser


def positive(text: str) -> int:
    """A whole number of at least 1, from the command line."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value}: has to be at least 1")
    return value
