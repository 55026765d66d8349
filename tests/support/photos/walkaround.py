"""A walk around a thing on a table, rendered as a phone would photograph it, with everything about it known.

The thing is an open shell of zero thickness, 0.4 m high: it has no inside. Surfaces are grids of quads that share one
atlas of texels, coloured by value noise of several octaves at their places in space, lit and shadowed once; a picture
is then one ray and one look-up for each of its 2 x 2 samples per pixel. World: metres, Z up, the table at `floor_z`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Frame, Intrinsics
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.rays import RaycastingScene, pinhole
from tests.support.scenes import look_at

FOCAL_35MM = 28  # of the main camera of many phones; written into the EXIF as such
DIAGONAL_35MM = float(np.hypot(36, 24))  # millimetres: equivalents compare diagonals
FLOOR_Z = 0.0
_SAMPLES = 2  # per pixel and axis
_TEXEL_M = 1.2e-3  # a pixel of 640 x 480 sees 1.6 mm of the thing
_OCTAVES = 6  # of value noise, from 0.12 m to 4 mm: features for every scale that a detector looks at
_COARSEST_M = 0.12
_UPRIGHT = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # the stored picture's right is the upright one's down
_SUN = np.array([0.45, -0.35, 0.82])  # towards the light
_SUN_RADIUS = 0.08  # of the light at distance 1: how soft shadows are
_AMBIENT = 0.42  # of the light that comes from everywhere
_GLOSS_POWER = 40  # of a highlight (Blinn and Phong): half as bright 11 degrees beside its middle, as on glazed clay


@dataclass(frozen=True, slots=True)
class Walkaround:
    """photos: the files in the order of the walk; intrinsics: of each that is a plain `Shot`; camera_to_world (N,4,4)
    in OpenCV axes; thing: the shell alone, as rendered; floor_z: the height of the table; neighbour: the box beside the
    shell, without its bottom, None where there is none."""

    photos: tuple[Path, ...]
    intrinsics: Intrinsics
    camera_to_world: Floats
    thing: Mesh
    floor_z: float
    neighbour: Mesh | None = None


@dataclass(frozen=True, slots=True)
class Shot:
    """How the phone takes a photo.

    zoom     times the main camera's focal length
    upright  how a photo that the phone takes upright is stored: "tag", pixels as the sensor has them and an orientation
             tag, as phones do; "pixels", pixels turned, as editors do; None: the phone is held sideways
    """

    zoom: int = 1
    upright: Literal["tag", "pixels"] | None = None


@dataclass(frozen=True, slots=True)
class Sheet:
    """A grid of quads: points (R,C,3), texels per quad's side, and three colours (3,3) in 0..1 that the noise mixes.

    repeat_m: side of the square that its texture repeats, None: nowhere."""

    points: Floats
    texels: tuple[int, int]
    colours: Floats
    repeat_m: float | None = None


def render_walkaround(
    folder: Path,
    *,
    views: int = 24,
    size: tuple[int, int] = (640, 480),
    seed: int = 0,
    noise: float = 2.0,
    blur: float = 0.6,
    jpeg: int = 92,
    arc: float = 360.0,
    exif: bool = True,
    contrast: float = 1.0,
    repeat_m: float | None = None,
    back: bool = False,
    shots: Sequence[Shot] = (Shot(),),
    gains: Floats | None = None,
    gloss: float = 0.0,
    neighbour: bool = False,
) -> Walkaround:
    """Photograph the shell `views` times on `arc` degrees around it.

    noise  of the sensor, 1 sigma in 8-bit steps; blur: of the lens, 1 sigma in pixels; jpeg: quality of the files;
    exif   whether the files tell the focal length, as phones do.
    contrast  of the textures, 1: as of stone; 0.08: of unglazed clay on a plain table top
    repeat_m  side of the square that the table's texture repeats, as a printed cloth does; None: nowhere
    back      whether the walk turns half way, and goes back
    shots     how the photos are taken, again and again in this order
    gains     (views,3) of the linear light, besides the tenth by which exposures differ: exposure and white balance
    neighbour whether a box stands on the table beside the shell, a hand's breadth away
    gloss     light that the middle of the sun's reflection on shell and table adds, where white is 1
    """
    rng = np.random.default_rng(seed)
    beside = (
        _box(np.array([0.3, 0.1, FLOOR_Z]), np.array([0.13, 0.1, 0.16]), 0.7, np.array([1.0, 1, 0]))
        if neighbour
        else []
    )
    sheets = (_shell(), *_surroundings(rng, repeat_m), *beside)
    stage = _Stage(sheets, rng, contrast)
    poses = _walk(views, arc, rng, back=back)
    folder.mkdir(parents=True, exist_ok=True)
    photos = []
    gains = np.ones((views, 3)) if gains is None else gains
    for number, pose in enumerate(poses):
        shot = shots[number % len(shots)]
        if shot.upright == "tag":
            pose[:3, :3] = pose[:3, :3] @ _UPRIGHT
        camera = _camera(size[::-1] if shot.upright == "pixels" else size, shot.zoom)
        light = stage.picture(pose, camera, gloss) * gains[number].astype(np.float32)
        rgb = _developed(light, rng, noise=noise, blur=blur)
        path = folder / f"IMG_{number:04}.jpg"
        Image.fromarray(rgb).save(path, quality=jpeg, subsampling=1, exif=_exif(exif, shot))
        photos.append(path)
    return Walkaround(
        tuple(photos), _camera(size), poses, _mesh(sheets[:1]), FLOOR_Z, _mesh(beside) if beside else None
    )


def film_walkaround(
    views: int, arc: float, *, size: tuple[int, int] = (480, 360), noise_m: float = 0.002
) -> tuple[Frame, ...]:
    """The same walk with a depth camera of 60,000 steps of a millimetre: frames with true poses, in metres.

    noise_m  of the depth, 1 sigma at 1 m, growing with its square
    """
    rng = np.random.default_rng(0)
    stage, camera = _Stage((_shell(), *_surroundings(rng)), rng), _camera(size)
    x, y = (np.arange(camera.width) - camera.cx) / camera.fx, (np.arange(camera.height) - camera.cy) / camera.fy
    frames = []
    for number, pose in enumerate(_walk(views, arc, rng)):
        along = stage.scene.cast(pose[None, :3, 3], pinhole(x, y, *pose[:3, :3].T)).along
        depth_m = np.where(np.isfinite(along), along, 0).reshape(camera.height, camera.width)
        depth_m = depth_m + noise_m * depth_m**2 * rng.standard_normal(depth_m.shape)
        rgb = _developed(stage.picture(pose, camera), rng, noise=2.0, blur=0.6)
        load_depth_m = partial(np.asarray, np.round(depth_m, 3).clip(0, 60).astype(np.float32))
        frames.append(Frame(f"{number:02}", camera, pose, load_depth_m, load_rgb=partial(np.asarray, rgb)))
    return tuple(frames)


def _camera(size: tuple[int, int], zoom: int = 1) -> Intrinsics:
    width, height = size
    focal = zoom * FOCAL_35MM / DIAGONAL_35MM * float(np.hypot(width, height))
    return Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)


def _exif(tells: bool, shot: Shot = Shot()) -> Image.Exif:
    exif = Image.Exif()
    if shot.upright == "tag":
        exif[0x0112] = 6  # to be turned clockwise by a quarter to be upright
    if tells:
        exif[0x010F], exif[0x0110] = "Phone Maker", "Phone 9"
        exif.get_ifd(0x8769)[0xA405] = shot.zoom * FOCAL_35MM
    return exif


def _walk(views: int, arc: float, rng: np.random.Generator, *, back: bool = False) -> Floats:
    """(views,4,4): the way of a hand that rises and sinks, aims a little off and does not hold level."""
    poses = []
    way = np.linspace(0, arc, views, endpoint=arc < 360)
    way = np.minimum(2 * way, 2 * arc - 2 * way) if back else way
    for turn in np.radians(way + rng.uniform(-1.5, 1.5, views)):
        radius, height = 0.78 + rng.uniform(-0.04, 0.04), 0.52 + 0.14 * np.sin(3 * turn) + rng.uniform(-0.02, 0.02)
        target = np.array([0, 0, 0.15]) + rng.uniform(-0.02, 0.02, 3)
        up = np.array([0, 0, 1]) + rng.normal(0, 0.03, 3)
        poses.append(look_at([radius * np.cos(turn), radius * np.sin(turn), height], target, up))
    return np.stack(poses)


def _shell() -> Sheet:
    """A bumpy seat: a wall bent round three quarters of a circle, high at the back, low at its ends, standing free."""
    u, v = np.meshgrid(np.linspace(0, 1, 241), np.linspace(0, 1, 121), indexing="ij")
    turn = 1.55 * np.pi * (u - 0.5)
    radius = 0.13 + 0.04 * v**2 + 0.010 * np.sin(7 * turn) + 0.006 * np.sin(14 * v + 3 * turn)
    height = v * (0.27 + 0.12 * np.cos(turn) + 0.012 * np.sin(6 * turn))
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), height + FLOOR_Z], axis=-1)
    return Sheet(points, (3, 3), np.array([[0.80, 0.42, 0.20], [0.30, 0.12, 0.08], [0.85, 0.74, 0.50]]))


def _surroundings(rng: np.random.Generator, repeat_m: float | None = None) -> list[Sheet]:
    """The table and, further away on it, boxes of several colours."""
    side = 1.1
    corners = [[[-side, -side, FLOOR_Z], [-side, side, FLOOR_Z]], [[side, -side, FLOOR_Z], [side, side, FLOOR_Z]]]
    wood = np.array([[0.55, 0.45, 0.34], [0.36, 0.27, 0.19], [0.60, 0.53, 0.43]])
    sheets = [Sheet(np.array(corners), (1400, 1400), wood, repeat_m)]
    for turn, colour in zip((0.5, 1.9, 3.0, 4.4, 5.5), np.eye(3)[[0, 2, 1, 0, 2]], strict=True):
        away = rng.uniform(0.55, 0.8)
        size = rng.uniform(0.08, 0.18, 3)
        sheets += _box(np.array([away * np.cos(turn), away * np.sin(turn), FLOOR_Z]), size, turn + 0.4, colour)
    return sheets


def _box(at: Floats, size: Floats, turn: float, colour: Floats) -> list[Sheet]:
    """The five sides of a box that show."""
    along = np.array([np.cos(turn), np.sin(turn), 0]) * size[0]
    across = np.array([-np.sin(turn), np.cos(turn), 0]) * size[1]
    up = np.array([0, 0, size[2]])
    origin = at - (along + across) / 2
    sides = [(origin + up, along, across)]
    sides += [(origin, along, up), (origin + across, along, up), (origin, across, up), (origin + along, across, up)]
    colours = np.clip(np.stack([0.25 + 0.5 * colour, 0.08 + 0.3 * colour, 0.6 + 0.35 * colour]), 0, 1)
    sheets = []
    for corner, a, b in sides:
        texels = (round(float(np.linalg.norm(a)) / _TEXEL_M), round(float(np.linalg.norm(b)) / _TEXEL_M))
        sheets.append(Sheet(np.array([[corner, corner + b], [corner + a, corner + a + b]]), texels, colours))
    return sheets


class _Stage:
    """All sheets as one mesh and one atlas of lit texels; `corners` (F,3,2) are the places of the faces in it."""

    def __init__(self, sheets: Sequence[Sheet], rng: np.random.Generator, contrast: float = 1.0) -> None:
        mesh = _mesh(sheets)
        self.scene, self.normals = RaycastingScene(mesh), face_normals(mesh.vertices, mesh.faces)
        lattices = rng.random((2, 32, 32, 32), dtype=np.float32)
        lit = [_lit(sheet, self.scene, lattices, rng, contrast) for sheet in sheets]
        width = max(texture.shape[1] for texture in lit)
        self.atlas = np.concatenate([_widened(texture, width) for texture in lit])
        tops = np.cumsum([0, *(len(texture) for texture in lit[:-1])])
        self.corners = np.concatenate([_corners(*found) for found in zip(sheets, tops, strict=True)])

    def picture(self, pose: Floats, camera: Intrinsics, gloss: float = 0.0) -> Floats:
        """(H,W,3) float32 linear, 0..1 without gloss."""
        fine = camera.scaled_to(camera.width * _SAMPLES, camera.height * _SAMPLES)
        x = ((np.arange(fine.width) - fine.cx) / fine.fx).astype(np.float32)
        y = ((np.arange(fine.height) - fine.cy) / fine.fy).astype(np.float32)
        rays = pinhole(x, y, *pose[:3, :3].T)
        hits = self.scene.cast(pose[None, :3, 3], rays)
        place = np.einsum("nk,nkc->nc", hits.bary, self.corners[hits.face])
        place = place.reshape(fine.height, fine.width, 2)
        seen = cv2.remap(self.atlas, place[..., 0], place[..., 1], cv2.INTER_LINEAR)
        if gloss:
            seen += gloss * _highlight(self.normals[hits.face], rays).reshape(fine.height, fine.width, 1)
        missed = (hits.face < 0).reshape(fine.height, fine.width)
        seen[missed] = _room(rays.reshape(fine.height, fine.width, 3)[missed])
        return np.asarray(cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA))


def _highlight(normals: Floats, rays: Floats) -> Floats:
    """(N,) float32 in 0..1: the sun's reflection on either side of surfaces with normals (N,3), in no shadow."""
    sun = _SUN / np.linalg.norm(_SUN)
    half = sun - rays / np.linalg.norm(rays, axis=1, keepdims=True)
    cosine = np.einsum("nx,nx->n", normals, half)
    cosine /= np.maximum(np.linalg.norm(normals, axis=1) * np.linalg.norm(half, axis=1), 1e-12)
    lit = np.einsum("nx,nx->n", normals, rays) * (normals @ sun) < 0  # the camera is on the sun's side
    return np.asarray(np.where(lit, np.abs(cosine) ** _GLOSS_POWER, 0), np.float32)


