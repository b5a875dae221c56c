"""Strict settings for every test: promotions raise, keys are used once, shapes are checked."""

import contextlib
import ctypes
import gc
import os
import resource
import shlex
import signal
from collections import Counter
from pathlib import Path

if os.environ.setdefault("JAX_PLATFORMS", "cpu") == "cuda":
    os.environ["JAX_PLATFORMS"] = "cuda,cpu"  # what takes several devices is tested on the CPU there too
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may start background jobs that ignore it
os.environ.setdefault("BOJAX_CACHE", str(Path(__file__).parents[1] / ".pytest_cache" / "jax"))

from tests.compiling import COMPILATION, quick_flags  # noqa: E402

given = os.environ.get("XLA_FLAGS", "").split()
os.environ["XLA_FLAGS"] = " ".join(dict.fromkeys([*quick_flags(), *given]))

import jax  # noqa: E402
import pytest  # noqa: E402
from jaxtyping import install_import_hook  # noqa: E402

import tests.strict  # noqa: E402, F401

CHECKED = (
    "numerics",
    "models",
    "acquisition",
    "motions",
    "problems",
    "planning",
    "envs",
    "learning",
    "experiments",
    "engine",
)
"""Packages whose annotations, shapes included, are checked at every call."""

install_import_hook([f"bojax.{package}" for package in CHECKED], "beartype.beartype")

from bojax.cli.main import YOUNG_OBJECTS, main  # noqa: E402
from bojax.config.errors import MAX_MESSAGE  # noqa: E402
from tests.parts import FILES  # noqa: E402

gc.set_threshold(YOUNG_OBJECTS)

_USUAL = {
    "jax_debug_key_reuse": False,
    "jax_enable_x64": False,
    "jax_numpy_dtype_promotion": "standard",
    "jax_numpy_rank_promotion": "allow",
}
"""JAX's defaults of settings that differ here."""


@pytest.fixture
def usual_jax():
    """JAX with its default settings, as when a user's process begins."""
    strict = {flag: getattr(jax.config, flag) for flag in _USUAL}
    for flag, value in _USUAL.items():
        jax.config.update(flag, value)
    yield
    for flag, value in strict.items():
        jax.config.update(flag, value)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def write(here):
    """Writes a file below an empty working directory."""

    def write_file(name: str, text: str) -> Path:
        path = here / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write_file


@pytest.fixture
def data_files(here):
    """The data files of the parts that need some, in an empty working directory."""
    for name, text in FILES.items():
        (here / name).write_text(text)


@pytest.fixture
def refusal(capsys):
    """A function that runs a command which must refuse its input, and returns the message of the error.

    Its line, short and without control characters, is all that is printed, and the files in the working
    directory stay as they are.
    """

    def files() -> list[Path]:
        return [] if Path.cwd() == Path(__file__).parents[1] else sorted(Path().rglob("*"))

    def run(command: str, code: int = 2) -> str:
        capsys.readouterr()
        before = files()
        assert main(shlex.split(command)) == code, command
        out, err = capsys.readouterr()
        assert (out, err.count("\n"), files()) == ("", 1, before) and err.startswith("error: "), err
        line = err.removesuffix("\n")
        assert line.isprintable() and len(line) <= MAX_MESSAGE
        return line.removeprefix("error: ")

    return run


_UNDRAWN = {"api", "claims", "cli", "engine", "experiments", "films", "problems", "tuning"}
_UNDRAWN |= {"test_comparing.py", "test_damage.py", "test_logs.py", "test_manifest.py", "test_ranking.py"}
"""Folders and files whose tests do not look at figures."""


@pytest.fixture
def blank_figures():
    """Figures are made, and encoded as empty ones, which takes a third of a second less for each."""
    with _blank_figures():
        yield


@pytest.fixture(autouse=True, scope="module")
def undrawn(request):
    """The figures of tests that do not look at them are blank."""
    is_undrawn = {request.path.name, request.path.parent.name} & _UNDRAWN
    with _blank_figures() if is_undrawn else contextlib.nullcontext():
        yield


@contextlib.contextmanager
def _blank_figures():
    from matplotlib.figure import Figure

    from bojax.report import style

    blank = style.encode(Figure(figsize=(1, 1)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "encode", lambda _: blank)
        yield


_programs: Counter[str] = Counter()
"""Programs compiled or read from the cache by each test file: a cost that is the same on every machine."""

_memory: list[int] = []
"""Most memory of each worker, in KiB."""

_file = ["collection"]
"""The file whose tests are running."""


def _count(event, *_, **__):
    if event == COMPILATION:
        _programs[_file[0]] += 1


jax.monitoring.register_event_duration_secs_listener(_count)


def pytest_collection_finish():
    """Leave what has been imported, millions of objects that stay, out of later collections of garbage."""
    gc.collect()
    gc.freeze()


def pytest_runtest_logstart(location):
    _file[0] = location[0]


def pytest_report_teststatus(report):
    """Name each failure at once: a run that is stopped prints no summary."""
    if report.failed:
        status, letter = ("failed", "F") if report.when == "call" else ("error", "E")
        return status, f"\n{letter} {report.nodeid}\n", status.upper()


def pytest_sessionfinish(session):
    if hasattr(session.config, "workeroutput"):  # of a worker of pytest-xdist, for the next hook
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        session.config.workeroutput.update(programs=dict(_programs), memory=memory)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    output = getattr(node, "workeroutput", {})
    _programs.update(output.get("programs", {}))
    _memory.append(output.get("memory", 0))


def pytest_terminal_summary(terminalreporter):
    """Say in continuous integration how many programs were compiled, and how much memory workers took."""
    if os.environ.get("CI"):
        most = ", ".join(f"{file} {number}" for file, number in _programs.most_common(5))
        terminalreporter.write_line(f"programs compiled: {_programs.total()}; most by {most}")
        sizes = ", ".join(f"{size / 1024**2:.2f}" for size in sorted(_memory))
        terminalreporter.write_line(f"most memory of the workers, GiB: {sizes}")


def _most_memory() -> int:
    """KiB of a worker after which compiled programs are dropped, 5 GB at most.

    The workers together take half of the machine's memory, unless that is less than they need.
    """
    machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 1024
    own = machine // 2 // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    return min(max(2_500_000, own), 5_000_000)


_MOST_MAPS = 50_000
"""Memory mappings after which they are; Linux ends a process that wants 65,530 of them."""


@pytest.fixture(autouse=True, scope="module")
def drop_programs():
    """Bound what a worker keeps: the suite compiles some thousands of programs."""
    yield
    status, maps = Path("/proc/self/status"), Path("/proc/self/maps")
    if not status.exists():
        return
    (memory,) = [line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmRSS")]
    if int(memory) > _most_memory() or len(maps.read_bytes().splitlines()) > _MOST_MAPS:
        jax.clear_caches()
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
