"""Values and exceptions as text on one line, for error messages."""

MAX_ERROR = 300
"""Longest message of a foreign exception that is quoted, in characters."""


def one_line(value: object) -> str:
    """The text of a value or an exception, with line breaks and runs of white space as single spaces."""
    return " ".join(str(value).split())


def error_line(error: BaseException) -> str:
    """The type and the message of an exception on one line; a long message is cut off."""
    name, message = type(error).__name__, one_line(error)
    if len(message) > MAX_ERROR:
        message = message[: MAX_ERROR - 3] + "..."
    return f"{name}: {message}" if message else name
