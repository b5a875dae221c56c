"""`bojax render`: a film of a recorded run, or a still, from the files of a results folder."""

from collections.abc import Sequence
from pathlib import Path

from bojax.cli.parser import Parser, integer

_EXAMPLES = """\
  bojax render results/mountain-car/20250101-120000               the first success of the first run
  bojax render results/mountain-car/20250101-120000 --run 3       of another run
  bojax render results/mountain-car/20250101-120000 --episode 1   another episode
  bojax render results/fig-4.8/20250101-120000 --point 2          a planner's run, with plans and belief
  bojax render results/mine --model my_robot.xml                  a robot of one's own
  bojax render results/mine --still picture.png --at 0.5          one picture, from halfway
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command."""
    parser = Parser(
        prog=f"bojax {name}",
        usage=f"bojax {name} DIR [--run N] [--episode E] [--point P] [--model FILE] "
        "[--still FILE [--at SHARE]]",
        description="Draw a recorded run of a planner, or an episode of a learning run, and write it to\n"
        "DIR/animations/, as GIF and, where ffmpeg is installed, as MP4. Recorded are the first runs:\n"
        "record.runs of the config. Robots are drawn by MuJoCo, without a screen.",
        examples=_EXAMPLES,
    )
    parser.add_argument("folder", metavar="DIR", type=Path, help="results folder")
    parser.add_argument("--run", type=integer, metavar="N", help="index of the run; the first recorded one")
    parser.add_argument(
        "--episode", type=integer, metavar="E", help="number of the episode; the first success, or the last"
    )
    parser.add_argument("--point", type=integer, metavar="P", help="number of the point of a sweep")
    parser.add_argument("--model", type=Path, metavar="FILE", help="MJCF of a robot of one's own")
    parser.add_argument(
        "--still", type=Path, metavar="FILE", help="write one picture instead, a PNG without words"
    )
    parser.add_argument(
        "--at",
        type=_share,
        metavar="SHARE",
        default=1.0,
        help="how much of the film is over then, from 0 to 1; 1",
    )
    args = parser.parse_intermixed_args(list(words))

    from rich.console import Console
    from rich.progress import Progress

    from bojax.report.animations.choose import choose_film
    from bojax.report.animations.film import render, write_still
    from bojax.report.source import load
    from bojax.results.store import ResultsError
    from bojax.text import error_line

    try:
        film = choose_film(load(args.folder), args.point, args.run, args.episode, args.model)
        if args.still is not None:
            write_still(film, args.still, args.at)
            print(args.still)
            return 0
        console = Console(stderr=True)
        with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task("drawing", total=film.num_images)
            paths = render(film, args.folder / "animations", lambda: progress.advance(task))
    except BrokenPipeError:
        raise
    except Exception as error:  # the settings in a manifest may be anything
        if hasattr(error, "exit_code"):
            raise
        raise ResultsError(f"{args.folder}: cannot be drawn: {error_line(error)}") from error
    print(*paths, sep="\n")
    return 0


def _share(word: str) -> float:
    value = float(word)
    if not 0.0 <= value <= 1.0:
        raise ValueError(word)
    return value
