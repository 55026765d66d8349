"""Photos of printed meshes by ray casting, with their cameras and depth images, in the frame of the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from typing import Any

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import RaycastingScene, pinhole
from tests.support.scenes import look_at

SIDE = 200  # pixels of a photo's width and height
WALL_DEPTH = 5.0
"""Of the wall behind everything, in units of the mesh along the optical axis."""
_WALL, _GRAIN = (60.0, 90.0, 170.0), 6.0  # sRGB of the wall, and 1 sigma of its grain
_SAMPLES = 2  # per pixel and axis


def print_on(places: Floats) -> Floats:
    """(N,3) sRGB in 0..255 of a warm print at places (N,3): waves whose lengths are 9 to 60 pixels of a photo."""
    x, y, z = np.moveaxis(places, -1, 0)
    light = 155 + 30 * np.sin(23 * x + 7 * y) + 35 * np.sin(80 * y - 60 * z) + 35 * np.sin(90 * x + 40 * z)
    return np.stack([light, 0.7 * light, 0.35 * light], axis=-1)


def printed(mesh: Mesh) -> Mesh:
    """The mesh with the print at its vertices, which should be closer to each other than a photo's pixels."""
    return Mesh(mesh.vertices, mesh.faces, np.rint(print_on(mesh.vertices)).astype(np.uint8))


def photograph(mesh: Mesh, eye: Sequence[float], **options: Any) -> PosedPicture:
    """Photograph a mesh from one place; options as of `photographs`."""
    (photo,) = photographs(mesh, [eye], **options)
    return photo


def photographs(
    mesh: Mesh,
    eyes: Sequence[Sequence[float]],
    *,
    scale: float = 1.0,
    gain: Sequence[float] = (1.0, 1.0, 1.0),
    depth: bool = True,
) -> list[PosedPicture]:
    """Photograph a mesh that has the print from each eye towards the origin, before a blue wall.

    A picture shows as much as its camera is away from the origin; its name is its number.
    scale  units of the camera per unit of the mesh
    gain   of the exposure, per channel
    depth  whether the photos have depth images
    """
    scene, to_units = RaycastingScene(mesh), np.diag([scale, scale, scale, 1.0])
    photos = []
    for number, eye in enumerate(eyes):
        pose = _pose(eye)
        rgb = cache(partial(_photo, scene, pose, np.asarray(gain)))
        measured = cache(partial(_depth, scene, pose, scale)) if depth else None
        to_camera = to_units @ np.linalg.inv(pose)
        photos.append(PosedPicture(to_camera, np.ones(2), np.full(2, 0.5), rgb, measured, str(number)))
    return photos


def silhouette(mesh: Mesh, eye: Sequence[float]) -> Bools:
    """(SIDE,SIDE) which pixels of a photo from `eye` show the mesh."""
    shown: Bools = _cast(RaycastingScene(mesh), _pose(eye), SIDE)[1] < WALL_DEPTH
    return shown


def _photo(scene: RaycastingScene, pose: Floats, gain: Floats) -> Bytes:
    fine, _ = _cast(scene, pose, _SAMPLES * SIDE)
    shown = cv2.resize(fine, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    return np.clip(np.rint(shown * gain), 0, 255).astype(np.uint8)


def _depth(scene: RaycastingScene, pose: Floats, scale: float) -> Floats:
    return (scale * _cast(scene, pose, SIDE)[1]).astype(np.float32)


def _pose(eye: Sequence[float]) -> Floats:
    upright = abs(eye[2]) < 0.9 * float(np.linalg.norm(eye))
    return look_at(eye, (0, 0, 0), (0, 0, 1) if upright else (0, 1, 0))


def _cast(scene: RaycastingScene, pose: Floats, side: int) -> tuple[Floats, Floats]:
    """Colours (side,side,3) float and depth (side,side) of one ray through the middle of each pixel."""
    at = (np.arange(side) + 0.5) / side - 0.5
    rays = pinhole(at, at, *pose[:3, :3].T)
    along = scene.cast(pose[None, :3, 3], rays).along
    depth = np.minimum(along, WALL_DEPTH)
    wall = _WALL + np.random.default_rng(0).normal(0, _GRAIN, (len(rays), 1))
    rgb = np.where((along < WALL_DEPTH)[:, None], print_on(pose[:3, 3] + depth[:, None] * rays), wall)
    return rgb.reshape(side, side, 3), depth.reshape(side, side)
