"""Render a mesh by ray casting, without a GPU: linear light and coverage of each pixel.

The key light comes from over the viewer's left shoulder and casts shadows; a bright sky and a dim floor add ambient
light, which ambient occlusion darkens in corners and folds. That is what makes cloth look like cloth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.export.shading import Shaded, shaded
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.render.rays import LIFT, Hits, RaycastingScene, open_sky, pinhole
from capture2vr.edge.srgb import to_linear

_HALF_VIEW = 0.25  # tangent of half the field of view: about 28°, a portrait lens
_MARGIN = 1.06  # times the tightest fit of the mesh in the view
_NEAREST = 1.5  # longest sides, the camera's least distance from the centre: outside any mesh, even seen end-on
_SAMPLES = 2  # rays per pixel along each axis
_CLAY = 0.42  # linear grey of a mesh without colours
SKY_RAYS = 1_000_000  # for the whole mesh, both sides: 0.2 s on two cores
_TEXELS = 4  # texels of a texture's side per pixel of a view's side: finer ones would only alias
# Brightness of the lights: white that faces the key light under an open sky is just not clipped.
_KEY, _SKY, _FLOOR, _RIM = 0.85, 0.62, 0.28, 0.10


@dataclass(frozen=True, slots=True)
class RenderMesh:
    """A mesh prepared for rendering: centred, its longest side 1, with everything that shading needs.

    face_normals  (F,3) float32 unit length
    attributes    (V,7 or 8) float32 vertex attributes, in one array because they are read together: smooth normal (3),
                  open sky in front and behind (2), linear colour (3) or texture coordinates (2)
    texture       (S,S,3) uint8 sRGB, or None
    """

    mesh: Mesh
    scene: RaycastingScene
    face_normals: Floats
    attributes: Floats
    texture: Bytes | None

    @classmethod
    def of(cls, subject: Mesh | TexturedMesh, size: int, *, sky_rays: int = SKY_RAYS) -> RenderMesh:
        """Prepare a mesh for views of size² pixels. Raises ValueError without faces.

        sky_rays  rays of the ambient occlusion, for the whole mesh and both sides
        """
        surface = shaded(subject)
        mesh = _to_unit(surface.mesh)
        scene = RaycastingScene(mesh)
        flat = face_normals(mesh.vertices, mesh.faces)
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
        normals, vertices = surface.normals.astype(np.float32), mesh.vertices.astype(np.float32)
        rays = int(np.clip(sky_rays // (2 * len(normals)), 4, 64))
        sides = in_threads(lambda side: open_sky(scene, vertices, side * normals, rays=rays), (1.0, -1.0))
        texture = _texture(subject.jpeg, _TEXELS * size) if isinstance(subject, TexturedMesh) else None
        sky = [_smooth(mesh, side) for side in sides]
        attributes = np.column_stack([normals, *sky, _colours(surface)]).astype(np.float32)
        return cls(mesh, scene, flat.astype(np.float32), attributes, texture)

    def interpolate_at(self, hits: Hits) -> tuple[Floats, Floats, Floats]:
        """Interpolate at hits: normals (N,3) of any length, open sky (N,2), linear colour (N,3)."""
        corners = self.mesh.faces[hits.face]
        mixed: Floats = hits.bary[:, :1] * self.attributes.take(corners[:, 0], axis=0)
        for corner in (1, 2):
            mixed += hits.bary[:, corner : corner + 1] * self.attributes.take(corners[:, corner], axis=0)
        return mixed[:, :3], mixed[:, 3:5], self._colour(mixed[:, 5:])

    def _colour(self, interpolated: Floats) -> Floats:
        """(N,3) linear colour: as interpolated, or looked up in the texture at interpolated coordinates (N,2)."""
        if self.texture is None:
            return interpolated
        side = np.array(self.texture.shape[1::-1])
        x, y = np.clip((interpolated * side).astype(np.int64), 0, side - 1).T
        return to_linear(self.texture[y, x])


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera: its position eye (3,), and unit vectors right, up, ahead (3,); float32, in the subject's frame."""

    eye: Floats
    right: Floats
    up: Floats
    ahead: Floats


@dataclass(frozen=True, slots=True)
class RenderedView:
    """A rendered image: light (H,W,3) float32 linear, premultiplied by cover; cover (H,W,1) float32: pixel coverage."""

    light: Floats
    cover: Floats


def place_cameras(subject: RenderMesh, azimuths: Sequence[float], elevation: float) -> list[Camera]:
    """Place cameras that look at the mesh's centre, all at the least distance at which each sees the whole mesh.

    azimuths, elevation  degrees: about Y from +Z towards +X, and above the floor
    """
    axes = [_axes(np.radians(azimuth), np.radians(elevation)) for azimuth in azimuths]
    vertices = subject.mesh.vertices
    away = _NEAREST
    for right, up, ahead in axes:
        sideways = np.abs(vertices @ np.stack([right, up], axis=1)).max(axis=1)
        away = max(away, float((_MARGIN * sideways / _HALF_VIEW - vertices @ ahead).max()))
    vectors = [(-away * ahead, right, up, ahead) for right, up, ahead in axes]
    return [Camera(*(vector.astype(np.float32) for vector in camera)) for camera in vectors]


