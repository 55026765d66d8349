"""Synthetic test object of the demo: mesh of a summer dress, open at neck, sleeves and hem, above a wooden floor.

Generated from formulas, so that the demo needs no download and the tests know the true surface. Metres, Y up, the dress
faces +Z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import compact

_EDGE_M = 0.005  # edge length of the dress's triangles: as fine as its print
_SLEEVES = ((-1.0, 0.3), (1.0, 2.1))  # side, and a phase, so that left and right are not mirror images
_PLEATS = 11
_HUNG_M = 0.10  # added to the heights of `_OUTLINE`, so that the hem is about 15 cm above the floor
_FLOOR_M, _BOARD_M = 4.0, 0.14
_APART_M, _FLOWER_M = 0.085, (0.024, 0.040)  # flowers' least distance, range of radii: several scan points on each

# From hem to neck: height, half-width (x) and half-depth (z), metres.
_OUTLINE = np.array(
    [
        (0.060, 0.385, 0.340),
        (0.250, 0.320, 0.275),
        (0.450, 0.235, 0.190),
        (0.600, 0.160, 0.124),
        (0.660, 0.140, 0.106),
        (0.730, 0.148, 0.112),
        (0.850, 0.180, 0.130),
        (0.960, 0.190, 0.118),
        (1.050, 0.188, 0.092),
        (1.092, 0.165, 0.074),
        (1.118, 0.130, 0.067),
        (1.136, 0.096, 0.064),
    ]
)

# sRGB
_TEAL, _CREAM, _CORAL, _MUSTARD = (26, 88, 98), (242, 232, 208), (226, 110, 84), (234, 178, 62)
_OAK = (168, 128, 88)


def garment() -> Mesh:
    """Make the coloured dress alone: three tubes of cloth, about 250,000 triangles."""
    body = _body()
    sleeves = [_sleeve(side, phase) for side, phase in _SLEEVES]
    outside = [_remove_vertices(sleeve, _inside_body(sleeve.vertices)) for sleeve in sleeves]
    dress = concatenate([_remove_vertices(body, _inside_sleeves(body.vertices)), *outside])
    return Mesh(dress.vertices + np.array([0.0, _HUNG_M, 0.0]), dress.faces, _paint(dress))


def garment_scene() -> Mesh:
    """Make the dress above a floor of oak boards."""
    return concatenate([garment(), _floor()])


def _body() -> Mesh:
    rows, columns = int(1.25 / _EDGE_M), int(2.4 / _EDGE_M)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(_OUTLINE, axis=0), axis=1))])
    outline = PchipInterpolator(along / along[-1], _OUTLINE)
    return _tube(lambda turn, v: _body_point(turn, *np.moveaxis(outline(v), -1, 0)), columns, rows)


def _body_point(turn: Floats, height: Floats, half_width: Floats, half_depth: Floats) -> Floats:
    """Points of the body's surface: rounded cross-sections, pleats below the waist, creases around it; turn 0 is +Z."""
    skirt = np.clip((0.63 - height) / 0.57, 0.0, 1.0)
    wave = np.cos(_PLEATS * turn + 0.55 * np.sin(2 * turn + 0.7) + 0.5 * skirt)
    pleat = 0.155 * skirt**0.75 * (wave + 0.25 * wave**2 - 0.1)
    near_waist = np.exp(-(((height - 0.66) / 0.10) ** 2))
    crease = 0.016 * near_waist * np.sin(19 * turn + 70 * height * np.sin(turn + 0.4)) * np.sin(3 * turn + 1)
    chest = 0.10 * np.exp(-(((height - 0.93) / 0.09) ** 2)) * np.maximum(np.cos(turn), 0) ** 2
    stretch = 1 + pleat + crease + chest
    sway = 0.02 * skirt * np.sin(3 * turn + 0.5)
    neckline = 0.085 * np.clip((height - 1.03) / 0.106, 0, 1) ** 2 * np.maximum(np.cos(turn), 0) ** 2
    x = half_width * stretch * _round(np.sin(turn))
    z = half_depth * stretch * _round(np.cos(turn)) + sway
    return np.stack([x, height - neckline + 0.012 * skirt * wave, z], axis=-1)


def _round(wave: Floats) -> Floats:
    """Flatten a sine or cosine a little: a body's cross-section is no ellipse."""
    rounded: Floats = np.sign(wave) * np.abs(wave) ** 0.9
    return rounded


@dataclass(frozen=True, slots=True)
class _Arm:
    """A sleeve's axis: its ends (3,) at the shoulder and at the hand, metres."""

    start: Floats
    end: Floats

    def radius(self, v: Floats) -> Floats:
        """Return the radius of the sleeve in metres at the fraction v of its length."""
        radius: Floats = 0.066 + 0.022 * v
        return radius


def _arm(side: float) -> _Arm:
    return _Arm(np.array([side * 0.105, 1.040, 0.0]), np.array([side * 0.340, 0.850, 0.015]))


def _sleeve(side: float, phase: float) -> Mesh:
    arm = _arm(side)
    ahead = (arm.end - arm.start) / np.linalg.norm(arm.end - arm.start)
    across = np.array([0.0, 0.0, 1.0])
    over = np.cross(ahead, across)

    def point(turn: Floats, v: Floats) -> Floats:
        fold = 0.07 * np.sin(26 * v + 2.5 * np.cos(turn + phase)) * np.sin(np.pi * v) * (0.4 + 0.6 * np.cos(turn) ** 2)
        flare = 0.10 * v**2 * np.cos(6 * turn + phase)
        radius = arm.radius(v) * (1 + fold + flare)
        ring = np.cos(turn)[..., None] * across * 0.92 + np.sin(turn)[..., None] * over
        xyz: Floats = arm.start + v[..., None] * (arm.end - arm.start) + radius[..., None] * ring
        return xyz

    return _tube(point, int(0.5 / _EDGE_M), int(0.31 / _EDGE_M))


