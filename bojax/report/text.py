"""Formats numbers for the page, the figures and `claims.json`."""

import hashlib
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping
from itertools import accumulate
from typing import Any

MISSING = "–"
JOINERS = "\u200c\u200d"  # invisible, but scripts such as Arabic and Devanagari are not legible without them
MAX_FILE_NAME = 120  # bytes of a name within a file name; most file systems allow 255 in all


def number(value: float | None, digits: int = 3) -> str:
    """A number to `digits` significant digits, whole from 1000 on: `0.0123`, `570`, `-1,523`."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    rounded = round(value, decimals)
    if abs(rounded) < 1e-4:
        return f"{value:.{digits - 1}e}"
    return f"{rounded:,.{decimals}f}"


def percent(share: float | None) -> str:
    """A share as a percentage with one decimal."""
    return MISSING if share is None or not math.isfinite(share) else f"{100 * share:.1f}%"


def with_bounds(estimate: float, low: float, high: float) -> tuple[str, str]:
    """An estimate and `[low, high]`, with as many decimals as the width of the interval justifies."""
    half = (high - low) / 2
    if not math.isfinite(half) or half <= 0:
        return f"{estimate:,.6g}", f"[{low:,.6g}, {high:,.6g}]"
    decimals = max(0, 1 - math.floor(math.log10(half)))
    if decimals > 6:
        return number(estimate, 6), f"[{number(low, 6)}, {number(high, 6)}]"
    # Adding zero turns a rounded -0 into 0.
    estimate, low, high = (round(value, decimals) + 0.0 for value in (estimate, low, high))
    return f"{estimate:,.{decimals}f}", f"[{low:,.{decimals}f}, {high:,.{decimals}f}]"


def seconds(value: float | None) -> str:
    """A time span in microseconds, milliseconds, seconds or minutes."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value < 1e-3:
        return f"{number(value * 1e6)} µs"
    if value < 1:
        return f"{number(value * 1e3)} ms"
    if value < 120:
        return f"{number(value)} s"
    return f"{int(value // 60)} min {int(value % 60)} s"


def plain(value: Any) -> str:
    """A setting on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return ", ".join(plain(item) for item in value) or "[]"
    return str(value)


def exact(value: Any) -> str:
    """A setting on one line, its numbers with all their digits."""
    if isinstance(value, list | tuple):
        return ", ".join(map(exact, value)) or "[]"
    is_rounded = isinstance(value, float) and float(plain(value)) != value
    return repr(value) if is_rounded else plain(value)


def minus(text: str) -> str:
    """The text of a number with a minus sign in place of its hyphen, as numbers are typeset."""
    return text.replace("-", "\N{MINUS SIGN}")


def is_number(value: Any) -> bool:
    """Whether a setting is a number, and not a Boolean."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def heading(name: str) -> str:
    """The last name of a dotted path in words: `learning rate`."""
    return name.rsplit(".", 1)[-1].replace("_", " ")


def capitalised(text: str) -> str:
    """A text with a capital letter at its beginning; names in it keep theirs."""
    return text[:1].upper() + text[1:]


def line(value: Any) -> str:
    """A nested value on one line, empty entries left out; equal items of a list are counted: `2 x a, b`."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {line(item)}" for key, item in value.items() if item not in (None, ""))
    if isinstance(value, list):
        lines = [line(item) for item in value]
        kinds = list(dict.fromkeys(lines))
        return ", ".join(f"{lines.count(kind)} x {kind}" if lines.count(kind) > 1 else kind for kind in kinds)
    return "" if value is None else plain(value)


def printed(name: str) -> str:
    """A name from a file as one line of visible characters, never empty, for figures and pages.

    White space is a single space. Control characters and those that reverse the direction of others are left
    out. Characters without a meaning of their own, which XML and most fonts lack, are replaced.
    """
    found = []
    for letter in " ".join(name.split()):
        kind = unicodedata.category(letter)
        if kind in ("Cs", "Co", "Cn"):
            found.append("\N{REPLACEMENT CHARACTER}")
        elif kind not in ("Cc", "Cf") or letter in JOINERS:
            found.append(letter)
    text = "".join(found).strip()
    return text if text.strip(JOINERS + " ") else "(no name)"


def distinct(names: Iterable[str]) -> list[str]:
    """The same names; one that occurs again is followed by a number."""
    found: dict[str, None] = {}
    for name in names:
        numbered = (name, *(f"{name} ({number})" for number in range(2, len(found) + 2)))
        found[next(each for each in numbered if each not in found)] = None
    return [*found]


def shortened(text: str, most: int) -> str:
    """A text with its middle left out if it takes more than `most` columns of a monospaced font."""
    widths = [0 if unicodedata.combining(c) else 1 + (unicodedata.east_asian_width(c) in "WF") for c in text]
    if sum(widths) <= most:
        return text
    ahead, behind = (
        sum(total <= (most - 1) // 2 for total in accumulate(each)) for each in (widths, widths[::-1])
    )
    return f"{text[:ahead].rstrip()}\N{HORIZONTAL ELLIPSIS}{text[len(text) - behind :].lstrip()}"


def file_name(name: str) -> str:
    """A name with a hyphen in place of characters that some file systems refuse.

    Of a long name, the end is a hash, so that different names stay different.
    """
    plain = re.sub(r"[^\w.-]+", "-", name)
    if len(plain.encode()) <= MAX_FILE_NAME:
        return plain
    end = f"-{hashlib.sha256(plain.encode()).hexdigest()[:8]}"
    return plain.encode()[: MAX_FILE_NAME - len(end)].decode(errors="ignore") + end


def joined(items: Iterable[object]) -> str:
    """Names or numbers as a list in a sentence: `a`, `a and b`, `a, b and c`; `a, b; c`."""
    every = [str(item) for item in items]
    if len(every) > 1 and any(", " in item for item in every):
        return "; ".join(every)
    *most, last = every
    return f"{', '.join(most)} and {last}" if most else last


def counted(count: int, noun: str) -> str:
    """A count with its noun: `1 run`, `200 runs`."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def ranged(counts: Iterable[int], noun: str) -> str:
    """The smallest and the greatest of several counts with their noun: `200 runs`, `150 to 200 runs`."""
    low, *others = sorted({int(count) for count in counts})
    return f"{low:,} to {counted(others[-1], noun)}" if others else counted(low, noun)
