"""Why claims are not reproduced: the explanations of a sweep, each with the claims that need it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bojax.config.claims import Cause
from bojax.config.sweep import published_report
from bojax.report.manifest import Manifest
from bojax.report.text import joined
from bojax.report.verdicts import TestedClaim

CAUSES: dict[Cause, str] = {
    "choice": "a choice that the thesis leaves open",
    "slip": "a slip of the thesis",
    "few-runs": "too few printed runs",
    "unexplained": "unexplained",
}
"""Each cause in words."""


@dataclass(frozen=True)
class Explained:
    """An explanation in these results."""

    cause: Cause
    text: str  # a paragraph; empty if the sweep has no explanation
    sweeps: Sequence[str]  # whose results are the evidence
    claims: Sequence[TestedClaim]  # that it explains and that are not reproduced, or inconclusive

    @property
    def cause_in_words(self) -> str:
        """The cause as pages show it."""
        return CAUSES[self.cause]


def explanations_of(manifest: Manifest, claims: Sequence[TestedClaim]) -> list[Explained]:
    """The explanations of those claims that are not reproduced, or inconclusive, in the order of the sweep.

    A sweep that is part of bojax has the explanations of this version, which may be later than the results.
    Any other sweep, also one of the same name, has those of its manifest. Claims without an explanation are
    unexplained, and come last.
    """
    published = published_report(manifest.name or "") if manifest.is_published else None
    report = published or manifest.report
    left = [claim for claim in claims if claim.verdict != "reproduced"]
    found = []
    for each in report.explanations:
        if members := [claim for claim in left if claim.id in each.claims]:
            found.append(Explained(each.cause, each.text.strip(), each.sweeps, members))
        left = [claim for claim in left if claim.id not in each.claims]
    return [*found, Explained("unexplained", "", (), left)] if left else found


def causes_of(explanations: Iterable[Explained]) -> str:
    """How many claims have which cause, a sentence for each verdict; empty if all are reproduced."""
    pairs = [(claim.verdict, each.cause) for each in explanations for claim in each.claims]
    sentences = []
    for verdict in ("not reproduced", "inconclusive"):
        causes = [cause for of, cause in pairs if of == verdict]
        counts = [f"{causes.count(cause)} {text}" for cause, text in CAUSES.items() if cause in causes]
        if counts:
            sentences.append(f"Causes of the {len(causes)} {verdict}: {joined(counts)}.")
    return " ".join(sentences)
