"""Photo captures that show less than a person thinks, written as files: of a screen, from one spot, of nothing."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Intrinsics
from tests.support.captures import FLIP
from tests.support.scenes import look_at

CAMERA = Intrinsics(320.0, 320.0, 199.5, 149.5, 400, 300)
_K = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]])
_SCREEN_M = (1.0, 0.75)  # width and height
_DARK_ROOM = (25, 25, 28)


def noise_at_every_scale(seed: int, width: int, height: int) -> Bytes:
    """(height,width,3) a texture that key points are found in at any distance."""
    rng, total = np.random.default_rng(seed), np.zeros((height, width, 3), np.float32)
    for cells in (8, 24, 70, 200):
        noise = rng.normal(size=(cells, round(cells * width / height), 3)).astype(np.float32)
        total += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 40 * total, 0, 255).astype(np.uint8)


def write_from_one_spot(folder: Path, count: int = 10) -> Path:
    """Clouds or a view, all far away: the camera turns, and nods a little, but never moves."""
    view = noise_at_every_scale(1, 3000, 1200)
    u, v = np.meshgrid(np.arange(400.0), np.arange(300.0))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
    for number in range(count):
        turn, nod = np.radians([6 * number - 3 * count, 3 * np.sin(number)])
        turned = rays @ (cv2.Rodrigues(np.array([0, turn, 0]))[0] @ cv2.Rodrigues(np.array([nod, 0, 0]))[0]).T
        x = 1500 + 800 * np.arctan2(turned[..., 0], turned[..., 2])
        y = 600 + 800 * turned[..., 1] / np.hypot(turned[..., 0], turned[..., 2])
        _save(folder, number, cv2.remap(view, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR))
    return folder


def write_of_a_screen(folder: Path, count: int = 12) -> Path:
    """A walk past a screen that shows a picture, in a dark room, with the moire of its pixels."""
    shown = noise_at_every_scale(3, 800, 600)
    x, y = np.meshgrid(np.arange(400.0), np.arange(300.0))
    metres = _SCREEN_M[0] / shown.shape[1]
    screen = np.array([[metres, 0, -_SCREEN_M[0] / 2], [0, 0, 0], [0, -metres, _SCREEN_M[1] / 2], [0, 0, 1]])
    for number in range(count):
        turn = np.radians(5 * number - 30)
        pose = look_at([1.2 * np.sin(turn), -1.2 * np.cos(turn), 0.1 * np.sin(number)], [0, 0, 0])
        picture = cv2.warpPerspective(
            shown, _K @ np.linalg.inv(pose)[:3] @ screen, (400, 300), flags=cv2.INTER_AREA, borderValue=_DARK_ROOM
        )
        moire = 1 + 0.12 * np.sin((0.9 + 0.05 * number) * x + 0.03 * number * y)
        _save(folder, number, picture * moire[..., None])
    return folder


def write_of_the_sky(folder: Path, count: int = 8) -> Path:
    """A gradient of blue."""
    gradient = np.linspace([90, 140, 200], [150, 185, 230], 300)[:, None] * np.ones((1, 400, 1))
    for number in range(count):
        _save(folder, number, gradient + 5 * np.sin(number))
    return folder


def write_copies(folder: Path, photo: Path, count: int = 8) -> Path:
    """The same file under other names."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        shutil.copy(photo, folder / f"IMG_{number:02}.jpg")
    return folder


def write_posed(folder: Path, photos: Sequence[Path], poses: Floats, camera: Intrinsics) -> Path:
    """Photos with cameras as nerfstudio writes them; poses (N,4,4) in OpenCV axes."""
    (folder / "images").mkdir(parents=True)
    frames = [
        {"file_path": f"images/{photo.name}", "transform_matrix": (pose @ FLIP).tolist()}
        for photo, pose in zip(photos, poses, strict=True)
    ]
    size = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
    tree = size | {"cx": camera.cx + 0.5, "cy": camera.cy + 0.5, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(tree))
    for photo in photos:
        shutil.copy(photo, folder / "images" / photo.name)
    return folder


def blacken(photo: Path) -> None:
    """Replace a photo by one taken with a finger on the lens: noise of a few grey levels."""
    dark = np.random.default_rng(0).integers(0, 6, (300, 400, 3)).astype(np.uint8)
    Image.fromarray(dark).save(photo, quality=92)


def _save(folder: Path, number: int, picture: Floats) -> None:
    """Save a photo with the noise of a sensor."""
    folder.mkdir(parents=True, exist_ok=True)
    noisy = picture + np.random.default_rng(number).normal(0, 2, picture.shape)
    Image.fromarray(np.clip(noisy, 0, 255).astype(np.uint8)).save(folder / f"IMG_{number:02}.jpg", quality=92)
