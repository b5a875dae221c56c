"""Sweeps killed at random moments and resumed: the results are those of a sweep that was never killed."""

import functools
import random
import signal
from collections.abc import Callable
from pathlib import Path

from benchmarks.campaign import tripwire
from benchmarks.campaign.case import Outcome, fault_of
from benchmarks.campaign.process import ChildResult, run, scratch
from benchmarks.campaign.workloads import WORKLOADS, Workload, duration, finished, resumed

_WORKLOADS = ("toy", "toy", "toy", "tabular", "planning", "monitoring", "learner", "hosted")
_SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
_MOST_KILLS = 3

Wire = Callable[[int | None, int, str], tripwire.Counter]

_WIRES: dict[str, Wire] = {
    "line": tripwire.at_line,
    "operation on files": tripwire.at_file,
}


def check(seed: int) -> Outcome:
    """Kill a sweep, and most often its resumption too, at moments that follow from the seed."""
    draw = random.Random(f"kills {seed}")
    workload = WORKLOADS[draw.choice(_WORKLOADS)]
    tried = workload.name
    with scratch() as place:
        out = place / "out"
        for attempt in range(draw.randint(1, _MOST_KILLS)):
            number = draw.choice(_SIGNALS)
            ended, moment = _killed(draw, workload, number, out, place, resume=attempt > 0)
            tried += f", {signal.Signals(number).name} {moment}"
            allowed = (0, -number, 128 + number, 130)
            if fault := fault_of(ended, allowed):
                return Outcome(tried, fault)
            if ended.code == 0:
                break
        return Outcome(tried, resumed(workload.name, out, place))


def _killed(
    draw: random.Random, workload: Workload, number: int, out: Path, place: Path, *, resume: bool
) -> tuple[ChildResult, str]:
    """The end of a sweep that a signal reached, and when that was, in words."""
    start = workload.start(out, resume=resume)
    how = draw.choice(["time", *_WIRES])
    if how == "time":
        is_fresh = bool(workload.words) and draw.random() < 0.3
        # Before half a second is over it is Python that starts, not bojax.
        delay = draw.uniform(0.5 if is_fresh else 0.0, duration(workload.name))
        signals = [(delay, number)]
        if number != signal.SIGKILL and draw.random() < 0.2:
            signals.append((delay + draw.uniform(0.0, 0.5), number))
        if is_fresh:
            start = workload.start_afresh(out, resume=resume)
        ended = run(start, place, signals=signals)
        where = "in a new process " if is_fresh else ""
        return ended, f"{where}after {' and '.join(f'{delay:.2f}' for delay, _ in signals)} s"
    # Resumed, a sweep has fewer of them: late moments may not come any more.
    at = draw.randrange(_count(workload.name, how))

    def with_wire() -> int:
        _WIRES[how](at, number, str(out))
        return start()

    return run(with_wire, place), f"at {how} {at}"


@functools.cache
def _count(name: str, how: str) -> int:
    """How many events of a kind an uninterrupted run of a workload has."""
    with scratch() as place:

        def count() -> int:
            counter = _WIRES[how](None, 0, str(place / "out"))
            code = WORKLOADS[name].start(place / "out")()
            (place / "count").write_text(str(counter.count))
            return code

        finished(name)
        ended = run(count, place)
        assert ended.code == 0, ended.err
        return int((place / "count").read_text())
