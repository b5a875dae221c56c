"""The time left that a sweep forecasts, over the time that it then takes.

Runs a command of bojax in this process and prints the ratio at several shares of the time of its sweeps, from
the beginning of the first compilation to the end of the last run. If the cache has the seconds that earlier
sweeps took, they are used. The load of the machine should not change meanwhile.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from typing_extensions import override

from bojax.cli.main import main as bojax
from bojax.engine import tasks
from bojax.engine.progress import SweepProgress

SHARES = 0.1, 0.25, 0.5, 0.75, 0.9

EXAMPLES = """\
  python benchmarks/forecast_ratios.py sweep parking --runs 100
  python benchmarks/forecast_ratios.py --json left.json reproduce chapter5 --out results/all
"""

Row = tuple[float, float | None]
"""A time, and the seconds left that were forecast then."""


class Noted(SweepProgress):
    """Notes each forecast that is shown.

    Attributes:
        begun: Time at which the progress began.
        rows: The forecasts.
        ended: Time at which it ended.
    """

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.begun = self.ended = time.monotonic()
        self.rows: list[Row] = []
        made.append(self)

    @override
    def __exit__(self, *error):
        self.ended = time.monotonic()
        super().__exit__(*error)

    @override
    def _show(self):
        self.rows.append((time.monotonic(), self.seconds_left()))
        super()._show()


made: list[Noted] = []
"""Those of the command."""


def main(argv: Sequence[str]) -> int:
    """Run the command and print its table."""
    args = parse(argv)
    tasks.SweepProgress = Noted
    code = bojax(args.command)
    found = [table(each) for each in made]
    for rows in found:
        print(f"{'share':>6} {'forecast':>9} {'true, s':>9} {'ratio':>6}")
        for row in rows:
            ratio, left = (f"{row[key]:.2f}" if row[key] else "-" for key in ("ratio", "forecast"))
            print(f"{row['share']:6.0%} {left:>9} {row['true']:9.1f} {ratio:>6}")
    if args.json:
        args.json.write_text(json.dumps({"command": args.command, "sweeps": found}, indent=1) + "\n")
    return code


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n")[0],
        epilog=f"examples:\n{EXAMPLES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the ratios to a file")
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="WORD", help="a command of bojax")
    return parser.parse_args(argv)


def table(progress: Noted) -> list[dict[str, float | None]]:
    """Forecast and truth at each share of the time, as of the last forecast before."""
    rows = []
    for share in SHARES:
        until = progress.begun + share * (progress.ended - progress.begun)
        before = [row for row in progress.rows if row[0] <= until]
        when, left = before[-1] if before else (until, None)
        true = progress.ended - when
        ratio = None if left is None else left / max(true, 1e-9)
        rows.append({"share": share, "forecast": left, "true": true, "ratio": ratio})
    return rows


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
