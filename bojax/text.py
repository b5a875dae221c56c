"""Values, exceptions and durations as text on one line, for messages."""

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


def duration(seconds: float) -> str:
    """A time span, such as 3 h 05 min, 2 min 10 s or 7 s."""
    minutes, seconds = divmod(int(seconds + 0.5), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"