def _inside_body(xyz: Floats) -> Bools:
    """(N,) True where a sleeve would be inside the body: sleeves end a seam's width, about 1 cm, below its surface."""
    half_width, half_depth = (np.interp(xyz[:, 1], _OUTLINE[:, 0], _OUTLINE[:, axis]) for axis in (1, 2))
    inside: Bools = (xyz[:, 0] / half_width) ** 2 + (xyz[:, 2] / half_depth) ** 2 < 0.8
    return inside


def _inside_sleeves(xyz: Floats) -> Bools:
    """(N,) True where the body's cloth would be inside a sleeve."""
    inside = np.zeros(len(xyz), dtype=np.bool_)
    for side, _ in _SLEEVES:
        arm = _arm(side)
        axis = arm.end - arm.start
        v = (xyz - arm.start) @ axis / (axis @ axis)
        away = np.linalg.norm(xyz - arm.start - v[:, None] * axis, axis=1)
        inside |= (v > 0.0) & (away < 0.93 * arm.radius(v))
    return inside


def _paint(dress: Mesh) -> Bytes:
    """Vertex colours (V,3) uint8 sRGB of the dress: flowers on teal, a coral belt, cream edges at the hem and neck."""
    xyz, normals = dress.vertices, vertex_normals(dress)
    rgb = np.tile(np.array(_TEAL, dtype=np.float64), (len(xyz), 1))
    rng = np.random.default_rng(7)
    centre = _scatter(xyz, _APART_M, rng)
    away, flower = cKDTree(xyz[centre]).query(xyz, workers=-1)
    offset = xyz - xyz[centre][flower]
    tangent = np.cross(normals[centre], [0.31, 0.9, 0.2])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    bitangent = np.cross(normals[centre], tangent)
    angle = np.arctan2(np.einsum("nx,nx->n", offset, bitangent[flower]), np.einsum("nx,nx->n", offset, tangent[flower]))
    size = rng.uniform(*_FLOWER_M, len(centre))[flower]
    turn = rng.uniform(0, 2 * np.pi, len(centre))[flower]
    petal = away < size * (0.72 + 0.28 * np.cos(5 * angle + turn))
    hue = np.array([_CREAM, _CREAM, _CORAL])[rng.integers(0, 3, len(centre))][flower]
    rgb[petal] = hue[petal]
    rgb[away < 0.3 * size] = _MUSTARD
    rgb[np.abs(xyz[:, 1] - 0.66) < 0.018] = _CORAL
    rgb[xyz[:, 1] < 0.075] = _CREAM
    return rgb.astype(np.uint8)


def _scatter(xyz: Floats, apart_m: float, rng: np.random.Generator) -> Ints:
    """Indices of random points at least `apart_m` from each other: each is accepted if no earlier one is too near."""
    order = rng.permutation(len(xyz))[:6000]
    near = cKDTree(xyz[order]).query_ball_point(xyz[order], apart_m)
    accepted = np.zeros(len(order), dtype=np.bool_)
    for number, neighbours in enumerate(near):
        accepted[number] = not accepted[neighbours].any()
    return order[accepted]


def _floor() -> Mesh:
    """Make a square floor of oak boards at y = 0 with triangles of 2 cm."""
    count = int(_FLOOR_M / 0.02)
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, count) * _FLOOR_M, np.linspace(-0.5, 0.5, count) * _FLOOR_M)
    vertices = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    board = np.floor(x.ravel() / _BOARD_M + 100).astype(int)
    rng = np.random.default_rng(3)
    tone = rng.uniform(0.86, 1.1, 200)[board]
    grain = 0.05 * np.sin(160 * x.ravel() + 6 * np.sin(2.2 * z.ravel() + board)) * rng.uniform(0.5, 1, x.size)
    gap = np.where(np.abs(x.ravel() / _BOARD_M % 1.0 - 0.5) > 0.46, 0.75, 1.0)
    rgb = np.clip(np.array(_OAK) * ((tone + grain) * gap)[:, None], 0, 255).astype(np.uint8)
    # Reversed winding, so that the floor's front side is its top.
    return Mesh(vertices, _grid(count, count)[:, ::-1], rgb)


def _tube(point: Callable[[Floats, Floats], Floats], columns: int, rows: int) -> Mesh:
    """Triangulate the surface point(turn, v): closed in turn, [0,2π); open at both ends of v, [0,1]."""
    turn, v = np.meshgrid(np.arange(columns) / columns * 2 * np.pi, np.linspace(0, 1, rows + 1))
    faces = _grid(rows + 1, columns + 1)
    row, column = np.divmod(faces, columns + 1)
    return Mesh(point(turn, v).reshape(-1, 3), row * columns + column % columns)


def _grid(rows: int, columns: int) -> Ints:
    """Faces (F,3) of a grid of rows × columns vertices, two triangles per cell."""
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _remove_vertices(mesh: Mesh, vertices: Bools) -> Mesh:
    """Remove the faces that have a corner among the marked vertices (V,)."""
    return compact(mesh, np.flatnonzero(~vertices[mesh.faces].any(axis=1)))
