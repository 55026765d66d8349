"""A mesh seen from anywhere, without a GPU: its light and how much of each pixel it covers.

Light comes from over the viewer's left shoulder with real shadows, from a bright sky and from a dim floor; corners and
the insides of folds are darkened by the share of sky they see. That is what makes cloth read as cloth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np

from services.edge.arrays import Bytes, Floats
from services.edge.mesh.normals import face_normals
from services.edge.mesh.nouns import Mesh, Textured
from services.edge.mesh.rays import LIFT, Hits, Scene, open_sky, pinhole
from services.edge.mesh.shaded import Shaded, shaded
from services.edge.srgb import to_linear
from services.edge.threads import in_threads

_HALF_VIEW = 0.25  # tangent of half the field of view: about 28°, a portrait lens
_MARGIN = 1.06  # of the tightest fit
_NEAREST = 1.5  # longest sides from the middle: outside even of what shows only its end, or has no size at all
_SAMPLES = 2  # rays per pixel along each axis
_CLAY = 0.42  # linear grey of a mesh without colours
SKY_RAYS = 1_000_000  # for the whole mesh, both sides: 0.2 s on two cores
_TEXELS = 4  # of a picture's side for each pixel of a view's: finer ones would only flicker between pixels
_KEY, _SKY, _FLOOR, _RIM = (
    0.85,
    0.62,
    0.28,
    0.10,
)  # lights; facing the key under an open sky, white stays just unclipped


@dataclass(frozen=True, slots=True)
class Subject:
    """The mesh ready for shading; centred, its longest side 1, so that no size is too large or too small.

    face_normals  (F,3) float32 unit length
    traits        (V,7 or 8) float32, all that varies over a face, side by side because it is read together: smooth
                  normal (3), share of sky seen before and behind (2), linear colour (3) or place in the texture (2)
    texture       (S,S,3) uint8 sRGB, or None
    """

    mesh: Mesh
    scene: Scene
    face_normals: Floats
    traits: Floats
    texture: Bytes | None

    @classmethod
    def of(cls, subject: Mesh | Textured, size: int, *, sky_rays: int = SKY_RAYS) -> Subject:
        """For views of size² pixels. sky_rays: for the whole mesh, both sides. Raises ValueError without faces."""
        surface = shaded(subject)
        mesh = _unit(surface.mesh)
        scene = Scene(mesh)
        flat = face_normals(mesh.vertices, mesh.faces)
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
        normals, vertices = surface.normals.astype(np.float32), mesh.vertices.astype(np.float32)
        rays = int(np.clip(sky_rays // (2 * len(normals)), 4, 64))
        sides = in_threads(lambda side: open_sky(scene, vertices, side * normals, rays=rays), (1.0, -1.0))
        texture = _texture(subject.jpeg, _TEXELS * size) if isinstance(subject, Textured) else None
        sky = [_smoothed(mesh, side) for side in sides]
        traits = np.column_stack([normals, *sky, _colours(surface)]).astype(np.float32)
        return cls(mesh, scene, flat.astype(np.float32), traits, texture)

    def met(self, hits: Hits) -> tuple[Floats, Floats, Floats]:
        """What is where faces were hit: normals (N,3) of any length, open sky (N,2), linear colour (N,3)."""
        corners = self.mesh.faces[hits.face]
        mixed: Floats = hits.bary[:, :1] * self.traits.take(corners[:, 0], axis=0)
        for corner in (1, 2):
            mixed += hits.bary[:, corner : corner + 1] * self.traits.take(corners[:, corner], axis=0)
        return mixed[:, :3], mixed[:, 3:5], self._colour(mixed[:, 5:])

    def _colour(self, blended: Floats) -> Floats:
        if self.texture is None:
            return blended
        side = np.array(self.texture.shape[1::-1])
        x, y = np.clip((blended * side).astype(np.int64), 0, side - 1).T
        return to_linear(self.texture[y, x])


@dataclass(frozen=True, slots=True)
class Camera:
    """eye (3,); right, up, ahead: unit vectors (3,); float32, in the subject's frame."""

    eye: Floats
    right: Floats
    up: Floats
    ahead: Floats


@dataclass(frozen=True, slots=True)
class View:
    """light (H,W,3) float32 linear, already times cover; cover (H,W,1) float32: how much of a pixel it fills."""

    light: Floats
    cover: Floats


def cameras(subject: Subject, azimuths: Sequence[float], elevation: float) -> list[Camera]:
    """Cameras by degrees about Y from +Z towards +X, and above the floor; all as far off as the one that must be."""
    axes = [_axes(np.radians(azimuth), np.radians(elevation)) for azimuth in azimuths]
    vertices = subject.mesh.vertices
    away = _NEAREST
    for right, up, ahead in axes:
        sideways = np.abs(vertices @ np.stack([right, up], axis=1)).max(axis=1)
        away = max(away, float((_MARGIN * sideways / _HALF_VIEW - vertices @ ahead).max()))
    placed = [(-away * ahead, right, up, ahead) for right, up, ahead in axes]
    return [Camera(*(vector.astype(np.float32) for vector in camera)) for camera in placed]


