"""Light on surfaces of several materials, by ray casting: matt, glossy and clear ones in a room with a window.

Light is linear, 1 is white. A key light casts soft shadows, all else comes from everywhere and is kept out of corners;
glossy surfaces mirror stage and room, clear ones bend what is behind them. The room is infinitely far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.rays import RaycastingScene, open_sky, pinhole

_AMBIENT, _KEY = 0.5, 0.75
_SUNS = np.array([[0.45, -0.35, 0.82], [0.51, -0.31, 0.80], [0.41, -0.41, 0.82], [0.47, -0.40, 0.78]])
"""Towards four parts of the key light, one for each sample of a pixel."""
_OFFSETS = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]])  # pixels, of the samples
_LIFT_M = 2e-4  # off a surface, so that it does not hide itself
_SKY_RAYS, _SMOOTHINGS = 12, 12
_VOXELS, _PERIOD_M = 192, 0.25  # of the pattern: 1.3 mm a voxel, a pixel sees 1
_SLOPE = 1.1  # the pattern's amplitude falls with frequency to this power: it has detail of every size
_INDEX = 1.45  # of refraction of glass
_BOUNCES = 2


@dataclass(frozen=True, slots=True)
class Material:
    """What a surface does with light.

    dark, light  linear colours between which the pattern lies; where a mesh has colours these are its own
    mirrored     share of light that is mirrored when seen straight on; 0: matt
    clear        whether the rest goes through, bent, and not back
    """

    dark: tuple[float, float, float]
    light: tuple[float, float, float]
    mirrored: float = 0.0
    clear: bool = False


@dataclass(frozen=True, slots=True)
class _Surface:
    """Where N rays meet the stage: the ray's index, part, place, unit normal towards the ray, open sky, colour."""

    ray: Ints
    part: Ints
    place: Floats
    normal: Floats
    sky: Floats
    rgb: Floats


class Stage:
    """Meshes of one material each, in a room that is `bright` times as bright as usual."""

    def __init__(self, parts: Sequence[tuple[Mesh, Material]], bright: float = 1.0) -> None:
        self._materials, self._bright = [material for _, material in parts], bright
        meshes = [mesh for mesh, _ in parts]
        whole = concatenate(meshes)
        self.scene, self._faces = RaycastingScene(whole), whole.faces
        self.part = np.repeat(np.arange(len(parts)), [len(mesh.faces) for mesh in meshes])
        normals = np.concatenate([vertex_normals(mesh) for mesh in meshes]).astype(np.float32)
        vertices = whole.vertices.astype(np.float32)
        sky = [_smoothed(whole, open_sky(self.scene, vertices, side * normals, rays=_SKY_RAYS)) for side in (1, -1)]
        colours = [np.zeros((len(mesh.vertices), 3)) if mesh.rgb is None else _linear(mesh.rgb) for mesh in meshes]
        self._painted = np.array([mesh.rgb is not None for mesh in meshes])
        self._corner = np.column_stack([normals, *sky, np.concatenate(colours)]).astype(np.float32)
        self._pattern = _pattern()

    def picture(self, pose: Floats, camera: Intrinsics) -> Floats:
        """(H,W,3) float32 linear: what a camera with OpenCV axes sees, four samples a pixel."""
        seen = np.zeros((camera.height * camera.width, 3), np.float32)
        for sun, (right, down) in zip(_SUNS, _OFFSETS, strict=True):
            x = (np.arange(camera.width) + right - camera.cx) / camera.fx
            y = (np.arange(camera.height) + down - camera.cy) / camera.fy
            rays = pinhole(x, y, *pose[:3, :3].T)
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            seen += self._light(pose[None, :3, 3].astype(np.float32), rays, sun / np.linalg.norm(sun), _BOUNCES) / 4
        return seen.reshape(camera.height, camera.width, 3)

    def _light(self, origins: Floats, rays: Floats, sun: Floats, bounces: int) -> Floats:
        """(N,3) light against rays of unit length."""
        met = self._meet(origins, rays)
        light = self._behind(rays, met)
        towards = met.normal @ sun.astype(np.float32)
        start = met.place + _LIFT_M * met.normal
        lit = np.zeros(len(start), np.float32)
        day = np.flatnonzero(towards > 0)
        if len(day):
            suns = np.broadcast_to(sun.astype(np.float32), (len(day), 3))
            lit[day] = towards[day] * ~self.scene.blocked(start[day], suns, 2.0)
        light[met.ray] = self._albedo(met) * (_AMBIENT * met.sky + _KEY * lit)[:, None]
        for number, material in enumerate(self._materials):
            at = np.flatnonzero(met.part == number)
            if material.mirrored and len(at):
                light[met.ray[at]] = self._shine(number, rays[met.ray[at]], met, at, light[met.ray[at]], sun, bounces)
        return light

    def _shine(
        self, part: int, rays: Floats, met: _Surface, at: Ints, matt: Floats, sun: Floats, bounces: int
    ) -> Floats:
        """(K,3) light from the glossy surface at `at` of those met: mirrored and, in part, its own or from behind."""
        material, normal = self._materials[part], met.normal[at]
        cosine = -np.einsum("nx,nx->n", rays, normal)
        share = (material.mirrored + (1 - material.mirrored) * (1 - cosine.clip(0, 1)) ** 5)[:, None]
        start = met.place[at] + _LIFT_M * normal
        mirrored = self._further(start, _mirror(rays, normal), sun, bounces)
        if material.clear:
            inside = _refract(rays, normal, 1 / _INDEX)
            out = self._meet(met.place[at] - _LIFT_M * normal, inside)
            matt = self._behind(inside, out)
            leaving = _refract(inside[out.ray], out.normal, _INDEX)
            matt[out.ray] = self._further(out.place - _LIFT_M * out.normal, leaving, sun, bounces)
        seen: Floats = share * mirrored + (1 - share) * matt
        return seen

    def _further(self, origins: Floats, rays: Floats, sun: Floats, bounces: int) -> Floats:
        return self._light(origins, rays, sun, bounces - 1) if bounces else self._room(rays)

    def _behind(self, rays: Floats, met: _Surface) -> Floats:
        """(N,3) light of the room against the rays that meet nothing; 0 for the others."""
        missed = np.ones(len(rays), bool)
        missed[met.ray] = False
        light = np.zeros((len(rays), 3), np.float32)
        light[missed] = self._room(rays[missed])
        return light

    def _meet(self, origins: Floats, rays: Floats) -> _Surface:
        hits = self.scene.cast(origins, rays)
        ray = np.flatnonzero(hits.face >= 0)
        face, along = hits.face[ray], hits.along[ray, None]
        corner = self._corner[self._faces[face]]
        values = np.einsum("nc,ncx->nx", hits.bary[ray], corner)
        normal = values[:, :3]
        normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        back = np.einsum("nx,nx->n", normal, rays[ray]) > 0
        sky = np.where(back, values[:, 4], values[:, 3])
        normal = np.where(back[:, None], -normal, normal)
        place = np.broadcast_to(origins, rays.shape)[ray] + along * rays[ray]
        return _Surface(ray, self.part[face], place, normal, sky, values[:, 5:])

    def _albedo(self, met: _Surface) -> Floats:
        """(N,3) linear colours of surfaces; the second pattern makes them warmer and colder."""
        dark, light = (
            np.array([getattr(each, name) for each in self._materials], np.float32)[met.part]
            for name in ("dark", "light")
        )
        tone, hue = (self._at(pattern, met.place)[:, None] for pattern in self._pattern)
        plain = dark + (light - dark) * tone
        plain *= 1 + 0.5 * (hue - 0.5) * np.array([1, 0, -1], np.float32) * (dark != light)
        return np.where(self._painted[met.part, None], met.rgb, plain)

    def _at(self, pattern: Floats, places: Floats) -> Floats:
        voxel = places.T.astype(np.float32) * np.float32(_VOXELS / _PERIOD_M)
        found: Floats = map_coordinates(pattern, voxel, order=1, mode="grid-wrap")
        return found

    def _room(self, rays: Floats) -> Floats:
        """(N,3) light from directions: wall with pictures, a window of four panes, a lamp."""
        x, y, up = rays.T
        turn = np.arctan2(y, x)
        wall = 0.22 + 0.18 * up + 0.25 * self._at(self._pattern[0], 0.12 * rays)
        pictures = (np.abs(up - 0.25) < 0.12) & (np.sin(5 * turn) > 0.55)
        wall = np.where(pictures, 0.08 + 0.5 * self._at(self._pattern[1], 0.2 * rays), wall)
        across, high = (turn + 0.7) / 0.35, (up - 0.55) / 0.25
        panes = (np.abs(np.abs(across) - 0.5) < 0.45) & (np.abs(np.abs(high) - 0.5) < 0.45)
        lamp = np.exp(-(((rays - np.array([-0.5, 0.5, 0.707], np.float32)) / 0.12) ** 2).sum(axis=1))
        light = np.where(panes, 3.0, wall) + 4 * lamp
        return (self._bright * light[:, None] * np.array([0.97, 1, 1.03], np.float32)).astype(np.float32)


