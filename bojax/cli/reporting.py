"""`bojax report`: rebuilding the figures, tables and claims of results folders from their files."""

from collections.abc import Sequence

from bojax.cli.parser import Parser, path

_EXAMPLES = """\
  bojax report results/parking/20250101-120000       the report of one folder
  bojax report results/parking/*                     the reports of several folders
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    parser = Parser(
        name,
        "DIR...",
        "Draw the figures, test the claims and write report.html of finished results folders.\n"
        "The tables are not changed. Verdicts are printed on standard error, paths on standard output.",
        _EXAMPLES,
    )
    parser.option("folders", "DIR", "results folders", path, nargs="+")
    args = parser.read(words)

    from bojax.report.progress import report
    from bojax.tuning.page import build_page, is_search

    for folder in args.folders:
        print(build_page(folder) if is_search(folder) else report(folder, is_brief=len(args.folders) > 1))
    return 0
