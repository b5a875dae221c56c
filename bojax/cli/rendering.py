"""`bojax render`: a film or a still of a recorded run, from the files of a results folder."""

from argparse import ArgumentTypeError
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from bojax.cli.parser import Parser, UsageError, integer, path
from bojax.errors import UserError

if TYPE_CHECKING:
    from bojax.engine.replay import Replay
    from bojax.films.recorded import Episode
    from bojax.report.source import Results

_EXAMPLES = """\
  bojax render results/mountain-car/20250101-120000               first success of the first run
  bojax render results/mountain-car/20250101-120000 --run 3       first success of run 3
  bojax render results/mountain-car/20250101-120000 --episode 1   episode 1 of the first run
  bojax render results/fig-4.8/20250101-120000 --point 2          run of a planner, with plans and belief
  bojax render results/mine --model my_robot.xml                  a custom robot
  bojax render results/mine --still picture.png --at 0.5          one image, at half the film
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = _parser(name).read(words)
    if args.at is not None and args.still is None:
        raise UsageError(f"bojax {name}: --at: allowed only with --still")

    from rich.console import Console
    from rich.progress import Progress

    from bojax.films.choose import choose_film
    from bojax.films.film import render, write_still
    from bojax.report.source import load
    from bojax.results.store import ResultsError
    from bojax.text import error_line

    try:
        results = load(args.folder)
        film = choose_film(
            results, args.point, args.run, args.episode, args.model, lambda chosen: _replay(results, chosen)
        )
        if args.still is not None:
            write_still(film, args.still, 1.0 if args.at is None else args.at)
            print(args.still)
            return 0
        console = Console(stderr=True)
        with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task("drawing", total=film.num_images)
            paths = render(film, args.folder / "animations", lambda: progress.advance(task))
    except (BrokenPipeError, UserError):
        raise
    except Exception as error:  # the manifest may hold invalid settings
        raise ResultsError(f"{args.folder}: cannot be drawn: {error_line(error)}") from error
    print(*paths, sep="\n")
    return 0


def _replay(results: "Results", episode: "Episode") -> "Replay":
    """An episode of a Gymnasium environment, which is stepped again and draws itself."""
    from bojax.config.external import resolved_in
    from bojax.engine.replay import Replay
    from bojax.envs.settings import Gymnasium
    from bojax.experiments.settings import Learning

    experiment, env = episode.point.experiment, episode.point.env
    assert isinstance(experiment, Learning) and isinstance(env, Gymnasium)
    resolved_in(experiment, results.folder / "manifest.json")
    seed, starts = results.manifest.seed, experiment.starts
    assert seed is not None
    return Replay(env, experiment.dtype, seed, episode.run, episode.number, starts)


def _share(text: str) -> float:
    with suppress(ValueError):
        if 0.0 <= (value := float(text)) <= 1.0:
            return value
    raise ArgumentTypeError(f"got {text}; allowed: a number from 0 to 1")


def _parser(name: str) -> Parser:
    parser = Parser(
        name,
        "DIR [--run N] [--episode E] [--point P] [--model FILE] [--still FILE [--at SHARE]]",
        "Draw a recorded run of a planner, or an episode of a learning run, and write it to\n"
        "DIR/animations/ as GIF and, if ffmpeg is installed, as MP4. The first runs of each point are\n"
        "recorded; their number is record.runs. MuJoCo draws robots, and needs no display. Environments of\n"
        "Gymnasium draw themselves: the episode is stepped again.",
        _EXAMPLES,
    )
    parser.option("folder", "DIR", "results folder", path)
    parser.option("--run", "N", "index of the run (default: the first recorded run)", integer)
    parser.option("--episode", "E", "number of the episode (default: first success, or last)", integer)
    parser.option("--point", "P", "number of the point of a sweep", integer)
    parser.option("--model", "FILE", "MJCF file of a custom robot", path)
    parser.option("--still", "FILE", "write a PNG image without text instead of a film", path)
    parser.option("--at", "SHARE", "position of the image in the film, from 0 to 1 (default: 1)", _share)
    return parser
