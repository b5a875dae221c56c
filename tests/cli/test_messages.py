"""Every message is one short line without control characters."""

import io
import sys

from bojax.cli.main import main
from bojax.config.errors import MAX_MESSAGE, MAX_NAMES, listed, printable

LONG = 300 * "x"
"""A name longer than any file name."""


def test_an_empty_path_is_not_the_working_directory(here, refusal):
    for words in ("run parking --out", "report", "compare --csv"):  # --out "$RESULTS", unset
        assert "got an empty name; allowed: a path" in refusal(f"{words} ''")


def test_names_that_are_too_long_for_a_file(refusal, write):
    for name in (LONG, LONG + ".yaml", 3000 * "a/" + "x.yaml"):
        assert refusal(f"run {name}")
    for command in ("sweep ", "report ", "list ", ""):
        assert refusal(command + LONG)
    for key in ("base", "alias"):
        write("s.yaml", f"{key}: {LONG}")
        assert refusal("sweep s.yaml").startswith(f"s.yaml: {key}: xxx")


def test_an_argument_holds_no_control_characters(here, refusal):
    for character in ("\x1b", "\x07", "\x9b", "\udcff"):
        assert "allowed: UTF-8 text without the character" in refusal(f"run 'parking{character}[31m'")


def test_an_override_of_any_length_and_several_lines_is_read(here, refusal):
    walls = ", ".join(40 * ["[0, 0, 1, 1]"])
    assert "problem.walls: unknown key" in refusal(f"run parking 'problem.walls=[{walls}]'")
    assert "planner.depht: unknown key" in refusal("run parking 'planner={kind: sbo,\n depht: 2}'")


def test_text_of_a_file_reaches_the_terminal_escaped(refusal, write, capsys):
    write("x.yaml", "planner: {kind: \u202esbo}")  # turns the rest of the line around
    assert r"\u202esbo" in refusal("run x.yaml")
    write("configs/mine.yaml", "title: \u202eparking")
    assert main(["list", "configs"]) == 0
    assert r"\u202eparking" in capsys.readouterr().out


def test_output_with_a_name_that_is_not_utf8(write, monkeypatch):
    def show(name, words):
        print("results/\udcff")
        return 0

    stdout = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    monkeypatch.setattr(sys, "stdout", stdout)
    monkeypatch.setattr("bojax.cli.listing.main", show)
    assert main(["list"]) == 0
    stdout.flush()
    assert stdout.buffer.getvalue() == b"results/\\udcff\n"


def test_the_middle_of_a_long_message_is_left_out():
    message = printable("first " + 1000 * "word " + "last")
    assert message.startswith("first ") and message.endswith(" last") and len(message) <= MAX_MESSAGE


def test_a_long_list_of_names_shows_the_nearest():
    names = [f"setting-{index:03d}" for index in range(200)]
    line = listed("setting-123", names, "bojax list")
    assert line.startswith("setting-123, ") and line.endswith(" and 190 more (see: bojax list)")
    assert line.count(",") == MAX_NAMES - 1
    assert listed("c", ["b", "a"]) == "a, b"
