"""Errors of the engine."""

from bojax.errors import FAILURE, UserError


class EngineError(UserError):
    """The machine cannot run a sweep as it is asked to, or an experiment failed."""


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
