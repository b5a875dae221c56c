"""What a report reads of `manifest.json`: a schema, and the settings objects that were written into it.

A wrong type ends in one line. Settings that this version of bojax refuses, because another version wrote
them, stay plain values (`Unread`): a report without them is better than none.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, TypeVar

import pydantic
from pydantic import BeforeValidator, Field, PlainValidator

from bojax.config.claims import Claim
from bojax.config.component import Component
from bojax.config.errors import dotted, from_validation
from bojax.config.sweep import validate_experiment
from bojax.config.sweep_file import Report
from bojax.report.text import MISSING, counted, line
from bojax.results.outline import Outline
from bojax.results.store import ResultsError

Count = Annotated[int, Field(ge=0, lt=2**53)]
Pair = Annotated[list[Any], Field(min_length=2, max_length=2)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Bounds = Annotated[list[float], Field(min_length=2, max_length=2)]

T = TypeVar("T")


@dataclass(frozen=True)
class Unread:
    """Settings that this version of bojax cannot read."""

    mapping: Mapping[str, Any]  # the settings as plain values
    reason: str  # why they were refused, in one line


class Recorded(pydantic.BaseModel):
    """A mapping in a JSON file. Keys that it does not know are kept; null stands for the default of a key."""

    model_config = pydantic.ConfigDict(extra="allow", strict=True)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _without_nulls(cls, mapping: Any) -> Any:
        if not isinstance(mapping, Mapping):
            return mapping
        optional = {key for key, field in cls.model_fields.items() if not field.is_required()}
        return {key: value for key, value in mapping.items() if value is not None or key not in optional}


def _outline(numbers: Any) -> Outline:
    if not isinstance(numbers, Mapping):
        raise ValueError("a mapping is expected")
    try:
        outline = Outline.of(numbers)
        outline.as_numbers()
    except TypeError as error:
        raise ValueError(str(error)) from error
    return outline


def _known(report: Any) -> Any:
    """The keys of `report` that this version knows and that are set."""
    if not isinstance(report, Mapping):
        return report
    return {key: value for key, value in report.items() if key in Report.model_fields and value is not None}


class PointEntry(Recorded):
    """A point of the sweep."""

    index: Annotated[int, Field(ge=0, lt=2**31)]
    label: str
    variant: str = ""
    swept: dict[str, Any] = {}
    config: dict[str, Any] = {}
    outline: Annotated[Outline | None, PlainValidator(_outline)] = None


class ClaimEntry(Recorded):
    """A claim; `claims_of` turns it into settings."""

    id: str
    claim: str
    source: str | None = None
    thesis: Any = None
    test: dict[str, Any] | None = None


class Group(Recorded):
    """Times of a static group."""

    points: list[int] = []
    lanes_per_device: Count | None = None
    compile_seconds: float | None = None
    run_seconds: float | None = None
    active_steps: Count | None = None


class Latency(Recorded):
    """What `bojax bench latency` has measured in a results folder."""

    config_hash: str | None = None
    written: str = ""
    device: dict[str, Any] = {}
    # Median, least and largest seconds of an advance of a single run, by index of the point.
    seconds: dict[str, Annotated[list[float], Field(min_length=3, max_length=3)]] = {}

    @property
    def kind(self) -> str:
        """The kind of the device."""
        return line(self.device.get("kind") or "device")


class Chunk(Recorded):
    """A chunk of the sweep, with what went wrong."""

    error: str = ""


class Manifest(Recorded):
    """The keys that are read; only `points` and `status` have to be there."""

    points: Annotated[list[PointEntry], Field(min_length=1)]
    status: Literal["running", "interrupted", "finished", "failed"]
    name: str = ""  # of a loaded folder, never empty
    title: str = ""  # of a loaded folder, never empty
    runs: Count | None = None
    seed: int | None = None
    changed: dict[str, Pair] = {}
    is_published: bool = True  # earlier versions did not record it
    report: Annotated[Report, BeforeValidator(_known)] = Report()
    claims: list[ClaimEntry] = []
    groups: list[Group] = []
    chunks: list[Chunk] = []
    command: str = ""
    written: str = ""
    config_hash: str | None = None
    versions: dict[str, Any] = {}
    git: dict[str, Any] = {"revision": ""}
    device: Any = None
    precision: Any = None
    programs: dict[str, str] = {}  # hashes of what XLA compiled for an accelerator; empty for a CPU
    sha256: dict[str, str] = {}  # of tables and snapshots, by path in the folder; earlier versions lack it

    @property
    def run_seconds(self) -> float:
        """Run time of all groups."""
        return sum(group.run_seconds or 0 for group in self.groups)

    @property
    def compile_seconds(self) -> float:
        """Compile time of all groups."""
        return sum(group.compile_seconds or 0 for group in self.groups)

    @property
    def changes(self) -> list[tuple[str, str, str]]:
        """Settings that differ from the published sweep: dotted path, published value and ours."""
        texts = {key: [line(value) or "none" for value in pair] for key, pair in self.changed.items()}
        return [(key, published, ours) for key, (published, ours) in texts.items()]

    @property
    def compiled(self) -> str:
        """The programs of an accelerator in a short text, equal for results whose programs are equal."""
        if not self.programs:
            return ""
        digest = hashlib.sha256(repr(sorted(self.programs.items())).encode()).hexdigest()[:12]
        return f"{counted(len(self.programs), 'program')}, {digest}"

    def differs_in_programs(self, other: "Manifest") -> bool:
        """Whether XLA compiled the same sweep with other choices of kernels, so that bits may differ."""
        common = self.programs.keys() & other.programs.keys()
        is_same_sweep = self.config_hash == other.config_hash is not None
        return is_same_sweep and any(self.programs[name] != other.programs[name] for name in common)

    @property
    def provenance(self) -> dict[str, str]:
        """What the results were made with and on, each in a line; empty where it is unknown."""
        changes = ", with uncommitted changes" if self.git.get("has_changes") else ""
        return {
            "revision": f"{self.git.get('revision', MISSING)}{changes}",
            "device": line(self.device),
            "versions": line(self.versions),
            "precision": line(self.precision),
        }


def read(manifest: Any, path: str) -> Manifest:
    """The content of the file `path`, of the types that a report relies on."""
    if not manifest.get("points"):
        raise ResultsError(f"{path}: points: missing or empty: not a results folder of bojax")
    checked = validated(Manifest, manifest, path)
    indices = [entry.index for entry in checked.points]
    if len(set(indices)) < len(indices):
        twin = next(index for index in indices if indices.count(index) > 1)
        raise ResultsError(f"{path}: points: two have the index {twin}; allowed: every index once")
    return checked


def validated(schema: type[T], content: Any, path: str) -> T:
    """The content of a JSON file as a schema describes it."""
    try:
        # JSON can spell unpaired surrogates, but no page can hold them, and pydantic cannot show them.
        plain = json.loads(json.dumps(content, ensure_ascii=False).encode(errors="replace"))
        return pydantic.TypeAdapter(schema).validate_python(plain)
    except RecursionError:
        raise ResultsError(f"{path}: its values are nested too deeply") from None
    except pydantic.ValidationError as error:
        raise ResultsError(str(from_validation(error, lambda place: f"{path}: {_indexed(place)}"))) from error


def experiment_of(point: PointEntry) -> Component | Unread:
    """The experiment of a point."""
    return _settings(partial(validate_experiment, is_recorded=True), point.config)


def claims_of(manifest: Manifest) -> tuple[Claim | Unread, ...]:
    """The claims of the sweep."""
    return tuple(_settings(Claim.model_validate, claim.model_dump()) for claim in manifest.claims)


def _settings(validate: Callable[[Any], T], mapping: Mapping[str, Any]) -> T | Unread:
    try:
        return validate(mapping)
    except pydantic.ValidationError as error:
        return Unread(mapping, str(from_validation(error, lambda place: dotted(place) or "settings")))


def _indexed(place: tuple[int | str, ...]) -> str:
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)
    return text.removeprefix(".")
