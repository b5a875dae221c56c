"""A film of one episode: a scene, the time, the reward and the action, as GIF, and as MP4 where ffmpeg is."""

import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from bojax.report.animations import SCENES
from bojax.report.animations.base import Settings
from bojax.report.animations.episode import Episode
from bojax.report.style import BLUE, FAINT, INK, settings
from bojax.results.store import ResultsError, explained, write_atomically

MAX_FRAMES = 250
SLOWEST, FASTEST = 0.1, 0.04
"""Seconds that a frame is shown, at most and at least; between them the film is as fast as the world."""

LAST_SECONDS = 2.0
NUM_COLOURS = 64
_SIZE, _DPI = (4.0, 4.0), 100


def render(episode: Episode, folder: Path, advanced: Callable[[], None] = lambda: None) -> list[Path]:
    """Write `<variant>-run<N>-episode<E>.gif` into a folder, and `.mp4` where there is ffmpeg.

    Args:
        episode: What is shown.
        folder: Where it is written; made if it is not there.
        advanced: Called after every frame.

    Raises:
        ResultsError: Nothing is known of how to draw this environment, or it cannot be written.
    """
    env = _drawable(episode)
    indices = frames_of(len(episode.observations))
    seconds = _seconds(env, indices)
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    name = f"{_slug(episode.point.name)}-run{episode.run}-episode{episode.number}"
    images = []
    with settings():
        for image in _images(episode, env, indices):
            images.append(image)
            advanced()
    paths = [folder / f"{name}.gif"]
    write_atomically(paths[0], lambda path: _write_gif(path, images, seconds))
    if FFMpegWriter.isAvailable():
        paths.append(folder / f"{name}.mp4")
        write_atomically(paths[1], lambda path: _write_mp4(path, images, seconds))
    return paths


def _drawable(episode: Episode) -> Settings:
    env = episode.point.config["env"]
    kind = str(env["kind"])
    if kind not in SCENES:
        raise ResultsError(f"nothing known how to draw {kind}; known: {', '.join(SCENES)}")
    missing = [key for key in SCENES[kind].keys if key not in env]
    if missing:
        raise ResultsError(f"manifest.json: env: no {', '.join(missing)}, which drawing {kind} needs")
    return env


def frames_of(num_steps: int) -> NDArray[np.int64]:
    """The steps that are shown: all of them, or `MAX_FRAMES` at equal distances, the last one always."""
    num = min(num_steps, MAX_FRAMES)
    return np.round(np.linspace(0, num_steps - 1, num)).astype(np.int64)


def _seconds(env: Settings, indices: NDArray[np.int64]) -> float:
    """How long a frame is shown, a multiple of the 10 ms that a GIF knows."""
    stride = (indices[-1] - indices[0]) / max(len(indices) - 1, 1)
    real = stride * float(env.get("time_step", 0.0))
    return round(float(np.clip(real, FASTEST, SLOWEST)), 2)


def _images(episode: Episode, env: Settings, indices: NDArray[np.int64]) -> Iterator[Image.Image]:
    figure = Figure(figsize=_SIZE, dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    scene = SCENES[env["kind"]](figure.add_axes((0.02, 0.16, 0.96, 0.70)), env)
    title = f"{env['kind']}: {episode.point.name}, run {episode.run}, episode {episode.number}"
    figure.text(0.04, 0.945, title, color=INK, fontsize=10)
    status = figure.text(0.04, 0.885, "", color=INK, fontsize=10)
    outcome = figure.text(0.96, 0.885, "", color=BLUE, fontsize=10, ha="right", weight="bold")
    bars = figure.add_axes((0.20, 0.045, 0.72, 0.07))
    largest = np.maximum(np.abs(episode.actions).max(axis=0), 1e-9)
    num = len(largest)
    bars.set_xlim(-1.02, 1.02)
    bars.set_ylim(-0.6, num - 0.4)
    bars.set_axis_off()
    bars.axvline(0.0, color=FAINT, linewidth=1.0)
    drawn = bars.barh(np.arange(num), np.zeros(num), height=0.7, color=BLUE)
    figure.text(0.04, 0.08, "action", color=INK, fontsize=10, va="center")
    position = 0
    for index in indices:
        for step in range(position, index + 1):
            scene.move(episode.observations[step])
        position = index + 1
        seconds = f"{index * float(env['time_step']):.2f} s, " if "time_step" in env else ""
        reward = f"reward {episode.accumulated[index]:.4g}"
        status.set_text(f"{seconds}step {index + 1} of {len(episode.observations)}, {reward}")
        for bar, width in zip(drawn, episode.actions[index] / largest, strict=True):
            bar.set_width(width)
        if index == indices[-1]:
            outcome.set_text(episode.outcome)
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _write_gif(path: Path, images: list[Image.Image], seconds: float) -> None:
    # One palette for all frames, of the first, the middle and the last: pixels that stay need no bytes.
    samples = np.concatenate([np.asarray(images[i]).reshape(-1, 3) for i in (0, len(images) // 2, -1)])
    colours, counts = np.unique(samples, axis=0, return_counts=True)
    palette = colours[np.argsort(-counts, kind="stable")[:NUM_COLOURS]]
    frames = [_indexed(np.asarray(image), palette) for image in images]
    durations = [round(1000 * seconds)] * (len(frames) - 1) + [round(1000 * LAST_SECONDS)]
    frames[0].save(
        path, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=False
    )


def _indexed(image: NDArray[np.uint8], palette: NDArray[np.uint8]) -> Image.Image:
    """The image in the nearest colours of a palette; Pillow's own search rounds, and white turns grey."""
    packed = image.astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], np.int32)
    values, places = np.unique(packed, return_inverse=True)
    colours = np.stack([values >> 16, values >> 8 & 255, values & 255], axis=-1)
    nearest = np.argmin(np.sum((colours[:, None] - palette.astype(np.int32)) ** 2, axis=-1), axis=-1)
    indexed = Image.fromarray(nearest[places].reshape(packed.shape).astype(np.uint8), "P")
    indexed.putpalette(palette.astype(np.uint8).tobytes())
    return indexed


def _write_mp4(path: Path, images: list[Image.Image], seconds: float) -> None:
    figure = Figure(figsize=_SIZE, dpi=_DPI)
    FigureCanvasAgg(figure)
    shown = figure.figimage(np.asarray(images[0]))
    writer = FFMpegWriter(fps=round(1 / seconds), extra_args=["-f", "mp4", "-pix_fmt", "yuv420p"])
    try:
        with writer.saving(figure, str(path), _DPI):
            for image in [*images, *[images[-1]] * round(LAST_SECONDS / seconds)]:
                shown.set_data(np.asarray(image))
                writer.grab_frame()
    except (subprocess.CalledProcessError, BrokenPipeError) as error:
        raise ResultsError(
            "the GIF is written, but ffmpeg failed to make an MP4 of it", exit_code=1
        ) from error


def _slug(name: str) -> str:
    return re.sub(r"[^\w.=-]+", "-", name).strip("-")
