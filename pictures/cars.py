"""The film of the README: 100 mountain cars of EMU-Q and of epsilon-greedy Q-learning find a goal, or do not.

    python pictures/cars.py docs/figures/cars.gif

Only the goal gives a reward. It first runs both learners 100 times, which takes two minutes on two CPU cores;
`--results DIR` keeps the runs, and uses them if they are there.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray
from PIL import Image
from typing_extensions import override

import bojax
from bojax.films.film import Film, blank, photograph, render
from bojax.report.style import BLUE, FAINT, INK, ORANGE

FEATURES = {"state_lengthscale": 0.3, "action_lengthscale": 10.0, "num_features": 300}
SWEEP: dict[str, Any] = {
    "base": {"experiment": "learning", "env": "mountain-car", "learner": "emu-q", "stop": "first-success"},
    "axes": {
        "learner": {
            "emu-q": {"kind": "emu-q", "prior_precision": 0.1, "features": FEATURES},
            "rff-q": {"kind": "rff-q", "features": FEATURES},
        }
    },
    "runs": 100,
    "record": {"runs": 100},
}
EPISODES = 6
PANELS = {
    "emu-q": ("EMU-Q: explores on purpose", BLUE),
    "rff-q": ("Q-learning: random exploration", ORANGE),
}
GOAL, LEFT = 0.5, -1.2  # positions of the flag and of the wall
STEPS = 12  # between two pictures


class Cars(Film):
    """Positions of many runs at the same number of steps, on the hill of the domain.

    Args:
        paths: For each label, the positions `[runs, steps]`, which stay at the goal.
    """

    def __init__(self, paths: dict[str, NDArray[np.float64]], name: str):
        self._paths, self.name, self.seconds = paths, name, 0.06
        self._shown = range(0, max(each.shape[1] for each in paths.values()), STEPS)
        self.num_images = len(self._shown)

    @override
    def images(self) -> Iterator[Image.Image]:
        figure = blank(7.2, 2.7)
        moved = []
        for place, (label, (title, ink)) in enumerate(PANELS.items()):
            axes = figure.add_axes((0.01 + 0.5 * place, 0.10, 0.48, 0.72))
            axes.set_xlim(LEFT - 0.05, 0.72)
            axes.set_ylim(-1.15, 1.75)
            axes.set_axis_off()
            ground = np.linspace(LEFT, 0.62, 200)
            axes.plot(ground, height(ground), color=INK, linewidth=2.0)
            axes.plot([GOAL, GOAL], [height(GOAL), height(GOAL) + 0.5], color=INK, linewidth=1.5)
            axes.fill([GOAL, GOAL, GOAL + 0.1], height(GOAL) + np.array([0.5, 0.3, 0.4]), color=ink)
            cars = axes.scatter([], [], s=26, color=ink, alpha=0.5, linewidths=0, clip_on=False)
            figure.text(0.02 + 0.5 * place, 0.90, title, color=ink, fontsize=11, weight="bold")
            count = figure.text(0.02 + 0.5 * place, 0.03, "", color=INK, fontsize=11)
            moved.append((self._paths[label], cars, count))
        clock = figure.text(0.455, 0.035, "", color=FAINT, fontsize=9, ha="center")
        for step in self._shown:
            for positions, cars, count in moved:
                at = positions[:, min(step, positions.shape[1] - 1)]
                # Cars at one place would hide each other: each one drives at a height of its own.
                raised = 0.06 + 0.22 * np.linspace(0.0, 1.0, len(at))
                is_parked = at >= GOAL
                place = np.where(is_parked, GOAL + 0.012 * (np.arange(len(at)) % 10), at)
                cars.set_offsets(np.stack([place, height(place) + raised], axis=1))
                count.set_text(f"{np.sum(is_parked)} of {len(at)} cars have found the goal")
            clock.set_text(f"step {step:,}")
            yield photograph(figure)

    @override
    def still(self, share: float) -> Image.Image:
        return list(self.images())[round(share * (self.num_images - 1))]


def height(position: Any) -> Any:
    """Height of the hill at a position."""
    return np.sin(3.0 * np.asarray(position))


def paths(results: Any, label: str) -> NDArray[np.float64]:
    """The positions `[runs, steps]` of a learner's runs; those that have ended at the goal stay there."""
    labels = pc.field("label") == label
    steps, runs = results.steps.filter(labels), results.runs.filter(labels).sort_by("run")
    run, position = steps["run"].to_numpy(), steps["observation_0"].to_numpy()
    positions = np.full((runs.num_rows, EPISODES * 500), np.nan)
    successes = zip(positions, runs["run"].to_pylist(), runs["success"].to_pylist(), strict=True)
    for row, number, is_found in successes:
        path = position[run == number][: len(row)]
        row[: len(path)] = path
        if is_found:
            row[len(path) :] = GOAL
    return positions


def main(argv: list[str]) -> int:
    """Run the learners and write the film."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("out", type=Path, help="the GIF to write")
    parser.add_argument("--results", type=Path, help="results folder of the runs")
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        results = args.results or Path(folder, "cars")
        if not results.exists():
            bojax.sweep(SWEEP, out=results, episodes=EPISODES)
        found = bojax.load(results)
        print(*render(Cars({label: paths(found, label) for label in PANELS}, args.out.stem), args.out.parent))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
