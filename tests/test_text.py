"""Values and exceptions as text on one line."""

from bojax.text import MAX_ERROR, error_line, one_line


def test_white_space_becomes_single_spaces():
    assert one_line(ValueError("  first\n\tsecond\r\n third ")) == "first second third"


def test_an_exception_is_its_type_and_message():
    assert error_line(KeyError("planner")) == "KeyError: 'planner'"
    assert error_line(RuntimeError("first\nsecond")) == "RuntimeError: first second"
    assert error_line(TimeoutError()) == "TimeoutError"


def test_a_long_message_is_cut_off():
    line = error_line(RuntimeError("x" * 1000))
    assert line == "RuntimeError: " + "x" * (MAX_ERROR - 3) + "..."
