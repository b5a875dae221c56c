"""`bojax report`: figures, tables and claims of results folders, rebuilt from their files."""

from collections.abc import Sequence
from pathlib import Path

from bojax.cli.parser import Parser

_EXAMPLES = """\
  bojax report results/parking/20250101-120000       rebuild the report of a sweep
  bojax report results/parking/*                     of several
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command."""
    parser = Parser(
        prog=f"bojax {name}",
        usage=f"bojax {name} DIR...",
        description="Draw the figures, decide the claims and write report.html of finished results folders.\n"
        "Everything it writes is derived: the tables stay as they are.",
        examples=_EXAMPLES,
    )
    parser.add_argument("folders", nargs="+", metavar="DIR", type=Path, help="results folders")
    args = parser.parse_intermixed_args(list(words))

    from bojax.report.progress import report

    for folder in args.folders:
        print(report(folder))
    return 0