def render_view(subject: RenderMesh, camera: Camera, size: int) -> RenderedView:
    """Render a camera's view of size × size pixels."""
    light, cover = np.zeros((size, size, 3), np.float32), np.zeros((size, size, 1), np.float32)
    rows, columns = _frame(subject.mesh.vertices, camera, size)
    x, y = (_sample_offsets(part, size) for part in (columns, rows))
    rays = pinhole(x, y, camera.right, -camera.up, camera.ahead)
    hits = subject.scene.cast(camera.eye[None], rays)
    hit = np.flatnonzero(hits.face >= 0)
    fine = np.zeros((len(rays), 4), np.float32)
    fine[hit, :3] = _shade(subject, camera, rays[hit], Hits(hits.face[hit], hits.along[hit], hits.bary[hit]))
    fine[hit, 3] = 1
    samples = np.clip(fine, 0, 1).reshape(len(y), len(x), 4)
    picks = [samples[i::_SAMPLES, j::_SAMPLES] for i in range(_SAMPLES) for j in range(_SAMPLES)]
    pixels = sum(picks[1:], start=picks[0]) / len(picks)
    light[rows, columns], cover[rows, columns] = pixels[..., :3], pixels[..., 3:]
    return RenderedView(light, cover)


def _smooth(mesh: Mesh, shares: Floats) -> Floats:
    """Average vertex values (V,) over the faces around each vertex: removes the noise of few rays per vertex."""
    corner, count = mesh.faces.ravel(), len(mesh.vertices)
    around = np.bincount(corner, np.repeat(shares[mesh.faces].mean(axis=1), 3), count)
    smooth: Floats = around / np.maximum(np.bincount(corner, minlength=count), 1)
    return smooth


def _colours(surface: Shaded) -> Floats:
    """(V,2) texture coordinates, or (V,3) linear light where there is no texture."""
    if surface.uv is not None:
        return surface.uv
    if surface.mesh.rgb is not None:
        return to_linear(surface.mesh.rgb)
    return np.full((len(surface.normals), 3), _CLAY)


def _to_unit(mesh: Mesh) -> Mesh:
    """Centre a mesh and scale its longest side to 1. Raises ValueError without faces."""
    if len(mesh.faces) == 0:
        raise ValueError("a mesh without faces cannot be rendered")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    longest = float((high - low).max()) or 1.0
    return Mesh((mesh.vertices - (low / 2 + high / 2)) / longest, mesh.faces, mesh.rgb)


def _texture(jpeg: bytes, side: int) -> Bytes:
    """Decode a JPEG, shrunk to less than twice `side` but not below it: (S,S,3) uint8."""
    from PIL import Image

    with Image.open(BytesIO(jpeg)) as picture:
        picture.draft("RGB", (side, side))  # a JPEG can be decoded at a lower resolution
        return np.asarray(picture.convert("RGB"))


def _axes(azimuth: float, elevation: float) -> tuple[Floats, Floats, Floats]:
    """right, up, ahead of a camera that looks at the origin; angles in radians."""
    ahead = -np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])
    right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    return right, np.cross(right, ahead), ahead


def _frame(vertices: Floats, camera: Camera, size: int) -> tuple[slice, slice]:
    """Rows and columns of the mesh's bounding box in the view: rays outside would hit nothing."""
    local = (vertices - camera.eye) @ np.stack([camera.right, -camera.up, camera.ahead], axis=1)
    pixels = (local[:, :2] / local[:, 2:] / _HALF_VIEW + 1) / 2 * size
    low = np.clip(np.floor(pixels.min(axis=0)), 0, size - 1).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)), low + 1, size).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _sample_offsets(pixels: slice, size: int) -> Floats:
    """Offsets of the samples' rays from the view's centre, per unit of length ahead."""
    fine = np.arange(pixels.start * _SAMPLES, pixels.stop * _SAMPLES, dtype=np.float32) + 0.5
    offsets: Floats = (fine / (size * _SAMPLES) * 2 - 1) * np.float32(_HALF_VIEW)
    return offsets


def _shade(subject: RenderMesh, camera: Camera, rays: Floats, hits: Hits) -> Floats:
    """(N,3) linear light that the hit points reflect towards the camera; faces are two-sided."""
    flat = subject.face_normals[hits.face]
    side = -np.sign(np.einsum("nx,nx->n", flat, rays))[:, None]
    normal, sky, colour = subject.interpolate_at(hits)
    normal = side * normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    front, back = sky.T
    sky_share = np.where(side[:, 0] > 0, front, back)

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
    """Unit vector (3,) towards the key light."""
    towards = -0.55 * camera.right + 0.75 * camera.up - 0.65 * camera.ahead
    unit: Floats = towards / np.linalg.norm(towards)
    return unit
