"""Moving pictures: which instant each frame shows and for how long, and the files, GIF by Pillow and MP4 by ffmpeg."""

import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.animation import FFMpegWriter, writers
from matplotlib.figure import Figure

PIXELS = 130  # an inch
_MOST_FRAMES, _FRAME_RATE = 150, 25  # at most, of an animation, and in a second of it
_SHORTEST, _LONGEST = 2.0, 15.0  # s that an animation plays; a motion between them plays in real time
Picture = UInt8[np.ndarray, "height width 3"]


class Playback(NamedTuple):
    """The instant that each frame of an animation shows, the time [s] it stays, and how much faster than life it is."""

    instants: Int[np.ndarray, " frames"]
    interval: float
    speed: float

    @classmethod
    def of(cls, times: Float[np.ndarray, " times"]) -> "Playback":
        """Frames at equal intervals, as fine as the finest of the times where that is not too many."""
        span = float(times[-1] - times[0])
        if span == 0:
            return cls(np.array([times.size - 1]), _SHORTEST, 1.0)
        playing = min(max(span, _SHORTEST), _LONGEST)
        steps = np.diff(times)
        frames = int(min(span / steps[steps > 0].min() + 0.5, playing * _FRAME_RATE, _MOST_FRAMES - 1)) + 1
        ticks = np.linspace(times[0], times[-1], frames)
        instants = np.abs(ticks[:, None] - times).argmin(axis=1)
        return cls(instants, playing / (frames - 1), span / playing)

    @property
    def words(self) -> str:
        """What there is to say of the speed; nothing of real time."""
        return "" if self.speed == 1 else f"{self.speed:.3g} times as fast as real time"


def animation_suffixes() -> list[str]:
    """The kinds of file that `write_movie` writes here: GIF, and MP4 where ffmpeg is installed."""
    return [".gif", ".mp4"] if writers.is_available("ffmpeg") else [".gif"]


def write_movie(sample: Picture, pictures: Iterable[Picture], interval: float, kind: str, place: Path) -> None:
    """Writes a file of the `kind` ".gif" or ".mp4", each picture `interval` seconds long.

    `sample`, which is not shown, has all the colours that the pictures have. Raises `OSError`.
    """
    write = _write_mp4 if kind == ".mp4" else _write_gif
    write(sample, pictures, interval, place)


def _write_gif(sample: Picture, pictures: Iterable[Picture], interval: float, place: Path) -> None:
    from PIL import Image

    # one palette for all: no flicker, and fast
    palette = Image.fromarray(sample).quantize(method=Image.Quantize.MAXCOVERAGE)
    colours = np.reshape(palette.getpalette() or [], (-1, 3))
    colours[(colours > 247).all(axis=1)] = 255  # Pillow compares the upper six bits, and would tint the paper
    palette.putpalette(colours.ravel().tolist())
    images = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    # a GIF counts time in hundredths of a second: rounded so that they add up to the whole
    hundredths = np.diff(np.round(np.arange(len(images) + 1) * interval * 100).astype(int))
    durations = (10 * hundredths).tolist()
    images[0].save(place, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)


def _write_mp4(sample: Picture, pictures: Iterable[Picture], interval: float, place: Path) -> None:
    height, width = (pixels // 2 * 2 for pixels in sample.shape[:2])  # the codec wants even numbers
    screen = Figure(figsize=(width / PIXELS, height / PIXELS), dpi=PIXELS)
    shown = screen.figimage(sample[:height, :width])
    rate: Any = 1 / interval  # ffmpeg takes fractions
    writer = FFMpegWriter(fps=rate, extra_args=["-f", "mp4"])  # the name of `place` does not tell
    try:
        with writer.saving(screen, str(place), PIXELS):
            for picture in pictures:
                shown.set_data(picture[:height, :width])
                writer.grab_frame()
    except subprocess.CalledProcessError as error:
        raise OSError(f"ffmpeg: {str(error.stderr or error).strip().splitlines()[-1]}") from None