def _room(rays: Floats) -> Floats:
    """(N,3) the wall behind the table: smooth, and as far away as the sky."""
    up = rays[:, 2:] / np.linalg.norm(rays, axis=1, keepdims=True)
    return (0.30 + 0.25 * up) * np.array([0.95, 1.0, 1.05], np.float32)


def _developed(linear: Floats, rng: np.random.Generator, *, noise: float, blur: float) -> Bytes:
    """(H,W,3) uint8: exposure that differs by up to a tenth between pictures, a soft lens, a gamma curve, a sensor."""
    exposed = linear * np.float32(rng.uniform(0.9, 1.1))
    if blur > 0:
        exposed = cv2.GaussianBlur(exposed, (0, 0), blur)
    tones = 255 * np.clip(exposed, 0, 1) ** np.float32(1 / 2.2)
    tones += noise * rng.standard_normal(tones.shape, dtype=np.float32)
    return np.asarray(np.clip(np.rint(tones), 0, 255), np.uint8)


def _mesh(sheets: Sequence[Sheet]) -> Mesh:
    starts = np.cumsum([0, *(sheet.points.shape[0] * sheet.points.shape[1] for sheet in sheets[:-1])])
    vertices = np.concatenate([sheet.points.reshape(-1, 3) for sheet in sheets])
    faces = np.concatenate([_faces(sheet) + start for sheet, start in zip(sheets, starts, strict=True)])
    return Mesh(vertices, faces)


