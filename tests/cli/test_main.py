"""A mistake on the command line is one line on stderr and exit code 2, before anything heavy is imported."""

import errno
import io
import json
import os
import pty
import signal
import subprocess
import sys
import threading

import jax
import pytest

from bojax import __version__
from bojax.cli.main import COMMANDS, Messages, entry, leave, main
from tests.transcript import cases

HEAVY = ("jax", "equinox", "numpy", "pyarrow", "matplotlib", "rich", "jinja2", "shapely")


MISTAKES = """\
swep
=> unknown command swep; allowed: bench, best, compare, doctor, export, list, render, report, reproduce, run,
   status, survey, sweep, tune, worker; did you mean "sweep"?
--runs
=> unknown option --runs; allowed: bench
run parking --rnus 3
=> unknown option --rnus; did you mean "--runs"? (see: bojax run --help)
run parking --run=3
=> unknown option --run; did you mean "--runs"?
run parking --runs x
=> --runs: got x; allowed: an integer
render x --at half
=> --at: got half; allowed: a number from 0 to 1
render x --at 2
=> --at: got 2; allowed: a number from 0 to 1
run parking --runs
=> --runs: expected one argument
run parking --runs 0
=> command line: runs: got 0; allowed: >= 1
sweep parking --seed -1
=> command line: seed: got -1; allowed: >= 0
run
=> bojax run: got none; allowed: one config
sweep runs=3
=> bojax sweep: got none; allowed: one sweep or more
run a b
=> bojax run: got a, b; allowed: one config
sweep parking parking
=> bojax sweep: got parking twice; allowed: distinct sweeps
run prking
=> prking: no such file, and no such name in configs/; allowed:
report
=> the following arguments are required: DIR (see: bojax report --help)
list kcbt
=> unknown name kcbt; allowed:
doctor now
=> unknown option now (see: bojax doctor --help)
"""


def test_mistakes(here, refusal):
    deep = "run parking " + ".".join(["a"] * 5000) + "=1", "command line: a.a.a."
    for words, message in [deep, *cases(MISTAKES)]:
        assert refusal(words).startswith(message)


def test_a_working_directory_that_has_been_deleted(here, capsys):
    (here / "gone").mkdir()
    os.chdir(here / "gone")  # the fixture changes back
    (here / "gone").rmdir()
    for words in (["list"], ["run", "parking", "--out", str(here / "out")]):
        assert main(words) == 2
        assert capsys.readouterr().err.startswith("error: the working directory has been deleted ")
    assert list(here.iterdir()) == []


STANDARD_INPUT = [
    (b"base: parking", "run -", "config.yaml: is a sweep, not an experiment; start"),
    (b"planner: sbo", "sweep -", "config.yaml: base: missing; "),
    (b"planner: {iterations: 0}", "run -", "config.yaml: planner.iterations: got 0"),
    (b"", "run -", "standard input: is empty"),
    (b"\xff", "run -", "standard input: is not UTF-8 text (byte 0)"),
    (b"a: [", "run -", "standard input:1: is not YAML"),
    (b"base: parking", "sweep - -", "bojax sweep: got - twice; allowed: distinct sweeps"),
]


def test_mistakes_in_standard_input(here, refusal, monkeypatch):
    for content, words, message in STANDARD_INPUT:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(content)))
        assert refusal(words).startswith(message)


def test_a_config_is_read_from_standard_input(here, monkeypatch):
    found = []
    monkeypatch.setattr("bojax.cli.running.run", lambda sweeps, *_, **__: found.extend(sweeps) or 0)
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"{planner: sbo, runs: 3}")))
    assert main(["run", "-", "planner.depth=2"]) == 0
    (sweep,) = found
    assert (sweep.name, sweep.runs, sweep.points[0].config.planner.depth) == ("config", 3, 2)


LIGHT = [
    ("--help", 0),
    ("sweep --help", 0),
    ("list", 0),
    ("list kcbts", 0),
    ("run parking planner.depth=0", 2),
    ("sweep parking plannr=sbo", 2),
    ("sweep nothing", 2),
]


