"""The options that all benchmarks share."""

import argparse
from pathlib import Path


def make_parser(file: str, doc: str | None, examples: str) -> argparse.ArgumentParser:
    """A parser of the common options; a benchmark adds its own.

    Args:
        file: `__file__` of the benchmark.
        doc: Docstring of the benchmark, whose first line is its description.
        examples: Example commands with explanations.
    """
    parser = argparse.ArgumentParser(
        prog=Path(file).name,
        description=(doc or "").split("\n")[0],
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto", help="where bojax runs")
    parser.add_argument("--cores", type=positive, default=1, help="number of cores on a CPU (1)")
    parser.add_argument(
        "--repeats", type=positive, default=7, help="repeats, of which the median is taken (7)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers (0)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to a file")
    return parser


def positive(text: str) -> int:
    """A positive integer from the command line."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"got {value}; allowed: >= 1")
    return value
