"""What a benchmark compares with: libraries that may be missing, and the ratios to those that are there."""

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from timing import Row

Loader = Callable[[], Any]


def installed(peers: Mapping[str, tuple[str, Loader]]) -> dict[str, Any]:
    """What the loaders of the installed peers return; a line says which are not installed.

    Args:
        peers: For each name, the module that it needs, and its loader.
    """
    missing = [name for name, (module, _) in peers.items() if importlib.util.find_spec(module) is None]
    if missing:
        print(f"not installed, and left out: {', '.join(missing)} (pip install -e '.[bench]')")
    return {name: load() for name, (_, load) in peers.items() if name not in missing}


def print_ratios(rows: Sequence[Row], aims: Mapping[str, float]) -> None:
    """How many times the rate of each peer bojax reaches, the best of their rows each.

    Args:
        rows: Rows that are named after the peer, with a comma before what they add.
        aims: The ratio that is aimed at, for peers that have one.
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
