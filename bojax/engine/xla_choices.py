"""The files in which XLA keeps its choices of kernels, and those that come with bojax.

XLA keeps each choice in a small file beside JAX's cache of compiled programs, and looks there before it
measures. The name of a file is a hash of the card and of the instructions, so that a file never misleads
another card or program. The choices of the sweeps that come with bojax are part of the package, one archive
for each card and version of XLA on which they were measured. With them, these sweeps compile in less time,
and to the same programs on every machine with such a card.

`python -m bojax.engine.xla_choices` makes the archive of this machine's card from the cache that is in use.
"""

import base64
import contextlib
import functools
import hashlib
import json
import lzma
import os
import re
import secrets
import threading
import time
from collections.abc import Collection, Mapping
from importlib.metadata import version
from pathlib import Path

import jax

from bojax.engine.devices import Device, prepare
from bojax.numerics.disk_cache import folder_of

XLA_FOLDER = "xla_gpu_per_fusion_autotune_cache_dir"
"""The folder in JAX's cache, and the option of XLA's compiler that names a folder."""

ARCHIVES = Path(__file__).parent / "kernel_choices"
"""The folder with the choices that come with bojax."""

_IS_SAFE = re.compile(r"(?:[\w+=-][\w+=.-]*/)*[\w+=-][\w+=.-]*")
"""Relative paths of XLA's files that stay inside its folder."""

Choices = Mapping[str, str]
"""The contents of XLA's files in base64, by their paths in its folder."""


def xla_folder() -> Path | None:
    """The folder in which XLA keeps its choices; None if JAX's cache is off."""
    folder = folder_of("")
    return None if folder is None else folder / XLA_FOLDER


def read_all(*left_out: Collection[str]) -> Choices:
    """The choices in XLA's folder, but for those of names that are left out.

    A sweep asks for each of its programs, and the folder of a reproduction has ten thousand files. So a
    folder is listed again only after a change, and each file is read once in a process.
    """
    folder, found = xla_folder(), {}
    with _reading:
        files = {} if folder is None else _files(str(folder))
        for name in sorted(set(files).difference(*left_out)):
            with contextlib.suppress(OSError):  # it was deleted meanwhile
                found[name] = _content_of(files[name].path, files[name].inode())
    return found


_reading = threading.Lock()

_CLOCK_NS = 2_000_000_000
"""Time after which a further change of a folder is sure to have another time than the last one."""


@functools.cache
def _content_of(path: str, inode: int) -> str:
    """The content of a file in base64. XLA writes a file whole, under another name first."""
    del inode  # for the cache
    return base64.b64encode(Path(path).read_bytes()).decode()


def _files(folder: str, prefix: str = "") -> dict[str, os.DirEntry[str]]:
    """XLA's files below a folder, by their paths in it."""
    found: dict[str, os.DirEntry[str]] = {}
    with contextlib.suppress(OSError):
        now, changed = time.time_ns(), os.stat(folder).st_mtime_ns
        last = _last.get(folder)
        if last is None or last[0] != changed:
            last = changed, *_listed(folder, prefix)
            if abs(now - changed) > _CLOCK_NS:
                _last[folder] = last
        _, files, folders = last
        found |= files
        for each in folders:
            found |= _files(each.path, f"{prefix}{each.name}/")
    return found


_Listing = tuple[dict[str, os.DirEntry[str]], list[os.DirEntry[str]]]
"""XLA's files in a folder by their paths, and the folders in it."""

_last: dict[str, tuple[int, *_Listing]] = {}
"""The time of the last change of each folder, and its listing. No earlier one is kept: it may be long."""


def _listed(folder: str, prefix: str) -> _Listing:
    files, folders = {}, []
    with os.scandir(folder) as entries:
        for entry in entries:
            name = prefix + entry.name
            if entry.is_dir(follow_symlinks=False):
                folders.append(entry)
            elif name.endswith((".pb", ".textproto")) and _IS_SAFE.fullmatch(name):
                files[name] = entry
    return files, folders


def write(folder: Path, choices: Choices, *, replaces: bool = False) -> None:
    """Write files as XLA does: whole, under another name first. What cannot be written is left out."""
    for name, content in choices.items():
        path, decoded = folder / name, base64.b64decode(content)
        if not _IS_SAFE.fullmatch(name):
            continue
        with contextlib.suppress(OSError):
            if path.exists() and (not replaces or path.read_bytes() == decoded):
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            own = path.with_name(f".tmp_{secrets.token_hex(6)}")
            own.write_bytes(decoded)
            os.replace(own, path)


def archive_of(device: Device) -> Path:
    """The archive for the card of a device and the version of XLA; it may not exist."""
    card = re.sub(r"[^a-z0-9]+", "-", device.device_kind.lower()).strip("-")
    return ARCHIVES / f"{card}-jaxlib-{version('jaxlib')}.json.xz"


@functools.cache
def shipped(device: Device) -> Choices:
    """The choices that come with bojax for the card of a device; empty if there are none."""
    try:
        content = lzma.decompress(archive_of(device).read_bytes())
    except FileNotFoundError:
        return {}
    texts: Mapping[str, str] = json.loads(content)
    return {name: base64.b64encode(text.encode("latin-1")).decode() for name, text in texts.items()}


def measured(left_out: Collection[str]) -> Choices:
    """The choices in XLA's folder that did not come with bojax, but for those that are left out."""
    cards = {device.device_kind: device for device in jax.local_devices()}
    return read_all(left_out, *map(shipped, cards.values()))


def offer_shipped(device: Device) -> None:
    """Give XLA the choices that come with bojax, in place of those that this machine has measured."""
    if (folder := xla_folder()) is not None:
        _offer(device, folder)


@functools.cache
def _offer(device: Device, folder: Path) -> None:
    """Write the files unless an earlier process has done so."""
    archive = archive_of(device)
    if not archive.exists():
        return
    written = folder / f".{archive.name}-{hashlib.sha256(archive.read_bytes()).hexdigest()[:16]}"
    if not written.exists():
        write(folder, shipped(device), replaces=True)
        with contextlib.suppress(OSError):
            written.touch()


def pack(device: Device) -> Path:
    """Make the archive for the card of a device from the choices in XLA's folder; returns its path.

    Choices of the archive that the folder lacks are kept.
    """
    path, choices = archive_of(device), {**shipped(device), **read_all()}
    # As text, the names inside the files repeat those of the index, which halves the archive.
    texts = {name: base64.b64decode(content).decode("latin-1") for name, content in choices.items()}
    path.parent.mkdir(exist_ok=True)
    content = json.dumps(texts, sort_keys=True).encode()
    path.write_bytes(lzma.compress(content, preset=9 | lzma.PRESET_EXTREME))
    print(f"{path}: {len(choices)} choices, {path.stat().st_size:,} bytes")
    return path


if __name__ == "__main__":
    prepare("auto")
    pack(jax.devices()[0])
