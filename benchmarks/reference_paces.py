"""Makes the file of what groups of runs take on reference machines, for the forecast of the time left.

Reads the manifests of results folders. Of several experiments of the same kind, the geometric mean of the
compilations counts, without those that were so short that the programs came from the cache, and of several
of the same size, the mean of all runs. Kinds and sizes that the folders lack stay in the file. Give no sweeps
that ran on the CPU of a machine with a GPU: that is another reference machine.
"""

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import gmean

from bojax.engine.paces import REFERENCE, cost_of_run, kind_and_size
from bojax.results.store import MANIFEST

CACHED = 0.25
"""A compilation that takes less than this share of the longest one of its kind, or of that in the file, was
none."""

EXAMPLES = """\
  BOJAX_CACHE=/tmp/new bojax reproduce all --out results/cpu
  python benchmarks/reference_paces.py results/cpu/*
"""


def main(argv: Sequence[str]) -> int:
    """Write the file."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n")[0],
        epilog=f"examples:\n{EXAMPLES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="results folders")
    args = parser.parse_args(argv)
    compilations, runs = defaultdict(list), defaultdict(list)
    for folder in args.folders:
        manifest = json.loads((folder / MANIFEST).read_text())
        platform = manifest["device"]["platform"]
        for group, layout in zip(manifest["groups"], manifest["plan"]["layouts"], strict=True):
            lanes, number = layout["widths"][0], len(group["points"]) * manifest["runs"]
            paces = group["paces"]
            if not all(paces.get(name) for name in ("compilation", "run")):
                continue
            kind, size = kind_and_size(manifest["points"][group["points"][0]]["config"])
            compilations[platform, kind].append(paces["compilation"])
            cost = cost_of_run(platform, lanes, layout["queue"])
            runs[platform, kind, size].append((paces["run"] / cost, number))
    made = json.loads(REFERENCE.read_text()) if REFERENCE.exists() else {}
    for (platform, kind, size), found in runs.items():
        kinds, compiled = made.setdefault(platform, {}), compilations[platform, kind]
        known = [entry for entry in kinds.get(kind, []) if entry[0] != size]
        longest = max([*compiled, *(entry[1] for entry in kinds.get(kind, []))])
        anew = [each for each in compiled if each > CACHED * longest] or [longest]
        seconds, weights = zip(*found, strict=True)
        paces = float(gmean(anew)), float(np.average(seconds, weights=weights))
        kinds[kind] = sorted([[size, *(float(f"{each:.3g}") for each in paces)], *known])
    lines = [
        f'"{platform}": {{\n'
        + ",\n".join(f"{json.dumps(kind)}: {each}" for kind, each in sorted(kinds.items()))
        + "\n}"
        for platform, kinds in sorted(made.items())
    ]
    REFERENCE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
