"""`bojax render`: an animation of a recorded episode, from the files of a results folder."""

from collections.abc import Sequence
from pathlib import Path

from bojax.cli.parser import Parser, integer

_EXAMPLES = """\
  bojax render results/mountain-car/20250101-120000               the first success of the first run
  bojax render results/mountain-car/20250101-120000 --run 3       of another run
  bojax render results/mountain-car/20250101-120000 --episode 1   another episode
"""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command."""
    parser = Parser(
        prog=f"bojax {name}",
        usage=f"bojax {name} DIR [--run N] [--episode E] [--point P]",
        description="Draw a recorded episode of a learning run and write it to DIR/animations/, as GIF and,\n"
        "where ffmpeg is installed, as MP4. Recorded are the first runs: record.runs of the config.",
        examples=_EXAMPLES,
    )
    parser.add_argument("folder", metavar="DIR", type=Path, help="results folder")
    parser.add_argument("--run", type=integer, metavar="N", help="index of the run; the first recorded one")
    parser.add_argument(
        "--episode", type=integer, metavar="E", help="number of the episode; the first success, or the last"
    )
    parser.add_argument("--point", type=integer, metavar="P", help="number of the point of a sweep")
    args = parser.parse_intermixed_args(list(words))

    from rich.console import Console
    from rich.progress import Progress

    from bojax.report.animations.episode import choose
    from bojax.report.animations.film import frames_of, render
    from bojax.report.source import load

    episode = choose(load(args.folder), args.point, args.run, args.episode)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("drawing", total=len(frames_of(len(episode.observations))))
        paths = render(episode, args.folder / "animations", lambda: progress.advance(task))
    print(*paths, sep="\n")
    return 0