def test_nothing_heavy_is_imported_for_help_lists_and_mistakes(here):
    """In a process of its own, with the exit codes in the place of those that an import would change."""
    code = (
        "import contextlib, io, json, sys\n"
        "from bojax.cli.main import main\n"
        "codes = []\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):\n"
        f"    for words, _ in {LIGHT!r}:\n"
        "        try:\n"
        "            codes.append(main(words.split()))\n"
        "        except SystemExit as stop:\n"
        "            codes.append(stop.code or 0)\n"
        f"print(json.dumps([codes, [name for name in {HEAVY!r} if name in sys.modules]]))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(result.stdout) == [[code for _, code in LIGHT], []]


def failing(monkeypatch, raised: BaseException) -> None:
    """Let `bojax list` raise an exception."""

    def fail(name, words):
        raise raised

    monkeypatch.setattr("bojax.cli.listing.main", fail)


def test_interrupts_and_output_that_cannot_be_written_end_without_a_traceback(monkeypatch, capfd):
    monkeypatch.setattr("os.dup2", lambda *_: None)
    full = OSError(errno.ENOSPC, "No space left on device")
    for raised, code in ((KeyboardInterrupt(), 130), (BrokenPipeError(), 0), (full, 1)):
        failing(monkeypatch, raised)
        assert main(["list"]) == code
        assert ("standard output cannot be written: No space" in capfd.readouterr().err) == (code == 1)


LATE = """
import sys
import bojax.cli.running, bojax.cli.main as m
def write_report(name, words):
    print("results/parking/1", flush=True)
    sys.stdin.read()  # meanwhile, the reader of the line has left
    print("report.html", flush=True)
    open("report.html", "w").close()
    return 0
bojax.cli.running.main = write_report
sys.argv = ["bojax", "sweep", "parking"]
m.entry()
"""


def test_a_finished_sweep_whose_output_is_closed_writes_its_report(here):
    """As in `bojax sweep parking | head -1`."""
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", LATE], stdin=pipe, stdout=pipe, stderr=pipe) as process:
        assert process.stdin and process.stdout and process.stderr
        assert process.stdout.readline() == b"results/parking/1\n"
        process.stdout.close()
        process.stdin.close()
        assert (process.stderr.read(), process.wait()) == (b"", 0)
    assert (here / "report.html").exists()


SLOW_EXIT = """
import atexit, signal, sys, time
import bojax.cli.main as m
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may start background jobs that ignore it
atexit.register(time.sleep, 30.0)
atexit.register(print, "over", flush=True)
m.dispatch = lambda words: 0
sys.argv = ["bojax", "list"]
m.entry()
"""


def test_a_ctrl_c_on_exit_ends_without_a_traceback(here):
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", SLOW_EXIT], stdout=pipe, stderr=pipe) as process:
        assert process.stdout and process.stderr
        assert process.stdout.readline() == b"over\n"
        process.send_signal(signal.SIGINT)
        assert (process.stderr.read(), process.wait()) == (b"", -signal.SIGINT)


def test_a_terminal_that_was_closed_reads_no_more():
    """As under `nohup bojax ...` in a terminal that is closed."""
    ours, theirs = pty.openpty()
    os.close(ours)
    done = subprocess.run([sys.executable, "-m", "bojax", "--version"], stdout=theirs, stderr=subprocess.PIPE)
    os.close(theirs)
    assert (done.returncode, done.stderr) == (0, b"")


def test_output_on_a_full_disk_is_an_error_once_the_results_are_written(monkeypatch, capsys):
    monkeypatch.setattr("bojax.cli.running.main", lambda *_: print("results") or 0)
    monkeypatch.setattr("os.dup2", lambda *_: None)
    monkeypatch.setattr("sys.stdout", FullDisk())
    monkeypatch.setattr(FullDisk, "fileno", lambda _: 1)
    assert main(["sweep"]) == 1
    message = "error: standard output cannot be written: No space left on device\n"
    assert capsys.readouterr().err == message


def test_no_file_takes_the_place_of_a_closed_stream(here):
    code = "import os, bojax.cli.main as m; m.main = lambda: os.open('results', os.O_CREAT); m.entry()"
    command = ["sh", "-c", 'exec "$0" -c "$1" >&- 2>&- <&-', sys.executable, code]
    assert subprocess.run(command, check=False).returncode > 2


def test_an_unexpected_exception_and_an_error_of_a_named_file_keep_their_tracebacks(monkeypatch):
    for error in (RuntimeError("a file"), OSError(errno.ENOSPC, "No space left on device", "a file")):
        failing(monkeypatch, error)
        with pytest.raises(type(error), match="a file"):
            main(["list"])


def test_messages_that_cannot_be_written_are_left_out():
    """As where standard error is a log on a full disk."""
    messages = Messages(FullDisk())
    print("a message", file=messages, flush=True)
    assert messages.error is not None and not messages.isatty()
    kept = io.StringIO()
    print("a message", file=Messages(kept), flush=True)
    assert kept.getvalue() == "a message\n"


def test_help_has_examples(capsys):
    assert main([]) == main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"\n  {name} " in out for name in COMMANDS)
    assert "launcher" not in out


