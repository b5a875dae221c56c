"""The latency of a single run: the time of one advance (a plan, or an episode) without a batch.

It is measured for the first point of each variant of a sweep. In a results folder the times are also written
to `latency.json`, which claims of kind `latency` read.
"""

import argparse
import itertools
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from bojax.config.sweep import load_sweep
from bojax.engine.batch import run_key
from bojax.engine.build import build
from bojax.engine.devices import Device, find_devices, prepare, suited
from bojax.engine.provenance import device_description, versions
from bojax.experiments.base import Experiment
from bojax.report.source import LATENCY, Results, load
from bojax.results.store import MANIFEST, write_json

NUM_ADVANCES = 8
"""Number of advances that are timed.

The least and the largest of n times contain the true median with a probability of 1 - 2^-(n-1): 99% for 8.
"""

EXAMPLES = """\
  bojax bench latency                           the sweeps of the thesis that claim a time
  bojax bench latency parking                   a sweep
  bojax bench latency results/table-4.1-times   a results folder; then `bojax report` judges its claims
"""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    args = parse(argv)
    prepare(args.device)
    devices = find_devices(args.device)
    for name in args.sweeps:
        folder = Path(name)
        results = load(folder) if (folder / MANIFEST).exists() else None
        times, used = measure(results, name, devices)
        if results is not None:
            content = {
                "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                "config_hash": results.manifest.config_hash,
                "device": device_description([used]),
                "versions": versions(),
                "seconds": times,
            }
            write_json(folder / LATENCY, content)
            print(f"{folder / LATENCY}; to judge claims: bojax report {folder}")
    return 0


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The arguments of the benchmark."""
    parser = argparse.ArgumentParser(
        prog="bojax bench latency",
        description=(__doc__ or "").split("\n")[0],
        epilog=f"examples:\n{EXAMPLES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    sweeps = ["fig-3.7-time", "table-4.1-times"]
    parser.add_argument("sweeps", nargs="*", default=sweeps, metavar="SWEEP", help="sweep or results folder")
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto", help="where bojax runs")
    return parser.parse_args(argv)


def measure(
    results: Results | None, sweep: str, devices: Sequence[Device]
) -> tuple[dict[str, list[float]], Device]:
    """Median, least and largest seconds of an advance by point, and the device.

    Args:
        results: The results whose points are measured; None for those of a sweep.
        sweep: Name or file of the sweep.
        devices: The devices to choose from.
    """
    points = load_sweep(sweep).points if results is None else results.points
    firsts = {(point.label, point.variant): i for i, point in reversed(list(enumerate(points)))}
    modules = {}
    for i in sorted(firsts.values()):
        if results is not None:
            results.require_settings(results.points[i])
        settings = getattr(points[i], "config" if results is None else "experiment")
        modules[i] = build(settings, getattr(settings, "dtype", "float64"))
    device, times = suited(devices)[0], {}
    for i, module in modules.items():
        if module.is_hosted:
            print(f"{sweep}: {points[i].variant}: not measured, its environment steps on the host")
            continue
        seconds = seconds_of_advances(module, device)
        median, least, largest = np.median(seconds), min(seconds), max(seconds)
        found = f"{median:.4g} s [{least:.4g}, {largest:.4g}] on a {device.device_kind}"
        print(f"{sweep}: {points[i].variant}: {found}")
        times[str(points[i].index)] = [float(median), least, largest]
    return times, device


def seconds_of_advances(experiment: Experiment, device: Device) -> list[float]:
    """Seconds of advances of single runs, one after the other.

    Once a run is done, the next run starts: advances of a finished run do nothing and are not timed.
    """
    arrays, static = eqx.partition(experiment, eqx.is_array)
    leaves, structure = jax.tree.flatten(jax.device_put((jax.random.key(0), arrays), device))

    def init(run, *leaves):
        key, arrays = jax.tree.unflatten(structure, leaves)
        return eqx.combine(arrays, static).init(run_key(key, run))

    def advance(carry, *leaves):
        experiment = eqx.combine(jax.tree.unflatten(structure, leaves)[1], static)
        carry, records = experiment.advance(jax.tree.unflatten(of_carry, carry))
        # Leaves in place of trees: to flatten the modules at every call takes longer than a short advance.
        return jax.tree.leaves(carry), jax.tree.leaves(records), experiment.is_done(carry)

    of_carry = jax.tree.structure(jax.eval_shape(init, np.int32(0), *leaves))
    start = jax.jit(lambda *inputs: jax.tree.leaves(init(*inputs)))
    compiled, carry, seconds, runs, is_done = (
        jax.jit(advance, donate_argnums=0),
        [],
        [],
        itertools.count(),
        True,
    )
    while len(seconds) <= NUM_ADVANCES:
        if is_done:
            carry = jax.block_until_ready(start(np.int32(next(runs)), *leaves))
        before = time.perf_counter()
        carry, _, done = jax.block_until_ready(compiled(carry, *leaves))
        seconds.append(time.perf_counter() - before)
        is_done = bool(done)
    return seconds[1:]  # the first call compiles


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
