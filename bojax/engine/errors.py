"""Errors of the engine: a message of one line and an exit code."""

INPUT_ERROR = 2
FAILURE = 1


class EngineError(Exception):
    """A failure that the user can act on.

    Attributes:
        exit_code: 2 if the input must be corrected, 1 if the machine or an experiment failed.
    """

    def __init__(self, message: str, exit_code: int = INPUT_ERROR):
        super().__init__(message)
        self.exit_code = exit_code


class Stopped(Exception):
    """A stop was requested before a program was compiled."""


def out_of_memory(error: BaseException, lanes_per_device: int) -> EngineError | None:
    """The error to report for a device that ran out of memory; None if `error` has another cause."""
    text = str(error)
    if "RESOURCE_EXHAUSTED" not in text and "Out of memory" not in text:
        return None
    smaller = max(1, lanes_per_device // 2)
    return EngineError(
        f"out of device memory at {lanes_per_device} lanes per device: "
        f"try engine.lanes_per_device={smaller} and a new --out",
        FAILURE,
    )