def test_every_command_has_help_with_examples(capsys):
    for name in COMMANDS:
        with pytest.raises(SystemExit) as stop:
            main([name, "--help"])
        out = capsys.readouterr().out
        assert stop.value.code == 0
        assert out.startswith(f"usage: bojax {name}") and f"examples:\n  bojax {name}" in out
        assert max(len(line) for line in out.splitlines()) <= 110


def test_an_unexpected_exception_while_a_program_is_compiled(monkeypatch, capsys):
    """Python cannot end while a thread is in XLA, and would abort."""
    codes = []
    monkeypatch.setattr("bojax.cli.main.main", lambda: 1 // 0)
    monkeypatch.setattr("bojax.cli.main.leave", codes.append)
    entry()
    err = capsys.readouterr().err
    assert codes == [1] and "Traceback" in err and "ZeroDivisionError" in err.splitlines()[-1]


def test_figures_do_not_depend_on_the_backend_and_the_settings_of_a_notebook(here):
    """`!bojax ...` in Jupyter inherits a backend of the kernel, which the environment of bojax may lack."""
    (here / "settings").write_bytes(bytes(range(256)))
    given = {"MPLBACKEND": "module://of_the_kernel.backend_inline", "MATPLOTLIBRC": str(here / "settings")}
    command = [sys.executable, "-m", "bojax", "report", "nowhere"]
    ended = subprocess.run(command, env={**os.environ, **given}, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1), ended.stderr
    assert ended.stderr.startswith("error: nowhere: ")


def test_windows_is_refused_in_one_line(here, refusal, monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    assert refusal("list") == "bojax runs on Linux and macOS; on Windows, use WSL"


def test_memory_of_a_gpu_is_taken_as_needed_unless_the_user_chose(monkeypatch, capsys):
    preallocate, allocator = "XLA_PYTHON_CLIENT_PREALLOCATE", "XLA_PYTHON_CLIENT_ALLOCATOR"
    for given, chosen in (
        ({}, {preallocate: "false", allocator: "cuda_async"}),
        ({preallocate: "true"}, {preallocate: "true"}),
        ({allocator: "platform"}, {allocator: "platform"}),
    ):
        monkeypatch.setattr("os.environ", environment := dict(given))
        assert main(["--version"]) == 0
        assert environment == {**chosen, "OPENBLAS_NUM_THREADS": "1"}
        assert capsys.readouterr().out == f"bojax {__version__}\n"


class FullDisk(io.StringIO):
    """A stream that cannot be written."""

    def flush(self):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_process_that_has_imported_jax_leaves_without_pythons_clean_up(monkeypatch):
    """The functions of atexit are called unless XLA may still compile in a thread."""
    made: list[object] = []
    monkeypatch.setattr("atexit._run_exitfuncs", lambda: made.append("atexit"))
    monkeypatch.setattr("os._exit", made.append)
    monkeypatch.setattr("signal.signal", lambda *_: None)  # else a later SIGINT would end this process
    monkeypatch.setitem(sys.modules, "jax", jax)
    compiling, of_the_user = threading.Thread(daemon=True), threading.Thread(daemon=False)
    for others, output, expected in (
        ([], sys.stdout, ["atexit", 3]),
        ([compiling], sys.stdout, [3]),
        ([of_the_user], sys.stdout, []),
        ([], None, ["atexit", 3]),  # bojax ... >&-
        ([], FullDisk(), ["atexit"]),
    ):
        threads = [threading.current_thread(), *others]
        monkeypatch.setattr("threading.enumerate", lambda threads=threads: threads)
        monkeypatch.setattr("sys.stdout", output)
        with pytest.raises(SystemExit):  # the process would have ended
            leave(3)
        assert made == expected
        made.clear()
