"""A thing that turns on a stand before a still camera, rendered by the parts of `walkaround.py`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.rays import pinhole
from tests.support.photos.walkaround import (
    Sheet,
    _camera,
    _developed,
    _exif,
    _mesh,
    _room,
    _shell,
    _Stage,
    _surroundings,
)
from tests.support.scenes import look_at

PLATE_RADIUS = 0.24  # metres
_PLATE_Z = 0.012  # above the table, which it hides

_TABLE_TEXELS = 600  # along a side: what is masked need not be fine
_PLATE_TEXELS = (16, 12)  # of each of its quads


@dataclass(frozen=True, slots=True)
class Turntable:
    """photos: the files, one a step of the turn; camera_to_world (N,4,4): as if the camera had gone round; thing: the
    shell alone, standing on the plate; moving (N,h,w): which pixels show the thing or its plate."""

    photos: tuple[Path, ...]
    camera_to_world: Floats
    thing: Mesh
    moving: Bools


def render_turntable(
    folder: Path,
    *,
    views: int = 20,
    size: tuple[int, int] = (640, 480),
    seed: int = 0,
    turn: float = 360.0,
    distance: float = 0.95,
    aside_px: float = 0.0,
    shake_px: float = 0.0,
    noise: float = 2.0,
    plate: bool = True,
    plain: bool = False,
    walk: bool = False,
) -> Turntable:
    """Photograph the shell on `turn` degrees of a turntable.

    distance  metres from the camera to the axis; aside_px: by which the axis stands beside the picture's middle
    shake_px  by which the camera moves between photos, 1 sigma; plate: whether a textured plate turns with the thing
    plain     a white table and wall instead of textured ones: nothing but the thing has texture
    walk      the thing stands, and the camera goes round it
    """
    rng = np.random.default_rng(seed)
    turning, standing = _turning(plate), _standing()
    camera = _camera(size)
    eye = look_at([distance * 0.83, 0, 0.15 + distance * 0.55], [0, 0, 0.15])
    still = _seen(standing, eye, camera)
    if plain:
        still = np.full_like(still[0], 0.7), np.full_like(still[1], np.inf)
    folder.mkdir(parents=True, exist_ok=True)
    photos, poses, moving = [], [], []
    for number, angle in enumerate(np.radians(np.arange(views) * turn / views)):
        pose = _about_z(-angle) @ eye
        colours, depth = _seen(turning, pose, camera)
        behind = _seen(standing, pose, camera) if walk else still
        shows = depth < behind[1]
        linear = np.where(shows[..., None], colours, behind[0])
        shift = np.array([aside_px, 0]) + shake_px * rng.standard_normal(2)
        linear, shows = _shifted(linear, shift, size), _shifted(shows.astype(np.float32), shift, size) > 0.5
        path = folder / f"IMG_{number:04}.jpg"
        developed = _developed(linear * np.float32(1 + 0.05 * np.sin(number)), rng, noise=noise, blur=0.6)
        Image.fromarray(developed).save(path, quality=92, subsampling=1, exif=_exif(True))
        photos.append(path)
        poses.append(pose)
        moving.append(shows)
    return Turntable(tuple(photos), np.stack(poses), _mesh((_thing(),)), np.stack(moving))


def _thing() -> Sheet:
    shell = _shell()
    return Sheet(shell.points + np.array([0, 0, _PLATE_Z]), shell.texels, shell.colours)


@cache
def _turning(plate: bool) -> _Stage:
    return _Stage((_thing(), _plate()) if plate else (_thing(),), np.random.default_rng(0))


@cache
def _standing() -> _Stage:
    rng = np.random.default_rng(1)
    table, *boxes = _surroundings(rng)
    return _Stage((replace(table, texels=(_TABLE_TEXELS, _TABLE_TEXELS)), *boxes), rng)


def _about_z(angle: float) -> Floats:
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turn


def _plate() -> Sheet:
    radius, turn = np.meshgrid(np.linspace(0.004, PLATE_RADIUS, 13), np.linspace(0, 2 * np.pi, 97), indexing="ij")
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full_like(turn, _PLATE_Z)], axis=-1)
    return Sheet(points, _PLATE_TEXELS, np.array([[0.2, 0.5, 0.3], [0.1, 0.2, 0.15], [0.7, 0.75, 0.6]]))


def _seen(stage: _Stage, pose: Floats, camera: Intrinsics) -> tuple[Floats, Floats]:
    """(H,W,3) linear colours and (H,W) depth, infinite where there is nothing."""
    x = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)
    rays = pinhole(x, y, *pose[:3, :3].T)
    hits = stage.scene.cast(pose[None, :3, 3], rays)
    place = np.einsum("nk,nkc->nc", hits.bary, stage.corners[hits.face]).reshape(camera.height, camera.width, 2)
    colours = cv2.remap(stage.atlas, place[..., 0], place[..., 1], cv2.INTER_LINEAR)
    missed = (hits.face < 0).reshape(camera.height, camera.width)
    colours[missed] = _room(rays.reshape(camera.height, camera.width, 3)[missed])
    return colours, hits.along.reshape(camera.height, camera.width)


def _shifted(picture: Floats, shift: Floats, size: tuple[int, int]) -> Floats:
    move = np.array([[1, 0, shift[0]], [0, 1, shift[1]]])
    return np.asarray(cv2.warpAffine(picture, move, size, borderMode=cv2.BORDER_REPLICATE))
