"""Photos of rendered things before real, busy photos, with the true mask of each: what cut-outs are judged by.

Shapes of `tests/support/photos/rendered/shapes.py` in two colours each, lit, blurred and noisy as a phone's photo is,
away from the middle by up to an eighth of the photo. What is behind are parts of the photos in the data folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.renderer import RenderMesh, place_cameras, render_view
from capture2vr.edge.srgb import to_srgb
from tests.support.photos.rendered import shapes

KINDS = ("apple", "basket", "bottle", "cup", "dress", "head", "rounded_box", "shoe", "stems")
BEHIND = {
    "chosen": ("photos_banana/images/DSC_0423.JPG", "photos_fruit/images/IMG_4195.JPG", "phone_tof/00000012_image.jpg"),
    "others": (
        "photos_statue/images/IMG_3023.JPG",
        "photos_statue/images/IMG_3035.JPG",
        "rgbd_livingroom/color/00000.jpg",
        "rgbd_livingroom/color/00003.jpg",
    ),
}
"""Photos behind the things: those that constants were chosen on, and others."""
VIEWS = 7
WIDTH, HEIGHT = 640, 480
_ELEVATION = 20.0


@dataclass(frozen=True, slots=True)
class BusyPhoto:
    """rgb (h,w,3), its true mask (h,w), and the name of the shape."""

    kind: str
    rgb: Bytes
    mask: Bools


def busy_photos(data: Path, which: str, count: int) -> Iterator[BusyPhoto]:
    """Make `count` photos, the same every time; which: a key of `BEHIND`."""
    rng = np.random.default_rng(sorted(BEHIND).index(which))
    behind = [cv2.imread(str(data / name))[..., ::-1] for name in BEHIND[which]]
    things = {kind: getattr(shapes, kind)().mesh for kind in KINDS}
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        yield _busy_photo(kind, things[kind], behind[number % len(behind)], rng)


def _busy_photo(kind: str, mesh: Mesh, behind: Bytes, rng: np.random.Generator) -> BusyPhoto:
    size = int(HEIGHT * rng.uniform(0.4, 0.85))
    subject = RenderMesh.of(_painted(mesh, rng), size, sky_rays=200_000)
    camera = place_cameras(subject, [float(rng.uniform(0, 360))], _ELEVATION)[0]
    view = render_view(subject, camera, size)
    rgb = _part(behind, rng).astype(np.float32)
    left, top = ((whole - size) / 2 + rng.uniform(-1, 1) / 8 * whole for whole in (WIDTH, HEIGHT))
    x, y = int(np.clip(left, 0, WIDTH - size)), int(np.clip(top, 0, HEIGHT - size))
    cover = view.cover
    thing = to_srgb(view.light / np.maximum(cover, 1e-6)).astype(np.float32)
    place = (slice(y, y + size), slice(x, x + size))
    rgb[place] = cover * thing + (1 - cover) * rgb[place]
    rgb = cv2.GaussianBlur(rgb, (0, 0), 0.6) + rng.normal(0, 3, rgb.shape)
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[place] = cover[..., 0] > 0.5
    return BusyPhoto(kind, np.clip(rgb, 0, 255).astype(np.uint8), mask)


def _painted(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """The mesh, y up, in two colours that run into each other."""
    xyz = mesh.vertices[:, [0, 2, 1]] * [1, 1, -1]
    colours = cv2.cvtColor(
        rng.integers([[[0, 60, 50]]], [[[180, 230, 240]]], (1, 2, 3)).astype(np.uint8), cv2.COLOR_HSV2RGB
    )[0]
    wave = np.sin(xyz @ rng.normal(0, 25, (3, 3)) + rng.uniform(0, 6, 3)).mean(axis=1, keepdims=True)
    share = np.clip(0.5 + wave, 0, 1)
    return Mesh(xyz, mesh.faces, np.asarray(share * colours[0] + (1 - share) * colours[1], np.uint8))


def _part(behind: Bytes, rng: np.random.Generator) -> Bytes:
    """A part of a photo, 0.6 to 1 of it, as large as the photos are; mirrored or not."""
    height, width = behind.shape[:2]
    by = rng.uniform(0.6, 1.0) * min(width / WIDTH, height / HEIGHT)
    x, y = int(rng.uniform(0, width - by * WIDTH)), int(rng.uniform(0, height - by * HEIGHT))
    part = behind[y : y + int(by * HEIGHT), x : x + int(by * WIDTH)]
    part = cv2.resize(part, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(part[:, ::-1] if rng.random() < 0.5 else part)
