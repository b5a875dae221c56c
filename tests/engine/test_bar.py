"""A bar in a notebook is updated in place; another process reads JSON."""

import io
import json
import sys
from types import SimpleNamespace

from rich.console import Console

from bojax.engine.bar import PROGRESS, Bar


def test_a_notebook_shows_one_bar_and_updates_it(monkeypatch):
    shown = []

    def display(content, *, raw, display_id):
        assert raw and display_id
        shown.append(content)
        return SimpleNamespace(update=lambda content, raw: shown.append(content))

    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    with Bar("a <b>", 4, Console(file=io.StringIO(), force_jupyter=True)) as bar:
        assert bar.is_live
        bar.show(3, "3/4 runs")
    assert [each["text/plain"] for each in shown] == ["a <b>: ", "a <b>: 3/4 runs"]
    assert '<progress value="3" max="4"' in shown[1]["text/html"] and "<b>" not in shown[1]["text/html"]


def test_another_process_reads_json(monkeypatch, capsys):
    monkeypatch.setenv(PROGRESS, "json")
    with Bar("toy", 4, Console(stderr=True)) as bar:
        assert not bar.is_live
        bar.say("compiling ...")
        bar.show(3, "3/4 runs")
    message, event = capsys.readouterr().err.splitlines()
    assert message == "compiling ..."
    assert json.loads(event) == {"title": "toy", "done": 3, "total": 4, "text": "3/4 runs"}


def test_a_quiet_console_shows_nothing(monkeypatch, capsys):
    monkeypatch.setenv(PROGRESS, "json")
    Bar("toy", 4, Console(quiet=True)).show(1, "")
    assert capsys.readouterr() == ("", "")
