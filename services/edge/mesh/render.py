"""A picture of a mesh from four sides, without a GPU: what people look at before they open a viewer.

Light comes from over the viewer's left shoulder with real shadows, from a bright sky and from a dim floor; corners and
the insides of folds are darkened by the share of sky they see. That is what makes cloth read as cloth.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np

from services.edge.arrays import Bytes, Floats, Ints, Tick, no_tick
from services.edge.mesh.normals import face_normals, split_flips, vertex_normals
from services.edge.mesh.nouns import Mesh
from services.edge.mesh.rays import LIFT, Scene, open_sky, pinhole
from services.edge.srgb import to_linear, to_srgb
from services.edge.threads import in_threads

_AZIMUTHS = (25.0, 115.0, 205.0, 295.0)  # degrees about Y from +Z: front, right, back, left, each turned to show depth
_ELEVATION = 15.0  # degrees: high enough to look into an open neck, low enough to see under a hem
_HALF_VIEW = 0.25  # tangent of half the field of view: about 28°, a portrait lens
_MARGIN = 1.06  # of the tightest fit
_SAMPLES = 2  # rays per pixel along each axis
_CLAY = 0.42  # linear grey of a mesh without colours
_BACKDROP = (232, 208)  # sRGB grey at the top and at the bottom of a view
_SKY_RAYS = 1_000_000  # for the whole mesh, both sides: 0.2 s on two cores
_KEY, _SKY, _FLOOR, _RIM = (
    0.85,
    0.62,
    0.28,
    0.10,
)  # lights; facing the key under an open sky, white stays just unclipped


def render_sheet(mesh: Mesh, *, size: int = 512, tick: Tick = no_tick) -> bytes:
    """PNG of (2·size)² pixels: the mesh, Y up, from front, right, back and left, all at one scale.

    `tick` is called before the views and after each, with the fraction done. Raises ValueError if there are no faces.
    """
    from PIL import Image

    if len(mesh.faces) == 0:
        raise ValueError("a mesh without faces has no picture")
    subject = _Subject.of(mesh)
    tick(0)
    views = in_threads(lambda camera: _view(subject, camera, size), _cameras(mesh.vertices), tick)
    sheet = np.concatenate([np.concatenate(views[:2], axis=1), np.concatenate(views[2:], axis=1)])
    out = BytesIO()
    Image.fromarray(sheet).save(out, "PNG", compress_level=6)
    return out.getvalue()


@dataclass(frozen=True, slots=True)
class _Subject:
    """The mesh ready for shading, all float32.

    Of each face: unit normal. Of each vertex: smooth normal; linear colour; shares of sky seen before and behind it.
    """

    mesh: Mesh
    scene: Scene
    face_normals: Floats
    normals: Floats
    colours: Floats
    open_sky: Floats

    @classmethod
    def of(cls, mesh: Mesh) -> _Subject:
        mesh = split_flips(mesh)
        scene = Scene(mesh)
        flat = face_normals(mesh.vertices, mesh.faces)
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
        normals = vertex_normals(mesh).astype(np.float32)
        colours = np.full((len(normals), 3), _CLAY, np.float32) if mesh.rgb is None else to_linear(mesh.rgb)
        vertices = mesh.vertices.astype(np.float32)
        rays = int(np.clip(_SKY_RAYS // (2 * len(normals)), 4, 64))
        sides = in_threads(lambda side: open_sky(scene, vertices, side * normals, rays=rays), (1.0, -1.0))
        return cls(mesh, scene, flat.astype(np.float32), normals, colours, np.stack(sides, axis=1))


@dataclass(frozen=True, slots=True)
class _Camera:
    """eye (3,); right, up, ahead: unit vectors (3,); float32."""

    eye: Floats
    right: Floats
    up: Floats
    ahead: Floats


def _cameras(vertices: Floats) -> list[_Camera]:
    """The four cameras, all as far away as the one that needs most room."""
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    axes = [_axes(np.radians(azimuth), np.radians(_ELEVATION)) for azimuth in _AZIMUTHS]
    away = 0.0
    for right, up, ahead in axes:
        sideways = np.abs((vertices - centre) @ np.stack([right, up], axis=1)).max(axis=1)
        away = max(away, float((_MARGIN * sideways / _HALF_VIEW - (vertices - centre) @ ahead).max()))
    placed = [(centre - away * ahead, right, up, ahead) for right, up, ahead in axes]
    return [_Camera(*(vector.astype(np.float32) for vector in camera)) for camera in placed]


def _axes(azimuth: float, elevation: float) -> tuple[Floats, Floats, Floats]:
    ahead = -np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])
    right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    return right, np.cross(right, ahead), ahead


def _view(subject: _Subject, camera: _Camera, size: int) -> Bytes:
    """(size,size,3) uint8 sRGB."""
    sheet = np.repeat(_backdrop(size), size, axis=1)
    rows, columns = _frame(subject.mesh.vertices, camera, size)
    x, y = (_steps(part, size) for part in (columns, rows))
    rays = pinhole(x, y, camera.right, -camera.up, camera.ahead)
    hits = subject.scene.cast(camera.eye[None], rays)
    light = np.repeat(np.repeat(sheet[rows, columns], _SAMPLES, axis=0), _SAMPLES, axis=1).reshape(-1, 3)
    seen = np.flatnonzero(hits.face >= 0)
    light[seen] = _shade(subject, camera, rays[seen], hits.face[seen], hits.along[seen], hits.bary[seen])
    fine = np.clip(light, 0, 1).reshape(len(y), len(x), 3)
    picks = [fine[i::_SAMPLES, j::_SAMPLES] for i in range(_SAMPLES) for j in range(_SAMPLES)]
    sheet[rows, columns] = sum(picks[1:], start=picks[0]) / len(picks)
    return to_srgb(sheet)


def _frame(vertices: Floats, camera: _Camera, size: int) -> tuple[slice, slice]:
    """Rows and columns of pixels that the mesh can reach: nothing needs tracing outside."""
    seen = (vertices - camera.eye) @ np.stack([camera.right, -camera.up, camera.ahead], axis=1)
    pixels = (seen[:, :2] / seen[:, 2:] / _HALF_VIEW + 1) / 2 * size
    low = np.clip(np.floor(pixels.min(axis=0)), 0, size - 1).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)), low + 1, size).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _steps(pixels: slice, size: int) -> Floats:
    """Offsets of the samples' rays from the view's middle, per length ahead."""
    fine = np.arange(pixels.start * _SAMPLES, pixels.stop * _SAMPLES, dtype=np.float32) + 0.5
    offsets: Floats = (fine / (size * _SAMPLES) * 2 - 1) * np.float32(_HALF_VIEW)
    return offsets


def _shade(subject: _Subject, camera: _Camera, rays: Floats, face: Ints, along: Floats, bary: Floats) -> Floats:
    """(N,3) linear light that the hits send back along their rays; either side of a face is its front."""
    corners = subject.mesh.faces[face]
    flat = subject.face_normals[face]
    side = -np.sign(np.einsum("nx,nx->n", flat, rays))[:, None]
    normal = side * _blend(subject.normals, corners, bary)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    before, behind = _blend(subject.open_sky, corners, bary).T
    sky_share = np.where(side[:, 0] > 0, before, behind)

    key = _key_direction(camera)
    facing = np.maximum(normal @ key, 0.0)
    start = camera.eye + along[:, None] * rays + side * flat * np.float32(LIFT * subject.scene.longest)
    lit = np.flatnonzero(facing > 0)
    facing[lit[subject.scene.blocked(start[lit], np.tile(key, (len(lit), 1)), 2 * subject.scene.longest)]] = 0.0
    ambient = sky_share * (_FLOOR + (_SKY - _FLOOR) * (0.5 + 0.5 * normal[:, 1]))
    grazing = 1.0 - np.abs(np.einsum("nx,nx->n", normal, rays)) / np.linalg.norm(rays, axis=1)
    amount = _KEY * facing + ambient + _RIM * sky_share * grazing**3
    shaded: Floats = amount[:, None] * _blend(subject.colours, corners, bary)
    return shaded


def _key_direction(camera: _Camera) -> Floats:
    towards = -0.55 * camera.right + 0.75 * camera.up - 0.65 * camera.ahead
    unit: Floats = towards / np.linalg.norm(towards)
    return unit


def _blend(values: Floats, corners: Ints, bary: Floats) -> Floats:
    """Per-vertex values (V,C) at points of faces: corners (N,3), bary (N,3) -> (N,C)."""
    mixed: Floats = bary[:, :1] * values[corners[:, 0]]
    for corner in (1, 2):
        mixed += bary[:, corner : corner + 1] * values[corners[:, corner]]
    return mixed


def _backdrop(rows: int) -> Floats:
    """(rows,1,3) linear grey, lighter at the top."""
    top, bottom = (to_linear(np.full((1, 3), grey, dtype=np.uint8)) for grey in _BACKDROP)
    down = np.linspace(0, 1, rows, dtype=np.float32)[:, None, None]
    shades: Floats = (1 - down) * top + down * bottom
    return shades
