"""Peers of a benchmark: libraries that may not be installed, and the ratios of their rates."""

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from timing import Row

Loader = Callable[[], Any]


def installed(peers: Mapping[str, tuple[str, Loader]]) -> dict[str, Any]:
    """Load the installed peers, and print which are not installed.

    Args:
        peers: For each name of a peer, the module that it needs and its loader.
    """
    missing = [name for name, (module, _) in peers.items() if importlib.util.find_spec(module) is None]
    if missing:
        print(f"skipped, since not installed: {', '.join(missing)} (pip install -e '.[bench]')")
    return {name: load() for name, (_, load) in peers.items() if name not in missing}


def print_ratios(rows: Sequence[Row], aims: Mapping[str, float]) -> None:
    """Print the rate of bojax as a multiple of each peer's rate, comparing the best row of each.

    Args:
        rows: Rows named after a peer, optionally followed by a comma and details.
        aims: The target ratio, for peers that have one.
    """
    best: dict[str, Row] = {}
    for row in rows:
        name = row.what.split(",")[0]
        if name not in best or row.rate > best[name].rate:
            best[name] = row
    ours = best.pop("bojax")
    for name, row in best.items():
        aim = f" (aim: {aims[name]:g})" if name in aims else ""
        print(f"{ours.what}: {ours.rate / row.rate:.2f} times as fast as {row.what}{aim}")
