"""`bojax doctor`: checks of the installation, with one line per finding."""

import importlib.metadata
import importlib.util
import io
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bojax import __version__
from bojax.cli.parser import Parser
from bojax.config.extras import OPTIONAL, how_to_install
from bojax.errors import UserError
from bojax.text import error_line

_EXAMPLES = """\
  bojax doctor                      all checks
  JAX_PLATFORMS=cpu bojax doctor    the same without the GPU
"""

_PACKAGES = """\
jax jaxlib equinox jaxtyping optax orbax-checkpoint mujoco mujoco-mjx brax numpy scipy pyarrow pydantic PyYAML
rich matplotlib jinja2
"""


@dataclass(frozen=True)
class Finding:
    """A result of a check."""

    state: str  # "ok", "note" for a limitation, "FAILED" for an error
    text: str  # description, one line


class Failure(UserError):
    """A failed check; the message says what failed and how to correct it."""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command; the exit code is 1 if a check failed."""
    about = "Check versions, optional packages, devices, precision, folders and films."
    Parser(name, "", about, _EXAMPLES).read(words)
    findings = []
    for title, check in CHECKS.items():
        for finding in examine(check):
            findings.append(finding)
            print(f"{finding.state:<6}  {title:<12}  {finding.text}", flush=True)
    failed = sum(finding.state == "FAILED" for finding in findings)
    print(f"\n{failed} of {len(findings)} checks failed" if failed else "\nall checks passed")
    return 1 if failed else 0


def examine(check: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """The findings of a check; an exception becomes a failure."""
    try:
        yield from check()
    except Exception as error:
        yield Finding("FAILED", str(error) if isinstance(error, UserError) else error_line(error))


def _python() -> Iterator[Finding]:
    yield Finding("ok", f"{platform.python_version()}, {platform.system()} {platform.machine()}")
    yield Finding("ok", f"bojax {__version__}")


def _packages() -> Iterator[Finding]:
    found, missing = [], []
    for package in _PACKAGES.split():
        try:
            found.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(package)
    yield Finding("ok", ", ".join(found))
    if missing:
        raise Failure(f"not installed: {', '.join(missing)}; reinstall bojax")


def _extras() -> Iterator[Finding]:
    """Optional packages; the extras for a GPU are the subject of `devices`."""
    found, missing = [], []
    for extra, (module, purpose) in OPTIONAL.items():
        if importlib.util.find_spec(module):
            found.append(f"{extra} ({purpose})")
        else:
            missing.append(f"{purpose}: {module} is not installed; {how_to_install(extra)}")
    if found:
        yield Finding("ok", ", ".join(found))
    yield from (Finding("note", text) for text in missing)


def _devices() -> Iterator[Finding]:
    import jax

    from bojax.engine.devices import prepare

    prepare("auto")
    for platform_name in sorted({device.platform for device in jax.devices()}):
        devices = [device for device in jax.devices() if device.platform == platform_name]
        yield Finding("ok", f"{len(devices)} x {platform_name} ({devices[0].device_kind})")
    if jax.default_backend() == "cpu" and Path("/proc/driver/nvidia/version").exists():
        lacks = "there is an NVIDIA driver, but JAX finds no GPU"
        yield Finding("note", f"{lacks}; {how_to_install('cuda13')} (or cuda12)")


def _computation() -> Iterator[Finding]:
    import jax
    import jax.numpy as jnp

    start = time.perf_counter()
    value = jax.jit(lambda x: jnp.sum(x * x))(jnp.linspace(0.0, 1.0, 11))
    if value.dtype != jnp.float64:
        raise Failure("float64 is disabled; unset JAX_ENABLE_X64")
    if abs(float(value) - 3.85) > 1e-12:
        raise Failure(f"a compiled sum is {float(value)} instead of 3.85")
    yield Finding("ok", f"float64; compiled and ran a program in {time.perf_counter() - start:.1f} s")


def _cache() -> Iterator[Finding]:
    from bojax.engine.devices import cache_folder, setting, why_not_private
    from bojax.numerics.disk_cache import folder_of

    folder = setting("jax_compilation_cache_dir")
    reason = why_not_private(Path(folder) if folder else cache_folder())
    if folder and reason is not None:
        yield Finding("note", f"{folder}: JAX runs the programs in this folder although {reason}")
    if not folder or folder_of("programs") is None:
        why = f"{cache_folder()}: {reason}" if not folder and reason else "turned off"
        yield Finding("note", f"programs are not cached, every process compiles all of them ({why})")
        return
    _write_in(Path(folder))
    yield Finding("ok", f"programs are cached in {folder}")


def _tables() -> Iterator[Finding]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"x": [1]}), buffer := io.BytesIO())
    yield Finding("ok", f"wrote Parquet, {len(buffer.getvalue())} bytes")


def _figures() -> Iterator[Finding]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    FigureCanvasAgg(Figure()).print_png(buffer := io.BytesIO())
    yield Finding("ok", f"drew a PNG, {len(buffer.getvalue())} bytes")


def _films() -> Iterator[Finding]:
    from matplotlib.animation import FFMpegWriter

    from bojax.films.rendering import BACKENDS, CannotDraw, backend

    has_mp4 = FFMpegWriter.isAvailable()
    yield Finding("ok", "GIF and MP4") if has_mp4 else Finding("note", "GIF only; MP4 needs ffmpeg")
    try:
        name = backend() or "its default backend"
    except CannotDraw as error:
        yield Finding("note", str(error))
        return
    yield Finding("ok", f"robots: MuJoCo draws with {name.upper() if name in BACKENDS else name}")


def _results() -> Iterator[Finding]:
    folder = Path("results")
    _write_in(folder if folder.exists() else Path.cwd())
    yield Finding("ok", f"{folder.resolve()} is writable")


def _write_in(folder: Path) -> None:
    """Raise a `Failure` if a file cannot be created in a folder, or in its nearest existing parent."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.NamedTemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise Failure(f"{folder}: cannot be written: {error.strerror}") from error


CHECKS: dict[str, Callable[[], Iterator[Finding]]] = {
    "Python": _python,
    "packages": _packages,
    "extras": _extras,
    "devices": _devices,
    "precision": _computation,
    "cache": _cache,
    "tables": _tables,
    "figures": _figures,
    "films": _films,
    "results": _results,
}
"""The checks, in order; `precision` and `cache` require that `devices` has configured JAX."""
