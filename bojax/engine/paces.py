"""What a run of a group took in earlier sweeps on this machine. Only forecasts use it, never results."""

import contextlib
from pathlib import Path

from bojax.engine import executables


def place_of(tag: str, platform: str, lanes: int) -> Path | None:
    """Where the seconds of a run are kept, beside the compiled programs; None if they are not kept.

    Unlike a program, they stay when the code changes.

    Args:
        tag: Name of the content of the group, see `executables.tag_of`.
        platform: Platform of the devices.
        lanes: Number of lanes with which a chunk starts.
    """
    folder = executables.folder_of("seconds")
    return folder / f"{tag}-{platform}-{lanes}" if folder is not None and tag else None


def recall(place: Path | None) -> float | None:
    """The seconds of a run; None if they are not known."""
    with contextlib.suppress(OSError, ValueError):
        return float(place.read_text()) if place is not None else None


def remember(place: Path | None, seconds: float) -> None:
    """Keep the seconds of a run, if that is possible."""
    if place is not None:
        with contextlib.suppress(OSError):
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(f"{seconds:.6g}\n")
            executables.drop_unused(place.parent)
