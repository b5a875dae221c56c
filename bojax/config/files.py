"""Search for configuration files: a path, the working directory, the files that are part of bojax."""

import os
from collections.abc import Sequence
from pathlib import Path

from bojax.config.errors import LIST, ConfigError, did_you_mean, listed

SUFFIXES = (".yaml", ".yml")
EXPERIMENT = "experiment.yaml"
"""Name of the config in the folder of a saved learner."""

WRITTEN = (EXPERIMENT, "manifest.json")
"""Files of results folders that hold a config: it may be somebody else's."""

STANDARD_INPUT = "-"
"""The word of the command line for a file that is read from standard input."""

_PACKAGE = Path(__file__).resolve().parent.parent


def shipped(folder: str) -> Path:
    """The `configs` or `sweeps` that are part of bojax: in an installed package, or next to its sources."""
    inside = _PACKAGE / f"_{folder}"
    return inside if inside.is_dir() else _PACKAGE.parent / folder


def find(source: str, folder: str, beside: Sequence[Path] = ()) -> Path:
    """The file of a path, or of a name: `parking` stands for `FOLDER/parking.yaml`.

    The folders in `beside` are searched before the usual ones.
    """
    if not source:
        raise ConfigError(f"got an empty name; allowed: a YAML file, or a name in {folder}/")
    path = Path(source)
    # `os.path` throughout: `Path.is_file` raises if the name is too long for a file.
    if path.suffix in SUFFIXES:
        for candidate in (path, *(place / path for place in beside)):
            if os.path.isfile(candidate):
                return candidate
    elif len(path.parts) == 1:
        for place in (*beside, *_places(folder)):
            for suffix in SUFFIXES:
                candidate = place / f"{source}{suffix}"
                if os.path.isfile(candidate):
                    return candidate
    if os.path.isfile(path / EXPERIMENT):  # a saved learner
        return path / EXPERIMENT
    if os.path.isdir(path):
        raise ConfigError(f"{source}: is a folder; allowed: a YAML file, or a name in {folder}/")
    if os.path.isfile(path):
        raise ConfigError(f"{source}: is not a YAML file; allowed: a file name that ends in .yaml or .yml")
    names = available(folder)
    stem = path.stem if path.suffix in SUFFIXES else path.name
    other, command = ("sweeps", "sweep") if folder == "configs" else ("configs", "run")
    if source in available(other):
        raise ConfigError(
            f"{source}: is in {other}/, not in {folder}/; start it with: bojax {command} {source}"
        )
    known = f"; allowed: {listed(stem, names, LIST)}" if names else ""
    raise ConfigError(
        f"{source}: no such file, and no such name in {folder}/{known}{did_you_mean(stem, names)}"
    )


def shadowed(source: str, folder: str) -> Path | None:
    """The file of bojax that a different file of the same name in the working directory hides, if any."""
    path, hidden = find(source, folder), shipped(folder) / f"{source}.yaml"
    is_hidden = path.suffix in SUFFIXES and path.stem == source and os.path.isfile(hidden)
    return hidden if is_hidden and hidden.read_bytes() != path.read_bytes() else None


def available(folder: str) -> dict[str, Path]:
    """The files of a folder by name; a file in the working directory hides the one of bojax."""
    found: dict[str, Path] = {}
    for place in _places(folder):
        for path in sorted(place.glob("*")) if place.is_dir() else ():
            if path.suffix in SUFFIXES and path.is_file():
                found.setdefault(path.stem, path)
    return dict(sorted(found.items()))


def display(path: Path) -> str:
    """The name of a file in messages: relative to the working directory if the file is below it."""
    absolute = path.resolve()
    return str(absolute.relative_to(Path.cwd())) if absolute.is_relative_to(Path.cwd()) else str(absolute)


def _places(folder: str) -> tuple[Path, Path]:
    return Path(folder), shipped(folder)
