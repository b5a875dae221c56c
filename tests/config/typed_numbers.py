"""Which numbers a text has typed, where a reference would follow the results."""

import re

_BRACES = re.compile(r"\{[^{}]*\}")
_SOURCE = re.compile(
    r"\b(?:Figs?\.|Tables?|Sections?|Chapters?|Equations?)\s+[\d.]+\w*(?:(?:,| to| and)\s+[\d.]+\w*)*"
    r"|\b(?:fig|table|section)-[\d.]+"  # in names of sweeps and of claims
)
_EQUATION = re.compile(r"(?<![\d%}] )\([2-6]\.\d+\w?\)")  # unlike a standard deviation, after no number
_TYPED = re.compile(r"\d[\d,]*\.\d+%?|\d[\d,]*%|\bof \d[\d,]* runs\b")


def typed_numbers(text: str) -> list[str]:
    """Decimal numbers, percentages and counts of runs that an explanation has typed instead of references.

    Numbers of figures, tables, sections and equations do not count, nor do those in names of sweeps.
    """
    for pattern in (_BRACES, _SOURCE, _EQUATION):
        text = pattern.sub(" ", text)
    return _TYPED.findall(" ".join(text.split()))
