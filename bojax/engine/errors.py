"""What the engine cannot go on from, in one line, with its exit code."""

INPUT_ERROR = 2
FAILURE = 1


class EngineError(Exception):
    """A failure that the user can do something about.

    Attributes:
        exit_code: 2 where the input is to be mended, 1 where the machine or an experiment failed.
    """

    def __init__(self, message: str, exit_code: int = INPUT_ERROR):
        super().__init__(message)
        self.exit_code = exit_code


def out_of_memory(error: BaseException, lanes_per_device: int) -> EngineError | None:
    """The one line for a device that ran out of memory; None if `error` is something else."""
    text = str(error)
    if "RESOURCE_EXHAUSTED" not in text and "Out of memory" not in text:
        return None
    smaller = max(1, lanes_per_device // 2)
    return EngineError(
        f"out of device memory at {lanes_per_device} lanes per device: "
        f"try engine.lanes_per_device={smaller} and a new --out",
        FAILURE,
    )
