"""Curves of all sorts given to `bojax compare`: a page, or one line; equal curves are never told apart."""

import math
import random
import re
from pathlib import Path

from benchmarks.campaign.case import Outcome, fault_of, is_whole
from benchmarks.campaign.process import cli, run, scratch

_NAMES = (
    *("_baseline", "$x_1$", "$\\unknown$", "a\nb", "", " ", "n" * 300, "שלום", "a\u202eb", "sac", "sac "),
    *("<b>sac</b>", "ppo", "0", "-", "=1+1", "漢字", "%s", "\\", "{}", "a,b", 'a"b'),
)
_HEADERS = ("label,run,x,value",) * 8
_HEADERS += ("label,x,value", "run,x,value", "x,value", "Label,Run,X,Value", "", "a;b;c")


def check(seed: int) -> Outcome:
    """Compare the curves of a CSV file that follows from the seed."""
    draw = random.Random(f"comparisons {seed}")
    with scratch() as place:
        options, are_equal = _write(draw, place / "curves.csv")
        words = ["compare", "--csv", "curves.csv", "--out", "out", *options]
        ended = run(lambda: cli(*words), place)
        tried = f"{' '.join(options)} on {(place / 'curves.csv').read_bytes()[:90]!r}"
        fault = fault_of(ended, (0, 2))
        page = place / "out" / "comparison.html"
        if not fault and ended.code == 0 and not is_whole(page):
            fault = "no whole page"
        if not fault and ended.code and (place / "out").exists():
            fault = "refused, and a folder is written"
        if not fault and are_equal:
            fault = _told_apart(ended.code, page, ended.err)
        return Outcome(tried, fault)


def _write(draw: random.Random, path: Path) -> tuple[list[str], bool]:
    """Write curves; returns options, and whether two labels have the same curves, one logged for longer."""
    axis = draw.choice([[], ["--x", "step"], ["--x", "episode"]])
    if draw.random() < 0.3:
        rows, length = ["label,run,x,value"], draw.randint(4, 30)
        for run_ in range(draw.randint(2, 6)):
            values = [draw.gauss(0, 1) + place for place in range(4 * length)]
            for label, count in (("short", length), ("long", 4 * length)):
                rows += [f"{label},{run_},{10 * (place + 1)},{values[place]!r}" for place in range(count)]
        path.write_text("\n".join(rows))
        return axis, True
    header = draw.choice(_HEADERS)
    rows = [header] if header else []
    for label in draw.sample(_NAMES, draw.randint(1, 5)):
        quoted = '"' + label.replace('"', '""') + '"'
        for run_ in range(draw.randint(1, 6)):
            x = 0.0
            for _ in range(draw.choice([0, 1, 1, 2, draw.randint(3, 30)])):
                jumps = draw.random() < 0.1
                x += draw.choice([1, 10, 0.5, 0, -3, 1e6, 1e300]) if jumps else draw.randint(1, 50)
                rows.append(f"{quoted},{run_},{x:g},{_value(draw)}")
    if draw.random() < 0.1:
        rows = [f"# {row}" for row in rows]
    if draw.random() < 0.1:
        rows.append(draw.choice(["x", ",,,", "a,b,c,d,e", '"', "\0", "label,run,x,value"]))
    path.write_text("\n".join(rows))
    options = [*axis, *draw.choice([[], ["--last", str(draw.choice([0, 1, 3, 1000, -1]))]])]
    return [*options, *draw.choice([[], [], ["--at", str(draw.choice([1, 50, 10**9, -1]))]])], False


def _value(draw: random.Random) -> str:
    odd = ("nan", "inf", "-inf", "1e308", "-1e308", "5e-324", "", "x", "true", "0", "0")
    return draw.choice(odd) if draw.random() < 0.05 else f"{draw.gauss(0, 1) * 10 ** draw.randint(-3, 3):.6g}"


def _told_apart(code: int, page: Path, err: str) -> str:
    if code:
        return f"refused: {err[-200:]}"
    text = re.sub(r"<[^>]*>", " ", page.read_text())
    shares = [float(share) for share in re.findall(r"\b(\d+(?:\.\d+)?)\s?%", text)]
    if not math.isclose(min((abs(share - 50.0) for share in shares), default=0.0), 0.0, abs_tol=1e-9):
        return "the probability that one of two equal curves is better is not 50%"
    return ""
