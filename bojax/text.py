"""Values, exceptions and durations as text on one line, for messages."""

import traceback
from pathlib import Path

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


def error_at_line(error: BaseException) -> str:
    """An exception on one line, with the file and the line where it was raised.

    If bojax or an installed package raised it, the line is the last one outside of them, which called it.
    """
    place = place_of(error)
    if not place or isinstance(error, SyntaxError):  # the message of a SyntaxError names the line
        return error_line(error)
    return f"{error_line(error)} ({place})"


def place_of(error: BaseException) -> str:
    """The file and the line where an exception was raised, as in `error_at_line`; empty if it was not."""
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return ""
    own = [frame for frame in frames if _is_own(frame.filename)]
    at = (own or frames)[-1]
    return f"{Path(at.filename).name}, line {at.lineno}"


def _is_own(file: str) -> bool:
    """Whether code is a user's, not of bojax, an installed package, or Python's import system."""
    path = Path(file)
    is_foreign = "site-packages" in path.parts or file.startswith("<frozen ")
    return not (is_foreign or path.is_relative_to(Path(__file__).parent))


def duration(seconds: float) -> str:
    """A time span, such as 3 h 05 min, 2 min 10 s or 7 s."""
    minutes, seconds = divmod(int(seconds + 0.5), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"