def _faces(sheet: Sheet) -> np.ndarray:
    rows, columns = sheet.points.shape[:2]
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(), corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def _corners(sheet: Sheet, top: int) -> Floats:
    """(F,3,2) float32 column and row in the atlas of each face's corners."""
    rows, columns = sheet.points.shape[:2]
    row, column = np.mgrid[:rows, :columns]
    place = np.stack([column * sheet.texels[1], row * sheet.texels[0] + top], axis=-1).reshape(-1, 2)
    return place[_faces(sheet)].astype(np.float32)


def _texel_grid(sheet: Sheet, values: Floats) -> Floats:
    """(h,w,3): what stands at the grid's points, between them in straight lines; a texel on every point."""
    rows, columns = values.shape[:2]
    row = np.linspace(0, rows - 1, (rows - 1) * sheet.texels[0] + 1, dtype=np.float32)
    column = np.linspace(0, columns - 1, (columns - 1) * sheet.texels[1] + 1, dtype=np.float32)
    return np.asarray(cv2.remap(values.astype(np.float32), *np.meshgrid(column, row), cv2.INTER_LINEAR))


def _lit(sheet: Sheet, scene: RaycastingScene, lattices: Floats, rng: np.random.Generator, contrast: float) -> Floats:
    """(h,w,3) float32: the colours of a sheet's texels in Lambert's light and soft shadow, alike on both sides."""
    xyz = _texel_grid(sheet, sheet.points)
    along, across = np.gradient(sheet.points, axis=(0, 1))
    normals = np.cross(along, across)
    normals = _texel_grid(sheet, normals / np.linalg.norm(normals, axis=-1, keepdims=True))
    sun = _SUN / np.linalg.norm(_SUN)
    towards = sun + _SUN_RADIUS * rng.standard_normal((xyz[..., 0].size, 3))
    above = 2e-3 * np.sign(normals @ sun)[..., None] * normals  # off the surface, so that it does not shade itself
    shaded = scene.blocked((xyz + above).reshape(-1, 3), towards, 3.0).reshape(xyz.shape[:2])
    shaded = cv2.blur(shaded.astype(np.float32), (9, 9))  # one ray for each texel: its neighbours make it a share
    light = _AMBIENT + (1 - _AMBIENT) * np.abs(normals @ sun) * (1 - shaded)
    texture = _texture(xyz if sheet.repeat_m is None else np.mod(xyz, sheet.repeat_m), sheet.colours, lattices)
    mean = texture.mean(axis=(0, 1))
    return np.asarray((mean + contrast * (texture - mean)) * light[..., None], np.float32)


