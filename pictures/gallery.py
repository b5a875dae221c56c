"""Every figure that bojax can draw, on one page, from small sweeps made for it.

    python pictures/gallery.py results/gallery

The sweeps take some ten minutes on two CPU cores; those that are there already are used as they are. Look at
the page, `index.html`, at the width of a desktop and of a phone, and in dark mode.
"""

import argparse
import base64
import html
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import bojax
from bojax.config.figures import FIGURES
from bojax.report import source, style
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.figures import draw

EMU_Q: dict[str, Any] = {
    "experiment": "learning",
    "env": "mountain-car",
    "learner": {"kind": "emu-q", "features": {"num_features": 100, "action_lengthscale": 10.0}},
}
CHAIN: dict[str, Any] = {
    "experiment": "learning",
    "env": {"kind": "chain", "length": 8, "max_length": 64, "max_steps": 200},
    "learner": "exploration-values",
    "episodes": 20,
}
SWEEPS: Mapping[str, tuple[Any, dict[str, Any]]] = {
    "parking": ("parking", {"runs": 20, "planner.iterations": 50}),
    "two-pits": ("fig-3.3", {"runs": 4, "planner.iterations": 20, "problem.max_steps": 12}),
    "space-modelling": ("fig-4.4", {"runs": 4, "planner.iterations": 20}),
    "trajectories": ("fig-4.2", {}),
    "heights": ("hilly-terrain", {"runs": 2, "planner.iterations": 10, "problem.max_steps": 8}),
    "budget": (
        "two-pits",
        {"runs": 4, "planner.iterations": 20, "problem.budget": 10.0, "problem.errors_by_step": True},
    ),
    "light-dark": ("light-dark", {"runs": 2, "planner.iterations": 20, "problem.max_steps": 8}),
    "mountain-car": (
        EMU_Q,
        {"runs": 4, "episodes": 4, "tests": 1, "map_episodes": [1, 2, 3], "stop": "never"},
    ),
    "chain": (
        {"base": CHAIN, "axes": {"env.length": [4, 6, 8, 12, 16]}},
        {"runs": 20, "stop": "first-success"},
    ),
    "grid": (
        {
            "base": CHAIN,
            "axes": {"learner.learning_rate": [0.1, 0.3, 0.9], "learner.discount": [0.5, 0.9, 0.99]},
        },
        {"runs": 20},
    ),
    "many": (
        {
            "base": CHAIN,
            "axes": {
                "learner": {
                    **{f"exploration-values-{k}": {"kappa": k} for k in (0.01, 0.1, 1.0, 10.0)},
                    **{f"additive-{xi}": {"kind": "additive", "xi": xi} for xi in (0.01, 0.1, 1.0)},
                    **{
                        f"epsilon-{share}": {"kind": "epsilon-greedy", "epsilon": share}
                        for share in (0.1, 0.5)
                    },
                    "random-actions": {"kind": "random"},
                }
            },
        },
        {"runs": 20},
    ),
}
"""For each results folder: a sweep or an experiment, and settings that make it small."""

PAGE = """<!doctype html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width"><title>Figures of bojax</title><style>
body{{font-family:system-ui,sans-serif;margin:1rem;color-scheme:light dark}}
main{{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(21rem,100%),1fr));gap:1.5rem}}
figure{{margin:0}}img{{width:100%}}figcaption{{font-size:.85rem}}h2{{font-size:1rem}}
</style><h1>Figures of bojax</h1><main>{}</main></html>"""


def main(argv: list[str]) -> int:
    """Run what is missing, draw all figures, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("out", type=Path, help="folder of the page and of the results")
    folder = parser.parse_args(argv).out
    figures = [*_of_sweeps(folder), *_of_commands(folder), *_of_models()]
    (folder / "index.html").write_text(PAGE.format("\n".join(figures)))
    print(f"{len(figures)} figures: {folder / 'index.html'}")
    missing = FIGURES.keys() - _drawn
    if missing:
        print(f"not drawn: {', '.join(sorted(missing))}", file=sys.stderr)
    return 1 if missing else 0


_drawn: set[str] = set()


def _of_sweeps(folder: Path) -> Iterator[str]:
    for name, (config, settings) in SWEEPS.items():
        out = folder / name
        if not (out / "manifest.json").exists():
            is_sweep = isinstance(config, str) and config.startswith(("fig", "parking")) or "axes" in config
            (bojax.sweep if is_sweep else bojax.run)(config, out=out, resume=out.exists(), **settings)
        results = source.load(out)
        for figure in FIGURES:
            with style.settings():
                try:
                    drawing = draw(figure, results)
                except FigureUnavailable:
                    continue
                svg = style.encode(drawing.figure)["svg"]
            _drawn.add(figure)
            yield _shown(f"{figure} ({name})", svg, drawing.caption)


def _of_commands(folder: Path) -> Iterator[str]:
    """Figures of pages that commands of their own write."""
    lake = Path(__file__).parents[1] / "examples" / "my_lake"
    commands = {
        "compare": ["compare", str(folder / "chain"), str(folder / "grid")],
        "tune": ["tune", "chain", "learner.kappa=0.1:10:log", "learner.learning_rate=0.1:0.9", "--runs", "4"],
        "survey": ["survey", f"{lake}.geojson", "--prior", f"{lake}_pilot.csv", "--budget", "2km"],
    }
    for name, words in commands.items():
        out = folder / name
        if not out.exists():
            extra = ["--budget", "64", "--batch", "4", "--confirm", "4"] if name == "tune" else []
            subprocess.run([sys.executable, "-m", "bojax", *words, *extra, "--out", str(out)], check=True)
        page = next(out.glob("*.html")).read_text()
        for number, svg in enumerate(re.findall('data:image/svg.xml;base64,([^"]+)', page), 1):
            yield _shown(f"{number} ({name})", base64.b64decode(svg), "")


def _of_models() -> Iterator[str]:
    """The figure of `bojax.minimise`."""
    found = bojax.minimise(
        lambda x, kind: float(np.sin(5.0 * x) + (kind == "b")),
        {"x": (0.0, 2.0), "kind": ["a", "b"]},
        budget=12,
        progress=False,
    )
    picture = found.plot()
    yield _shown("bojax.minimise", picture.png, picture.caption, "png")


def _shown(title: str, image: bytes, caption: str, kind: str = "svg+xml") -> str:
    data = base64.b64encode(style.adapted(image) if kind != "png" else image).decode("ascii")
    words = html.escape(title), html.escape(caption)
    return (
        f'<figure><h2>{words[0]}</h2><img alt="{words[0]}" src="data:image/{kind};base64,{data}">'
        f"<figcaption>{words[1]}</figcaption></figure>"
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