def _smoothed(mesh: Mesh, values: Floats) -> Floats:
    """(V,) means of values around each vertex: few rays leave a grain that plain surfaces do not have."""
    around = np.bincount(mesh.faces.ravel(), minlength=len(values)).clip(1)
    for _ in range(_SMOOTHINGS):
        mean = np.repeat(values[mesh.faces].mean(axis=1), 3)
        values = np.bincount(mesh.faces.ravel(), mean, len(values)) / around
    return values


def _mirror(rays: Floats, normal: Floats) -> Floats:
    mirrored: Floats = rays - 2 * np.einsum("nx,nx->n", rays, normal)[:, None] * normal
    return mirrored


def _refract(rays: Floats, normal: Floats, ratio: float) -> Floats:
    """Directions (N,3) behind a surface whose normal looks towards the rays; mirrored where none get through."""
    cosine = -np.einsum("nx,nx->n", rays, normal)
    left = 1 - ratio**2 * (1 - cosine**2)
    bent = ratio * rays + (ratio * cosine - np.sqrt(left.clip(0)))[:, None] * normal
    bent = np.where(left[:, None] > 0, bent, _mirror(rays, normal))
    directions: Floats = bent / np.linalg.norm(bent, axis=1, keepdims=True)
    return directions


def _linear(rgb: Bytes) -> Floats:
    linear: Floats = (np.asarray(rgb, np.float32) / 255) ** np.float32(2.2)
    return linear


def _pattern() -> Floats:
    """(2,K,K,K) in 0..1: random, periodic, with detail of every size."""
    rng = np.random.default_rng(0)
    frequency = np.fft.fftfreq(_VOXELS, 1 / _VOXELS)
    square = np.square(frequency)
    size = np.sqrt(square[:, None, None] + square[:, None] + square[: _VOXELS // 2 + 1])
    weight = np.maximum(size, 3).astype(np.float32) ** -_SLOPE
    weight[0, 0, 0] = 0
    made = []
    for _ in range(2):
        waves = np.fft.rfftn(rng.standard_normal((_VOXELS,) * 3, dtype=np.float32)).astype(np.complex64) * weight
        field = np.fft.irfftn(waves).astype(np.float32)
        made.append(np.clip(0.5 + 0.3 * field / field.std(), 0, 1))
    return np.stack(made)
