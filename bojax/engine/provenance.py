"""Provenance of results: versions, git revision, devices, and hashes of the code."""

import contextlib
import functools
import hashlib
import importlib.metadata
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax

import bojax
from bojax.engine.devices import Device
from bojax.engine.groups import nodes_with

PACKAGE = Path(bojax.__file__).parent
PACKAGES = ("jax", "jaxlib", "equinox", "optax", "numpy", "pyarrow")
UNHASHED = ("api", "cli", "report")
"""Subpackages that no result depends on; they may change while a sweep is paused."""


def code_hashes(modules: Iterable[Any]) -> dict[str, str]:
    """Hashes of the package's sources, read once in a process, and of other files that define the modules.

    A module states files besides its source by `model_files`: their text, or a hash, by name. Files of one
    name share a hash.
    """
    modules = list(modules)
    hashes = {"bojax": _package_hash()}
    texts: dict[str, set[str]] = {}
    for node in (node for module in modules for node in nodes_with(module, "model_files").values()):
        for name, text in node.model_files.items():
            texts.setdefault(name, set()).add(text)
    hashes |= {name: hashlib.sha256("".join(sorted(of)).encode()).hexdigest() for name, of in texts.items()}
    for kind in sorted({kind for module in modules for kind in _classes(module)}, key=lambda k: k.__module__):
        source = getattr(sys.modules.get(kind.__module__), "__file__", None)
        if source is not None and not kind.__module__.startswith("bojax."):
            hashes[kind.__module__] = hashlib.sha256(Path(source).read_bytes()).hexdigest()
    return hashes


@functools.cache
def _package_hash() -> str:
    package = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        relative = path.relative_to(PACKAGE)
        if relative.parts[0] not in UNHASHED:
            package.update(str(relative).encode() + b"\0" + path.read_bytes())
    return package.hexdigest()


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    return {"python": sys.version.split()[0], "bojax": bojax.__version__, **installed(PACKAGES)}


@functools.cache
def installed(packages: tuple[str, ...]) -> Mapping[str, str]:
    """Versions of those packages that are installed."""
    versions = {}
    for package in packages:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[package] = importlib.metadata.version(package)
    return versions


@functools.cache
def git_revision() -> dict[str, Any] | None:
    """Revision of the package's git repository and whether it has changes; None without a repository.

    Git is asked once in a process.
    """
    status = _git("status", "--porcelain", "--", ".")
    revision = _git("rev-parse", "HEAD")
    if revision is None or status is None or _git("ls-files", "--error-unmatch", "bojax/__init__.py") is None:
        return None
    return {"revision": revision, "has_changes": bool(status)}


def device_description(devices: Sequence[Device]) -> dict[str, Any]:
    """Platform, kind, number, runtime and driver of the devices."""
    first = devices[0]
    driver = Path("/proc/driver/nvidia/version")
    return {
        "platform": first.platform,
        "kind": first.device_kind,
        "count": len(devices),
        "runtime": " ".join(first.client.platform_version.split()),
        "driver": driver.read_text().splitlines()[0] if first.platform == "gpu" and driver.exists() else None,
    }


def _git(*arguments: str) -> str | None:
    try:
        result = subprocess.run(
            ["git", *arguments], cwd=PACKAGE.parent, capture_output=True, text=True, timeout=10, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return result.stdout.strip()


def _classes(module: Any) -> set[type]:
    """Classes of all nodes of a tree of Equinox modules."""
    found: set[type] = set()

    def visit(node: Any) -> bool:
        if isinstance(node, eqx.Module):
            found.update(kind for kind in type(node).__mro__ if issubclass(kind, eqx.Module))
        return False

    jax.tree.leaves(module, is_leaf=visit)
    found.discard(eqx.Module)
    return found
