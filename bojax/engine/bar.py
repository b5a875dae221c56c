"""Where progress is shown: a bar in a terminal or a notebook, otherwise lines of text, or lines of JSON."""

import html
import json
import os
import sys
import time
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from bojax.config.errors import printable

LINE_SECONDS = 10.0
"""Minimum time between two plain lines."""

PROGRESS = "BOJAX_PROGRESS"
"""Environment variable that is `json` if another process reads standard error. Progress is then a line
`{"title": ..., "done": ..., "total": ..., "text": ...}`; every other line is a message."""


def is_read_by_a_process() -> bool:
    """Whether another process reads the progress."""
    return os.environ.get(PROGRESS) == "json"


class Bar:
    """Shows how many of a number of runs are done. Its methods are called by one thread at a time."""

    def __init__(self, title: str, total: int, console: Console):
        self._title, self._total, self._console = title, total, console
        self._live: Progress | None = None
        self._display: Any = None
        self._last_line = time.monotonic()
        self._is_json = is_read_by_a_process() and not console.quiet

    @property
    def is_live(self) -> bool:
        """Whether a bar shows every change."""
        return self._live is not None or self._display is not None

    def __enter__(self) -> "Bar":
        if self._is_json:
            return self
        if self._console.is_jupyter:
            from IPython.display import display  # pyright: ignore[reportMissingImports]

            self._display = display(self._drawn(0, ""), raw=True, display_id=True)
        elif self._console.is_terminal:
            columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=24))
            texts = (TextColumn("{task.fields[text]}"), TimeElapsedColumn())
            self._live = Progress(*columns, *texts, console=self._console)
            self._task = self._live.add_task(escape(self._title), total=self._total, text="")
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self._console.print(escape(printable(text)), soft_wrap=True)

    def show(self, done: int, text: str) -> None:
        """Show that `done` runs are done, and a text; a log gets a line every `LINE_SECONDS`."""
        if self._is_json:
            event = {"title": self._title, "done": done, "total": self._total, "text": text}
            print(json.dumps(event), file=sys.stderr, flush=True)
        elif self._live is not None:
            self._live.update(self._task, completed=done, text=escape(text))
        elif self._display is not None:
            self._display.update(self._drawn(done, text), raw=True)
        elif time.monotonic() - self._last_line >= LINE_SECONDS:
            self._last_line = time.monotonic()
            self.say(f"{self._title}: {text}")

    def _drawn(self, done: int, text: str) -> dict[str, str]:
        """What a notebook displays."""
        title, words = html.escape(self._title), html.escape(text)
        bar = f'<progress value="{done}" max="{self._total}" aria-label="{title}"></progress>'
        return {"text/plain": f"{self._title}: {text}", "text/html": f"<div>{title} {bar} {words}</div>"}
