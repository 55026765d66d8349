"""Photos of each shape in its material on a table, with cameras and surface that are known, as a phone takes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.mesh.nouns import Mesh
from tests.support.photos.rendered import shapes
from tests.support.photos.rendered.shapes import SIZE_M, Shape
from tests.support.photos.rendered.stage import Material, Stage
from tests.support.scenes import look_at
from tests.support.surfaces import grid

CAMERA = Intrinsics(647.0, 647.0, 399.5, 299.5, 800, 600)
SEED = 0
_RINGS = ((14, 18.0), (10, 48.0))  # photos, degrees above the table
_DISTANCE_M = 1.8 * SIZE_M
_TABLE_M = 1.6
_ELECTRONS, _READ = 8000, 5.0  # of white light in a pixel, and 1 sigma of reading it
_BLUR_PX, _JPEG = 0.6, 92

_WOOD = Material((0.06, 0.045, 0.03), (0.55, 0.45, 0.36))
_BLACK_CLOTH = Material((0.003, 0.003, 0.0035), (0.022, 0.021, 0.02))


@dataclass(frozen=True, slots=True)
class Subject:
    """What is photographed: a shape, its material, the table's, and how bright the room behind is."""

    shape: Callable[[], Shape]
    material: Material
    table: Material = _WOOD
    room: float = 1.0


SUBJECTS = {
    "dark matt": Subject(shapes.head, Material((0.0005, 0.0005, 0.0005), (0.013, 0.012, 0.012))),
    "dark furry": Subject(shapes.furry_head, Material((0.002, 0.0015, 0.001), (0.03, 0.024, 0.018))),
    "black gloss": Subject(shapes.rounded_box, Material((0.002,) * 3, (0.002,) * 3, mirrored=0.05)),
    "glass": Subject(shapes.bottle, Material((0.0,) * 3, (0.0,) * 3, mirrored=0.035, clear=True)),
    "white": Subject(shapes.head, Material((0.75, 0.75, 0.74), (0.75, 0.75, 0.74))),
    "stems": Subject(shapes.stems, Material((0.03, 0.08, 0.02), (0.45, 0.55, 0.15)), _BLACK_CLOTH, 0.02),
    "basket": Subject(shapes.basket, Material((0.12, 0.06, 0.02), (0.7, 0.5, 0.25))),
    "cup": Subject(shapes.cup, Material((0.03, 0.08, 0.25), (0.75, 0.75, 0.7))),
    "shoe": Subject(shapes.shoe, Material((0.1, 0.03, 0.02), (0.6, 0.35, 0.2))),
    "apple": Subject(shapes.apple, Material((0.2, 0.01, 0.01), (0.7, 0.45, 0.1))),
    "dress": Subject(shapes.dress, Material((0.0,) * 3, (0.0,) * 3)),
}


@dataclass(frozen=True, slots=True)
class RenderedPhotos:
    """Photos by file name with their camera-to-world (4,4) in OpenCV axes, and the shape in the same frame."""

    cameras: dict[str, Floats]
    intrinsics: Intrinsics
    shape: Shape


def arrange_photos(name: str, rng: np.random.Generator) -> RenderedPhotos:
    """Place the cameras around a subject of `SUBJECTS`; with the generator's seed they are the same each time."""
    shape = SUBJECTS[name].shape()
    cameras = {f"photo_{number:02}.jpg": pose for number, pose in enumerate(_poses(shape.mesh, rng))}
    return RenderedPhotos(cameras, CAMERA, shape)


def render_photos(name: str, folder: Path) -> RenderedPhotos:
    """Photograph a subject of `SUBJECTS` into a folder; the same files each time."""
    rng = np.random.default_rng(SEED)
    known = arrange_photos(name, rng)
    stage = build_stage(SUBJECTS[name], known.shape)
    folder.mkdir(parents=True, exist_ok=True)
    for file, pose in known.cameras.items():
        rgb = _developed(stage.picture(pose, known.intrinsics), rng)
        Image.fromarray(rgb).save(folder / file, quality=_JPEG, subsampling=1)
    return known


def build_stage(subject: Subject, shape: Shape) -> Stage:
    """The subject as part 0 of a stage, on a table, which is part 1."""
    side = np.linspace(-_TABLE_M / 2, _TABLE_M / 2, 161)
    x, y = np.meshgrid(side, side, indexing="ij")
    table = grid(np.stack([x, y, 0 * x - 1e-4], axis=-1))
    return Stage([(shape.mesh, subject.material), (table, subject.table)], subject.room)


def _poses(mesh: Mesh, rng: np.random.Generator) -> list[Floats]:
    """Rings of cameras that a hand holds: a little off their way, and of their aim."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    poses = []
    for count, above in _RINGS:
        for number in range(count):
            turn = 2 * np.pi * (number + rng.uniform(-0.2, 0.2)) / count
            tilt, away = np.radians(above + rng.uniform(-4, 4)), _DISTANCE_M * rng.uniform(0.95, 1.08)
            eye = middle + away * np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
            up = np.array([0, 0, 1]) + rng.normal(0, 0.03, 3)
            poses.append(look_at(eye.tolist(), (middle + rng.normal(0, 0.006, 3)).tolist(), up.tolist()))
    return poses


def _developed(light: Floats, rng: np.random.Generator) -> Bytes:
    """(H,W,3) sRGB uint8: an exposure, a soft lens, electrons that come at random, and are read with an error."""
    light = cv2.GaussianBlur(light * np.float32(rng.uniform(0.95, 1.05)), (0, 0), _BLUR_PX)
    sigma = np.sqrt(light * _ELECTRONS + _READ**2) / _ELECTRONS
    light = np.clip(light + sigma * rng.standard_normal(light.shape, dtype=np.float32), 0, 1)
    tones: Floats = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * tones), np.uint8)
