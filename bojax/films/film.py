"""A film: pictures one after the other, written as GIF, and as MP4 where there is ffmpeg; or a still."""

import abc
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from bojax.report.style import settings
from bojax.results.store import ResultsError, make_folder, write_atomically

MAX_FRAMES = 250
SLOWEST, FASTEST = 0.1, 0.04
"""Seconds that a picture is shown, at most and at least; between them the film is as fast as the world."""

LAST_SECONDS = 2.0
DPI = 100
STILL = (4.8, 3.6)  # inches of a still

_FREQUENT, _REST = 40, 215
"""Number of colours of a GIF that are the most frequent ones exactly, and number chosen among all others.

One entry of the 256 is left for pixels that do not change, which then need no bytes.
"""


class Film(abc.ABC):
    """The pictures of one run."""

    name: str  # of the file, without a suffix
    num_images: int
    seconds: float  # time for which a picture is shown, a multiple of 10 ms, the unit of GIF

    @abc.abstractmethod
    def images(self) -> Iterator[Image.Image]:
        """Draw the pictures, in order."""

    @abc.abstractmethod
    def still(self, share: float) -> Image.Image:
        """Draw the scene at a share of the film, from 0 to 1: larger than in the film, and without text."""


def render(film: Film, folder: Path, advanced: Callable[[], None] = lambda: None) -> list[Path]:
    """Write `NAME.gif` into a folder, and `NAME.mp4` if there is ffmpeg; `advanced` is called per picture."""
    images = []
    with settings():
        for image in film.images():
            images.append(image)
            advanced()
    make_folder(folder)
    paths = [folder / f"{film.name}.gif"]
    write_atomically(paths[0], lambda path: _write_gif(path, images, film.seconds))
    if FFMpegWriter.isAvailable():
        paths.append(folder / f"{film.name}.mp4")
        write_atomically(paths[1], lambda path: _write_mp4(path, images, film.seconds))
    return paths


def write_still(film: Film, path: Path, share: float) -> None:
    """Write the picture at a share of the film, from 0 to 1, as PNG."""
    with settings():
        image = film.still(share)
    make_folder(path.parent)
    write_atomically(path, lambda path: image.save(path, "PNG", optimize=True))


def frames_of(num_steps: int) -> NDArray[np.int64]:
    """Indices of the steps shown: all steps, or `MAX_FRAMES` evenly spaced ones including the last."""
    num = min(num_steps, MAX_FRAMES)
    return np.round(np.linspace(0, num_steps - 1, num)).astype(np.int64)


def blank(width: float, height: float) -> Figure:
    """An empty figure with a canvas for `photograph`; width and height are in inches."""
    figure = Figure(figsize=(width, height), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def photograph(figure: Figure) -> Image.Image:
    """The current state of a figure as a picture."""
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _write_gif(path: Path, images: Sequence[Image.Image], seconds: float) -> None:
    """Write a GIF with one palette, taken from the first, the middle and the last image.

    The alternatives were measured on a film of 131 maps, which takes 287 KiB here. A palette of Pillow's for
    each image takes 2.7 times as many bytes. One palette of Pillow's for all takes as many, but shifts white
    and has 8 times the mean error of colours. APNG (5 times the bytes) and lossless WebP (8 times) are exact;
    lossy WebP blurs lines and takes 1.4 times the bytes.
    """
    palette = _palette([images[i] for i in (0, len(images) // 2, -1)])
    frames = _indexed(images, palette)
    durations = [round(1000 * seconds)] * (len(frames) - 1) + [round(1000 * LAST_SECONDS)]
    frames[0].save(
        path, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=True
    )


def _palette(images: Sequence[Image.Image]) -> NDArray[np.uint8]:
    """A palette that has the colours of large areas exactly, so that white stays white."""
    samples = np.concatenate([np.asarray(image).reshape(-1, 3) for image in images])
    values, counts = np.unique(_packed(samples), return_counts=True)
    order = np.argsort(-counts, kind="stable")
    colours = _unpacked(values[order]).astype(np.uint8)
    rest = colours[_FREQUENT:]
    if len(rest) > _REST:
        cut = Image.fromarray(rest[None]).quantize(_REST, Image.Quantize.MEDIANCUT).getpalette() or []
        rest = np.asarray(cut, np.uint8).reshape(-1, 3)[:_REST]
    return np.concatenate([colours[:_FREQUENT], rest])


def _indexed(images: Sequence[Image.Image], palette: NDArray[np.uint8]) -> list[Image.Image]:
    """The images in the nearest colours of a palette. Pillow's search rounds, and turns white into grey."""
    known = palette.astype(np.float32)
    numbers = np.zeros(1 << 24, np.uint16)  # by colour: one more than its place in the palette, or 0
    frames = []
    for image in images:
        packed = _packed(np.asarray(image))
        new = np.unique(packed[numbers[packed] == 0])
        colours = _unpacked(new).astype(np.float32)
        numbers[new] = 1 + np.argmin(np.sum(known**2, axis=-1) - 2.0 * colours @ known.T, axis=-1)
        frames.append(Image.fromarray((numbers[packed] - 1).astype(np.uint8)))
        frames[-1].putpalette(palette.tobytes())
    return frames


def _packed(colours: NDArray[np.uint8]) -> NDArray[np.int32]:
    return colours.astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], np.int32)


def _unpacked(values: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.stack([values >> 16, values >> 8 & 255, values & 255], axis=-1)


def _write_mp4(path: Path, images: Sequence[Image.Image], seconds: float) -> None:
    width, height = images[0].size
    figure = blank(width / DPI, height / DPI)
    shown = figure.figimage(np.asarray(images[0]))
    writer = FFMpegWriter(fps=round(1 / seconds), extra_args=["-f", "mp4", "-pix_fmt", "yuv420p"])
    try:
        with writer.saving(figure, str(path), DPI):
            for image in [*images, *[images[-1]] * round(LAST_SECONDS / seconds)]:
                shown.set_data(np.asarray(image))
                writer.grab_frame()
    except (subprocess.CalledProcessError, BrokenPipeError) as error:
        raise ResultsError(
            "the GIF is written, but ffmpeg failed to make an MP4 of it", exit_code=1
        ) from error
