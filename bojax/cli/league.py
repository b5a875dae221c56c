"""`bojax reproduce surveys`: the league of surveys, one piece after the other, and its page."""

import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from bojax.cli.parser import UsageError
from bojax.config.errors import say
from bojax.results.folder import dated_folder, require_empty
from bojax.text import one_line

ID = "surveys"
"""What `bojax reproduce` calls the league."""


def main(name: str, args: Namespace, words: Sequence[str]) -> int:
    """Run the pieces that are not there yet, write the page, and return the exit code."""
    if args.resume and not args.out:
        raise UsageError("--resume: needs --out, the folder of the league")
    out = args.out or dated_folder(ID)
    if not args.resume:
        require_empty(out, "give another --out, or --resume a league")
    code = _run(out, args.runs, " ".join(["bojax", name, *words]))
    if code not in (0, 1):
        return code
    from bojax.report.league.page import write_pages

    print(*write_pages(out), sep="\n")
    return code


def _run(out: Path, starts: int | None, command: str) -> int:
    """Run what is left of a league, and return the exit code; 1 if a piece failed."""
    from bojax.engine.devices import prepare
    from bojax.engine.provenance import git_revision, versions
    from bojax.engine.signals import StopRequest
    from bojax.report.league.results import CELLS, LEAGUE
    from bojax.results.folder import check_plan
    from bojax.results.store import make_folder, read_json, write_json

    with StopRequest(announce=lambda _: say("stopping after this piece")) as stop:
        prepare("auto")
        from bojax.surveys.league.cells import cells_of, describe
        from bojax.surveys.league.fields import SAMPLE, has_sample, league
        from bojax.surveys.league.routes import peers

        most = len(peers()["starts"])
        starts = most if starts is None else starts
        if not 1 <= starts <= most:
            raise UsageError(f"--runs: got {starts}; allowed: 1 to {most}, the starts that are stored")
        fields = league()
        if not has_sample():
            package = SAMPLE.replace("_", "-")
            say(f"note: three fields are left out; to have them: pip install {package}")
        about = describe(fields, starts)
        if (out / LEAGUE).exists():  # more starts may be added
            old = read_json(out / LEAGUE)
            check_plan(out, {**old, "provenance": None, "starts": starts}, {**about, "provenance": None})
        make_folder(out / CELLS)
        made = {"command": command, "revision": git_revision(), "versions": versions()}
        write_json(out / LEAGUE, {**about, "provenance": made})
        cells = [cell for cell in cells_of(fields, starts) if not (out / CELLS / cell.name).exists()]
        code = 0
        for number, cell in enumerate(cells):
            if stop:
                say(f"{len(cells) - number} pieces are left: --resume --out {out}")
                return stop.exit_code
            begin = time.monotonic()
            try:
                write_json(out / CELLS / cell.name, cell.result(), indent=None)
                state = f"{time.monotonic() - begin:.0f} s"
            except ValueError as error:  # of a planner: --resume tries the piece again
                code, state = 1, f"failed: {one_line(error)}"
            say(f"{number + 1} of {len(cells)}: {cell.name}, {state}")
    return code
