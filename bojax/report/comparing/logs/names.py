"""The label and the number of a run, from the name of its folder, its file or its column."""

import os
import re
from pathlib import Path

_PATTERNS = (
    re.compile(r"(?P<label>.+)__(?P<run>\d+)__\d{9,}"),  # CleanRL: ENV__LABEL__SEED__TIME
    re.compile(r"(?:(?P<label>.*?)[-_ ./]+)?(?:seed|run|s)[-_ =]*(?P<run>\d+)", re.IGNORECASE),
    re.compile(r"(?P<label>.+)_(?P<run>\d{1,4})"),  # Stable-Baselines3: LABEL_1, LABEL_2
    re.compile(r"(?:(?P<label>.*)/)?(?P<run>\d{1,9})"),  # a number alone
)


def label_and_run(name: str) -> tuple[str, int | None]:
    """Split a name such as `ppo-seed-3` or `PPO_3`; the run is None if the name has no number of a run."""
    for pattern in _PATTERNS:
        if (match := pattern.fullmatch(name)) and len(match["run"]) < 10:
            return (match["label"] or "").strip("-_ ./"), int(match["run"])
    return name, None


def name_of(root: Path, place: Path) -> str:
    """The name of a run whose log is at `place`, in or below `root`: the path from there.

    If that is no label, as in `seed-3`, the names of the folders above precede it.
    """
    folder = Path(os.path.abspath(root))
    relative = place.relative_to(root).as_posix()
    name = "" if relative == "." else relative
    while not label_and_run(name)[0] and folder.name:
        name, folder = f"{folder.name}/{name}".strip("/"), folder.parent
    return name
