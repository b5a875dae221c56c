"""A figure of a results folder as a picture of the documentation: an SVG with colours for dark mode.

python pictures/site.py results/parking/TIME accumulated-reward docs/figures/parking.svg
"""

import argparse
import sys
from pathlib import Path

from bojax.report import source, style
from bojax.report.figures import draw
from bojax.results.store import write_content


def main(argv: list[str]) -> int:
    """Draw the figure and write it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("results", type=Path, help="a results folder")
    parser.add_argument("figure", help="name of a figure that its report has")
    parser.add_argument("out", type=Path, help="the SVG to write")
    args = parser.parse_args(argv)
    results = source.load(args.results)
    with style.settings():
        svg = style.encode(draw(args.figure, results).figure)["svg"]
    write_content(args.out, style.adapted(svg))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
