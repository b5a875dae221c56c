"""Ways to spoil a file, for every kind of case: other bytes, or something else in its place."""

import os
import random
import socket
from collections.abc import Callable
from pathlib import Path

BYTES: dict[str, Callable[[random.Random, bytes], bytes]] = {
    "cut off": lambda draw, content: content[: draw.randrange(len(content) + 1)],
    "emptied": lambda draw, content: b"",
    "flipped": lambda draw, content: _flipped(draw, content or b"\0"),
    "zeroed": lambda draw, content: _zeroed(draw, content or b"\0"),
    "noise": lambda draw, content: draw.randbytes(len(content) or 1),
    "lengthened": lambda draw, content: content + draw.randbytes(draw.choice([1, 100])),
}
"""Changes of the bytes of a file, by what it then is."""


def _flipped(draw: random.Random, content: bytes) -> bytes:
    index, changed = draw.randrange(len(content)), bytearray(content)
    changed[index] ^= 1 << draw.randrange(8)
    return bytes(changed)


def _zeroed(draw: random.Random, content: bytes) -> bytes:
    start, length = draw.randrange(len(content)), draw.choice([1, 16, 512, 4096])
    stop = min(len(content), start + length)
    return content[:start] + bytes(stop - start) + content[stop:]


def _bind(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # the path of a socket has to be short
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path.name)
    os.chdir(here)


NO_FILES: dict[str, Callable[[Path], object]] = {
    "missing": lambda path: None,
    "a pipe": lambda path: os.mkfifo(path),
    "a folder": lambda path: path.mkdir(),
    "a socket": _bind,
    "a link to nothing": lambda path: path.symlink_to("nowhere"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a link to the root": lambda path: path.symlink_to("/"),
    "an empty device": lambda path: path.symlink_to("/dev/null"),
    "an endless device": lambda path: path.symlink_to("/dev/zero"),
    "a terminal": lambda path: path.symlink_to("/dev/tty"),
}
"""What may stand in the place of a regular file; each function creates it at a free path."""


def spoil(draw: random.Random, path: Path) -> str:
    """Change the bytes of a file, or put something else in its place; returns what it is then."""
    how = draw.choice([*BYTES, *NO_FILES])
    if how in BYTES:
        path.write_bytes(BYTES[how](draw, path.read_bytes()))
    else:
        path.unlink()
        NO_FILES[how](path)
    return how
