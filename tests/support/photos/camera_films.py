"""Films of what a phone's camera sees while somebody walks around a thing: steps and rests, from real photos."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from capture2vr.edge.arrays import Bytes

WIDTH, HEIGHT = 480, 360
FPS = 10
_STEP_FRAMES = 3  # of each half of a step
_STEP_PX = 40  # that the picture moves from frame to frame of a step
_TREMOR_PX = 1  # of a hand that is held still
_NOISE = 1.5  # of the sensor, 1 sigma of 255
_SIDE = 40  # pixels around the picture, for the tremor


def rest(view: Bytes, seconds: float, rng: np.random.Generator) -> Iterator[Bytes]:
    """Frames (HEIGHT,WIDTH,3) of a hand that is held still. view: (HEIGHT+2*_SIDE,WIDTH+2*_SIDE,3)"""
    for _ in range(round(seconds * FPS)):
        across, down = _SIDE + rng.integers(-_TREMOR_PX, _TREMOR_PX + 1, 2)
        yield _seen(view, int(across), int(down), rng)


def step(view: Bytes, following: Bytes, rng: np.random.Generator) -> Iterator[Bytes]:
    """Frames of a step to the side, from one view to the next, smeared by the movement."""
    for number in range(2 * _STEP_FRAMES):
        shown = view if number < _STEP_FRAMES else following
        yield _seen(cv2.blur(np.roll(shown, (number + 1) * _STEP_PX, axis=1), (_STEP_PX, 1)), _SIDE, _SIDE, rng)


def view_of(photo: Path) -> Bytes:
    """A photo in the size of a view."""
    with Image.open(photo) as image:
        fitted = image.convert("RGB").resize((WIDTH + 2 * _SIDE, HEIGHT + 2 * _SIDE), Image.Resampling.LANCZOS)
    return np.asarray(fitted)


def middle_of(view: Bytes) -> Bytes:
    """(HEIGHT,WIDTH,3): what the camera sees of a view."""
    return view[_SIDE : _SIDE + HEIGHT, _SIDE : _SIDE + WIDTH]


def write_film(path: Path, frames: Sequence[Bytes]) -> Path:
    """Write frames (HEIGHT,WIDTH,3) as YUV4MPEG2, which a browser shows as its camera without decoding."""
    with path.open("wb") as file:
        file.write(f"YUV4MPEG2 W{WIDTH} H{HEIGHT} F{FPS}:1 Ip A1:1 C420jpeg\n".encode())
        for frame in frames:
            file.write(b"FRAME\n" + cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2YUV_I420).tobytes())
    return path


def _seen(view: Bytes, across: int, down: int, rng: np.random.Generator) -> Bytes:
    picture = view[down : down + HEIGHT, across : across + WIDTH]
    noisy = picture + _NOISE * rng.standard_normal(picture.shape, dtype=np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
