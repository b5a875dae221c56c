"""The choices that XLA makes when it compiles for an accelerator, kept with the plan that they belong to.

For each product of matrices, XLA measures several kernels and takes the quickest, which it calls autotuning.
Two compilations of one program may choose different kernels, whose sums differ in the last bits. A plan that
begins without choices makes them once. They are kept in its folder, so that a process that resumes the plan,
on this machine or on another one, compiles the same programs and writes tables with the same bytes.

Choices that come with bojax (see `xla_choices`) are the same in every process of the plan, and are not kept
again. XLA remembers choices until the process ends, so that what was measured once is not read again.
"""

import hashlib
import json
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import jax
from jax.stages import Compiled

from bojax.engine.devices import Device, prepare
from bojax.engine.errors import EngineError
from bojax.engine.program import Program
from bojax.engine.xla_choices import XLA_FOLDER, measured, shipped, write, xla_folder
from bojax.errors import FAILURE
from bojax.numerics.disk_cache import folder_of
from bojax.results.store import ResultsError, explained, publish_checked_json, read_checked_json

_COPIES = frozenset({"empty", "recorded", "select"})
"""Programs that only move numbers."""


@runtime_checkable
class Readable(Protocol):
    """A compiled program whose instructions can be read."""

    def as_text(self) -> str | None:
        """The instructions, after a line with the name of the program."""


Made = TypeVar("Made", bound=Readable)


class Choices:
    """The choices for the programs of one plan, in a folder that all its processes share.

    Each program has a file there, written by the first process that compiles it: a hash of what XLA made of
    the program, and the choices that were new to the folder. Programs are compiled with the choices of all
    files.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._lock = threading.Lock()
        self._published: dict[str, str] = {}
        self._read: set[str] = set()

    def offer(self) -> None:
        """Give XLA the choices that were published since the last call, except for products it knows."""
        cache = xla_folder()
        with self._lock:
            if cache is not None:
                write(cache, self._news())

    def settle(
        self,
        name: str,
        made: Made,
        again: Callable[[Mapping[str, str]], Made | None],
        content: str | None = None,
    ) -> Made:
        """The program with the plan's choices: as it was made, unless another process was the first.

        `again` compiles the program with the given choices, or returns None if that is not possible.
        `content` is the `fingerprint` of `made`, if it is known.

        Raises:
            EngineError: XLA makes something else of the program although it has the plan's choices.
            ResultsError: A file of the folder cannot be read or written.
        """
        if name.rpartition("-")[2] in _COPIES:
            return made
        content = content or fingerprint(made)
        first = self._publish(name, content)
        if first == content:
            return made
        with self._lock:
            self._news()
            published = dict(self._published)
        remade = again(published)
        if remade is None or fingerprint(remade) != first:
            raise EngineError(
                f"{name}: XLA does not compile this program as it did when the sweep began, although it has "
                "the same choices of kernels; start the sweep anew with another --out",
                FAILURE,
            )
        return remade

    def _publish(self, name: str, content: str) -> str:
        """Publish a program unless another process has done so; returns the hash that is published."""
        # A program for fewer lanes may still be compiled when its sweep ends without it. Its file must not
        # bring the working folder back: the sweep would seem unfinished.
        path = self.folder / f"{name}.json"
        try:
            if not path.exists():
                with explained(self.folder):
                    self.folder.mkdir(exist_ok=True)
                with self._lock:
                    self._news()
                    published = set(self._published)
                publish_checked_json(path, {"program": content, "choices": measured(published)})
            return str(read_checked_json(path)["program"])
        except (ResultsError, FileNotFoundError):
            if self.folder.parent.exists():
                raise
            return content

    def _news(self) -> dict[str, str]:
        """The choices of files that were not read yet, by the names of XLA's files."""
        news: dict[str, str] = {}
        for path in sorted(self.folder.glob("[!.]*.json")):
            if path.name not in self._read:
                news.update(read_checked_json(path)["choices"])
                self._read.add(path.name)
        news = {name: news[name] for name in news if name not in self._published}
        self._published.update(news)
        return news


def fingerprint(made: Readable) -> str:
    """A hash of what XLA has made of a program, without names and places in the source."""
    lines = (made.as_text() or "").splitlines()
    instructions = "\n".join(line for line in lines if line.lstrip().startswith(("%", "ROOT", "ENTRY")))
    return hashlib.sha256(re.sub(r", metadata=\{[^}]*\}", "", instructions).encode()).hexdigest()


def contents_of(programs: Mapping[str, Readable]) -> dict[str, str]:
    """The hashes of the programs of a group for which XLA may choose kernels, by their names."""
    return {name: fingerprint(made) for name, made in programs.items() if name not in _COPIES}


def compile_again(program: Program | None, device: Device, choices: Mapping[str, str]) -> Compiled | None:
    """Compile a program with the given choices; None if that is not possible.

    Another process does so, to which this one's own choices are not known. JAX's cache hands over the result.
    """
    cache = folder_of("")
    if cache is None or program is None or program.exported is None:
        return None
    digest = hashlib.sha256(json.dumps(sorted(choices.items())).encode()).hexdigest()[:16]
    folder = cache / "choices" / digest
    write(folder, {**shipped(device), **choices})
    try:
        with tempfile.NamedTemporaryFile(suffix=".program") as file:
            file.write(program.serialized())
            file.flush()
            command = [sys.executable, "-m", __name__, file.name, str(cache), device.platform, str(folder)]
            subprocess.run(command, check=True, stdin=subprocess.DEVNULL, capture_output=True)
    except Exception:  # the other process has no memory on the device
        return None
    return program.compile(_AGAIN, device, **{XLA_FOLDER: str(folder)})


_AGAIN = "compiled_again"
"""Name of a program that another process compiles."""


def _main(file: str, cache: str, platform: Any, folder: str) -> None:
    """Compile a program from a file, in a process of its own."""
    prepare("cpu" if platform == "cpu" else "auto")
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    program = Program.deserialized(Path(file).read_bytes())
    program.compile(_AGAIN, jax.devices(platform)[0], **{XLA_FOLDER: folder})


if __name__ == "__main__":
    _main(*sys.argv[1:])
