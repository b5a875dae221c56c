"""What a report reads of `manifest.json`, as a schema: a wrong type or shape ends in one line."""

from typing import Annotated, Any, Literal

import pydantic
from pydantic import BeforeValidator, Field

from bojax.config.errors import from_validation
from bojax.results.store import ResultsError

MAX_DEPTH = 100
"""Most mappings and lists within each other: far more than settings have, far less than Python can walk."""

Count = Annotated[int, Field(ge=0, lt=2**53)]
Texts = Annotated[list[str], BeforeValidator(lambda value: [value] if isinstance(value, str) else value)]
"""Text, or a list of texts."""


class _Part(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="allow", strict=True)


Box = Annotated[list[pydantic.FiniteFloat], Field(min_length=4, max_length=4)]
Shape = Annotated[list[pydantic.FiniteFloat], Field(min_length=3, max_length=4)]


class OutlineEntry(_Part):
    """What stands in the world, see `bojax.results.outline.Outline`."""

    border: Box | None = None
    obstacles: list[Shape] = []
    goals: list[Shape] = []


class PointEntry(_Part):
    """A point of the sweep."""

    index: Annotated[int, Field(ge=0, lt=2**31)]
    label: str
    variant: str | None = None
    swept: dict[str, Any] | None = None
    config: dict[str, Any] | None = None
    outline: OutlineEntry | None = None


class Report(_Part):
    """What the sweep wants to be shown."""

    figures: list[str] | None = None
    notes: Texts | None = None
    thesis: dict[str, Any] | None = None
    relative_to: str | None = None
    by_step: Count | None = None
    over: str | None = None
    column: str | None = None
    rolling: Annotated[int, Field(ge=1, lt=2**31)] | None = None
    best_return: float | None = None


class Claim(_Part):
    """A claim and its test; what the test needs is checked when it is made."""

    id: str
    claim: str
    source: str | None = None
    thesis: Any = None
    test: dict[str, Any] | None = None


class Group(_Part):
    """Times of a static group."""

    points: list[int] | None = None
    lanes_per_device: Count | None = None
    devices: Count | None = None
    compile_seconds: float | None = None
    run_seconds: float | None = None
    active_steps: Count | None = None
    latency_seconds: dict[str, float | None] | None = None


class Chunk(_Part):
    """A chunk of the sweep, with what went wrong."""

    error: str | None = None


class Manifest(_Part):
    """The keys that are read; only `points` and `status` have to be there."""

    points: Annotated[list[PointEntry], Field(min_length=1)]
    status: Literal["running", "interrupted", "finished", "failed"]
    name: str | None = None
    title: str | None = None
    runs: Count | None = None
    seed: int | None = None
    changed: dict[str, Annotated[list[Any], Field(min_length=2, max_length=2)]] | None = None
    report: Report | None = None
    claims: list[Claim] | None = None
    groups: list[Group] | None = None
    chunks: list[Chunk] | None = None
    command: str | None = None
    written: str | None = None
    config_hash: str | None = None
    versions: dict[str, Any] | None = None
    git: dict[str, Any] | None = None


def check(manifest: Any, path: str) -> dict[str, Any]:
    """The manifest, of the types and shapes that a report relies on, its text encodable.

    Args:
        manifest: What the file holds.
        path: The file, for messages.

    Raises:
        ResultsError: A key has another type or shape; one line that names it.
    """
    manifest = _encodable(manifest, MAX_DEPTH, path)
    if not manifest.get("points"):
        raise ResultsError(f"{path}: points: missing or empty: not a results folder of bojax")
    try:
        Manifest.model_validate(manifest)
    except pydantic.ValidationError as error:
        raise ResultsError(str(from_validation(error, lambda place: f"{path}: {_dotted(place)}"))) from error
    indices = [entry["index"] for entry in manifest["points"]]
    if len(set(indices)) < len(indices):
        twin = next(index for index in indices if indices.count(index) > 1)
        raise ResultsError(f"{path}: points: two have the index {twin}; allowed: every index once")
    return manifest


def _encodable(value: Any, depth: int, path: str) -> Any:
    """A copy in which half a surrogate pair, which JSON can spell and no file can hold, is a mark instead."""
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode()
    if isinstance(value, dict | list) and not depth:
        raise ResultsError(f"{path}: nested more than {MAX_DEPTH} levels deep")
    if isinstance(value, dict):
        return {
            _encodable(key, depth, path): _encodable(item, depth - 1, path) for key, item in value.items()
        }
    if isinstance(value, list):
        return [_encodable(item, depth - 1, path) for item in value]
    return value


def _dotted(place: tuple[int | str, ...]) -> str:
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)
    return text.removeprefix(".")