def _texture(xyz: Floats, colours: Floats, lattices: Floats) -> Floats:
    """(h,w,3): two noises mix three colours."""
    light, hue = (_noise(xyz, lattice) for lattice in lattices)
    base = colours[0] + (colours[1] - colours[0]) * np.clip(2 * hue - 0.5, 0, 1)[..., None]
    mixed: Floats = base + (colours[2] - base) * np.clip(3 * light - 1.2, 0, 1)[..., None]
    return mixed * (0.55 + 0.9 * light[..., None])


def _noise(xyz: Floats, lattice: Floats) -> Floats:
    """(h,w) in about 0..1: octaves of a periodic lattice of random values, each of half the size and 0.9 the weight."""
    total = np.zeros(xyz.shape[:2], np.float32)
    for octave in range(_OCTAVES):
        place = xyz * np.float32(2**octave / _COARSEST_M) + np.float32(7.3 * octave)
        values = map_coordinates(lattice, np.moveaxis(place, -1, 0), order=1, mode="grid-wrap")
        total += np.float32(0.9**octave) * (values - np.float32(0.5))
    return 0.5 + total * np.float32(0.7)


def _widened(texture: Floats, width: int) -> Floats:
    return np.pad(texture, ((0, 0), (0, width - texture.shape[1]), (0, 0)))