def view(subject: Subject, camera: Camera, size: int) -> View:
    """What the camera sees, size × size pixels."""
    light, cover = np.zeros((size, size, 3), np.float32), np.zeros((size, size, 1), np.float32)
    rows, columns = _frame(subject.mesh.vertices, camera, size)
    x, y = (_steps(part, size) for part in (columns, rows))
    rays = pinhole(x, y, camera.right, -camera.up, camera.ahead)
    hits = subject.scene.cast(camera.eye[None], rays)
    seen = np.flatnonzero(hits.face >= 0)
    fine = np.zeros((len(rays), 4), np.float32)
    fine[seen, :3] = _shade(subject, camera, rays[seen], Hits(hits.face[seen], hits.along[seen], hits.bary[seen]))
    fine[seen, 3] = 1
    samples = np.clip(fine, 0, 1).reshape(len(y), len(x), 4)
    picks = [samples[i::_SAMPLES, j::_SAMPLES] for i in range(_SAMPLES) for j in range(_SAMPLES)]
    pixels = sum(picks[1:], start=picks[0]) / len(picks)
    light[rows, columns], cover[rows, columns] = pixels[..., :3], pixels[..., 3:]
    return View(light, cover)


def _smoothed(mesh: Mesh, shares: Floats) -> Floats:
    """(V,) the mean over the faces around each vertex: few rays a vertex leave a grain that many vertices do not."""
    corner, count = mesh.faces.ravel(), len(mesh.vertices)
    around = np.bincount(corner, np.repeat(shares[mesh.faces].mean(axis=1), 3), count)
    smooth: Floats = around / np.maximum(np.bincount(corner, minlength=count), 1)
    return smooth


def _colours(surface: Shaded) -> Floats:
    """(V,2) places in the picture, or (V,3) linear light."""
    if surface.uv is not None:
        return surface.uv
    if surface.mesh.rgb is not None:
        return to_linear(surface.mesh.rgb)
    return np.full((len(surface.normals), 3), _CLAY)


def _unit(mesh: Mesh) -> Mesh:
    if len(mesh.faces) == 0:
        raise ValueError("a mesh without faces has no picture")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    longest = float((high - low).max()) or 1.0
    return Mesh((mesh.vertices - (low / 2 + high / 2)) / longest, mesh.faces, mesh.rgb)


def _texture(jpeg: bytes, side: int) -> Bytes:
    """The picture, no smaller than `side` where it is as large, and less than twice that."""
    from PIL import Image

    with Image.open(BytesIO(jpeg)) as picture:
        picture.draft("RGB", (side, side))  # JPEG can leave out detail while it is read
        return np.asarray(picture.convert("RGB"))


def _axes(azimuth: float, elevation: float) -> tuple[Floats, Floats, Floats]:
    ahead = -np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])
    right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    return right, np.cross(right, ahead), ahead


def _frame(vertices: Floats, camera: Camera, size: int) -> tuple[slice, slice]:
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


def _shade(subject: Subject, camera: Camera, rays: Floats, hits: Hits) -> Floats:
    """(N,3) linear light that the hits send back along their rays; either side of a face is its front."""
    flat = subject.face_normals[hits.face]
    side = -np.sign(np.einsum("nx,nx->n", flat, rays))[:, None]
    normal, sky, colour = subject.met(hits)
    normal = side * normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    before, behind = sky.T
    sky_share = np.where(side[:, 0] > 0, before, behind)

    key = _key_direction(camera)
    facing = np.maximum(normal @ key, 0.0)
    start = camera.eye + hits.along[:, None] * rays + side * flat * np.float32(LIFT * subject.scene.longest)
    lit = np.flatnonzero(facing > 0)
    facing[lit[subject.scene.blocked(start[lit], np.tile(key, (len(lit), 1)), 2 * subject.scene.longest)]] = 0.0
    ambient = sky_share * (_FLOOR + (_SKY - _FLOOR) * (0.5 + 0.5 * normal[:, 1]))
    grazing = 1.0 - np.abs(np.einsum("nx,nx->n", normal, rays)) / np.linalg.norm(rays, axis=1)
    amount = _KEY * facing + ambient + _RIM * sky_share * grazing**3
    shaded_light: Floats = amount[:, None] * colour
    return shaded_light


def _key_direction(camera: Camera) -> Floats:
    towards = -0.55 * camera.right + 0.75 * camera.up - 0.65 * camera.ahead
    unit: Floats = towards / np.linalg.norm(towards)
    return unit
