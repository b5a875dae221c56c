"""Values and exceptions as text on one line."""

from bojax.text import MAX_ERROR, error_line, one_line


def test_text_is_on_one_line_and_cut_off():
    assert one_line(ValueError("  first\n\tsecond\r\n third ")) == "first second third"
    assert error_line(KeyError("planner")) == "KeyError: 'planner'"
    assert error_line(RuntimeError("first\nsecond")) == "RuntimeError: first second"
    assert error_line(TimeoutError()) == "TimeoutError"
    line = error_line(RuntimeError("x" * 1000))
    assert line == "RuntimeError: " + "x" * (MAX_ERROR - 3) + "..."
