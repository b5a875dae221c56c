"""When the chunks of a running command begin and end, read from its results folder by another process."""

import os
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

INTERVAL = 0.05
"""Seconds between two looks at the folder."""

_ENTRY = re.compile(r"(?P<chunk>chunk-\d{5,}-[0-9a-f]{12})-\d+(?P<done>\.done)?")


class ChunkWatch:
    """Notes the begin and end of all chunks under a results folder, from a thread, while the context is open.

    A chunk begins when its attempt's folder is created, and ends when the file `.done` beside it is written:
    the same for all launchers. Merging deletes both, therefore the folder is read all the time. A chunk whose
    ending is merged between two looks ends at the second.

    Args:
        out: Results folder of a sweep, or a folder of results folders.
    """

    def __init__(self, out: Path):
        self._out = out
        self._begun: dict[tuple[str, str], float] = {}
        self._ended: dict[tuple[str, str], float] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> "ChunkWatch":
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join()

    def spans(self) -> list[tuple[float, float]]:
        """Begin and end of every chunk seen to end, in seconds since the first chunk began, in order."""
        first = min(self._begun.values(), default=0.0)
        ended = self._ended.items()
        return sorted((round(self._begun[at] - first, 2), round(end - first, 2)) for at, end in ended)

    def _watch(self) -> None:
        while not self._stop.wait(INTERVAL):
            now = {self._out / ".work", *self._out.glob("*/.work")}
            for folder in now | {Path(folder) for folder, _ in self._begun}:
                self._look(str(folder))

    def _look(self, folder: str) -> None:
        open_before = [at for at in self._begun if at[0] == folder and at not in self._ended]
        seen = {self._note(folder, entry) for entry in _entries(Path(folder))}
        for at in open_before:
            if at[1] not in seen:
                self._ended[at] = time.time()

    def _note(self, folder: str, entry: os.DirEntry[str]) -> str | None:
        found = _ENTRY.fullmatch(entry.name)
        if found is None:
            return None
        at = folder, found["chunk"]
        try:
            if found["done"] and at in self._begun:
                self._ended.setdefault(at, entry.stat().st_mtime)
            elif not found["done"] and at not in self._begun:
                self._begun[at] = os.stat(Path(entry.path) / "attempt.json").st_mtime
        except OSError:  # not written yet, or merged meanwhile
            pass
        return found["chunk"]


def _entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            yield from sorted(entries, key=lambda entry: entry.name)  # a folder comes before its ending
    except OSError:
        return
