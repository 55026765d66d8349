"""Shapes to photograph: heads, bottles, stems, baskets, cups, shoes, with the surfaces that span their openings.

Units are metres, Z is up, the table is z = 0; the longest side of each shape is `SIZE_M`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
from scipy.interpolate import PchipInterpolator

from capture2vr.cli.demonstration.demo_garment import garment
from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.edges import border_loops
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from tests.support.surfaces import grid

SIZE_M = 0.3
_AROUND = 240  # corners of a ring
_STRANDS, _STRAND_M, _STRAND_WIDE_M = 30_000, 0.02, 0.0012
_SOIL_M, _POD_M = 0.055, np.array([0.0045, 0.0045, 0.011])  # its height, and the radii of a pod
_STEMS, _STEM_M = 9, (0.0012, 0.0007)  # radius at the bottom and at the top: 3 to 1.5 pixels of a photo are their width
_RIBS, _BANDS, _STRIP_M = 26, 8, 0.011


@dataclass(frozen=True, slots=True)
class Shape:
    """A surface with what is known about it.

    mesh      all of it
    openings  what would close it where it is open; None where it has no opening
    axes      (K,4) x, y, z and radius along each thin part
    """

    mesh: Mesh
    openings: Mesh | None = None
    axes: tuple[Floats, ...] = ()


def head() -> Shape:
    """A head with brows, nose, ears and chin, cut flat at the neck."""
    return _sized(Shape(_head()))


def furry_head() -> Shape:
    """The head under a coat of bent strands."""
    skin, rng = _head(), np.random.default_rng(0)
    roots = sample(skin, _STRANDS, rng)
    lean = 0.6 * roots.normals + [0, 0, -0.5] + rng.normal(0, 0.3, roots.xyz.shape)
    aside = np.cross(lean, rng.normal(size=lean.shape))
    aside *= _STRAND_WIDE_M / 2 / np.linalg.norm(aside, axis=1, keepdims=True)
    strips = []
    for along in np.linspace(0, 1, 4):
        middle = roots.xyz + _STRAND_M * (along * lean + along**2 * np.array([0, 0, -0.4]))
        strips.append(np.stack([middle - (1 - 0.8 * along) * aside, middle + (1 - 0.8 * along) * aside], axis=1))
    places = np.stack(strips, axis=1)  # (strands, 4, 2, 3)
    one = grid(places[0]).faces
    faces = (one[None] + 8 * np.arange(_STRANDS)[:, None, None]).reshape(-1, 3)
    coat = Mesh(places.reshape(-1, 3), faces)
    return _sized(Shape(concatenate([skin, coat])))


def rounded_box() -> Shape:
    """A box with round edges, as of a device."""
    ball = _ball()
    power = 8
    distance = (np.abs(ball.vertices / [0.10, 0.07, 0.15]) ** power).sum(axis=1) ** (-1 / power)
    return _sized(Shape(Mesh(ball.vertices * distance[:, None], ball.faces)))


def bottle() -> Shape:
    """A closed bottle of solid glass."""
    outline = [(0, 0), (0.05, 0.002), (0.058, 0.02), (0.06, 0.12), (0.05, 0.17), (0.02, 0.21), (0.02, 0.27), (0, 0.272)]
    return _sized(Shape(_turned(outline)))


def apple() -> Shape:
    """An apple with its stalk."""
    tilt = np.linspace(0, np.pi, 160)
    radius = 1 - 0.35 * np.exp(-((tilt / 0.35) ** 2)) - 0.12 * np.exp(-(((np.pi - tilt) / 0.3) ** 2)) - 0.05 * tilt
    outline = np.stack([radius * np.sin(tilt), radius * np.cos(tilt)], axis=1)[::-1] * 0.1
    body = _turned(outline, rounded=False)
    top = np.array([[0, 0, 0.058], [0.003, 0, 0.085], [0.012, 0, 0.11]])
    return _sized(Shape(concatenate([body, _tube(top, np.full(3, 0.004))])))


def stems() -> Shape:
    """A pot from which thin stems with pods rise."""
    rng = np.random.default_rng(3)
    pot = _turned([(0, 0), (0.032, 0), (0.042, 0.06), (0.038, 0.06), (0.036, _SOIL_M), (0, _SOIL_M)], rounded=False)
    parts, axes, pods = [pot], [], []
    for number in range(_STEMS):
        turn, reach, high = 2 * np.pi * number / _STEMS + rng.normal(0, 0.2), *rng.uniform([0.03, 0.2], [0.13, 0.3])
        v = np.linspace(0, 1, 40)
        out = 0.02 * np.sqrt(v) + reach * v**2
        bend = turn + 0.6 * v * rng.normal()
        axis = np.stack([out * np.cos(bend), out * np.sin(bend), 0.05 + (high - 0.05) * v], axis=1)
        radius = _STEM_M[0] + (_STEM_M[1] - _STEM_M[0]) * v
        parts.append(_tube(axis, radius))
        fine = np.linspace(0, 1, 600)  # as close to each other as a thin part is wide
        axes.append(np.stack([np.interp(fine, v, each) for each in (*axis.T, radius)], axis=1))
        for place in (axis[24], axis[32], axis[-1]):
            pod = trimesh.creation.icosphere(subdivisions=3)
            turned = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
            parts.append(Mesh(pod.vertices * _POD_M @ turned.T + place, np.asarray(pod.faces)))
            pods.append((turned, place))

    def is_seen(places: Floats) -> Bools:
        """(N,) which places (N,3) are in no pod and not in the pot: a seventh of the stems' length is."""
        away = [np.linalg.norm((places - place) @ turned / _POD_M, axis=1) for turned, place in pods]
        return (np.min(away, axis=0) > 1) & (places[:, 2] > _SOIL_M)

    return _sized(Shape(concatenate(parts), axes=tuple(axis[is_seen(axis[:, :3])] for axis in axes)))


def basket() -> Shape:
    """A basket of woven strips with gaps, open at the top."""
    high, turn = 0.17, np.linspace(0, 2 * np.pi, 521)
    parts = [_turned([(0, 0.004), (float(_wall(0.004)), 0.004)], rounded=False)]
    for number in range(_BANDS):
        z = 0.012 + (high - 0.024) * number / (_BANDS - 1)
        weave = 0.003 * np.cos(_RIBS / 2 * turn + np.pi * number)
        across = np.linspace(-0.5, 0.5, 5)[:, None] * _STRIP_M
        parts.append(_around(_wall(z + across) + weave, z + across + 0 * turn, turn))
    up = np.linspace(0.004, high, 120)[:, None]
    for rib in range(_RIBS):
        middle = 2 * np.pi * rib / _RIBS
        weave = -0.003 * np.cos(np.pi * (up - 0.012) / (high - 0.024) * (_BANDS - 1)) * np.cos(np.pi * rib)
        across = middle + np.linspace(-0.5, 0.5, 5) * _STRIP_M / 0.12
        parts.append(_around(_wall(up) + weave + 0 * across, up + 0 * across, across))
    ring = np.stack([_wall(high) * np.cos(turn), _wall(high) * np.sin(turn), np.full(len(turn), high)], axis=1)
    parts.append(_tube(ring, np.full(len(turn), 0.006)))
    wall = np.linspace(0.004, high, 60)[:, None]
    openings = [_around(_wall(wall) + 0 * turn, wall + 0 * turn, turn), _fan(ring[:-1])]
    return _sized(Shape(concatenate(parts), concatenate(openings)))


def cup() -> Shape:
    """A cup with a thick wall and a handle, open at the top."""
    outline = [(0, 0), (0.030, 0), (0.034, 0.004), (0.040, 0.05), (0.042, 0.1), (0.041, 0.102), (0.040, 0.1)]
    outline += [(0.037, 0.05), (0.031, 0.008), (0, 0.006)]
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 60)
    handle = np.stack([0.0385 + 0.03 * np.cos(turn), 0 * turn, 0.053 + 0.03 * np.sin(turn)], axis=1)
    around = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    rim = np.stack([0.04 * np.cos(around), 0.04 * np.sin(around), np.full(_AROUND, 0.1)], axis=1)
    body = concatenate([_turned(outline, rounded=False), _tube(handle, np.full(60, 0.0045))])
    return _sized(Shape(body, concatenate([_fan(rim), _fan(handle)])))


def shoe() -> Shape:
    """A low shoe of one sheet, open at the ankle."""
    known = np.array(  # height, heel, toe, half the width
        [
            (0.000, -0.13, 0.145, 0.046),
            (0.020, -0.135, 0.15, 0.050),
            (0.045, -0.132, 0.125, 0.046),
            (0.065, -0.127, 0.06, 0.040),
            (0.085, -0.122, 0.012, 0.035),
            (0.105, -0.12, -0.02, 0.033),
        ]
    )
    v = np.linspace(0, 1, 120)
    z, heel, toe, wide = PchipInterpolator(np.linspace(0, 1, len(known)), known)(v).T[..., None]
    turn = np.linspace(0, 2 * np.pi, _AROUND + 1)
    along = (1 + np.cos(turn)) / 2
    waist = 1 - 0.25 * np.exp(-(((along - 0.4) / 0.15) ** 2))
    aside = np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** 0.8 * waist
    points = np.stack([heel + (toe - heel) * along, wide * aside, z + 0 * turn], axis=-1)
    upper = _welded(_flipped(grid(points)))
    whole = concatenate([upper, _flipped(_fan(points[0, :-1]))])
    collar = max(border_loops(upper.faces), key=lambda loop: upper.vertices[loop, 2].mean())
    return _sized(Shape(whole, _fan(upper.vertices[collar])))


def dress() -> Shape:
    """The demonstration's dress with its colours, above the table: open at neck, sleeves and hem."""
    made = garment()
    upright = made.vertices[:, [2, 0, 1]]
    loops = [upright[loop] for loop in border_loops(made.faces)]
    side, height = (np.array([loop[:, axis].mean() for loop in loops]) for axis in (1, 2))
    ends = {int(each) for each in (side.argmin(), side.argmax(), height.argmin(), height.argmax())}
    openings = concatenate([_fan(loops[each]) for each in sorted(ends)])
    return _sized(Shape(Mesh(upright, made.faces, made.rgb), openings))


def _sized(shape: Shape) -> Shape:
    """The shape with its longest side `SIZE_M` long, its middle above the origin."""
    low, high = shape.mesh.vertices.min(axis=0), shape.mesh.vertices.max(axis=0)
    scale = SIZE_M / float((high - low).max())
    middle = np.array([*((low + high) / 2)[:2], min(float(low[2]), 0.0)])

    def moved(mesh: Mesh) -> Mesh:
        return Mesh((mesh.vertices - middle) * scale, mesh.faces, mesh.rgb)

    axes = tuple((axis - [*middle, 0]) * scale for axis in shape.axes)
    return Shape(moved(shape.mesh), shape.openings and moved(shape.openings), axes)


def _ball() -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=6)
    return Mesh(np.asarray(ball.vertices), np.asarray(ball.faces))


def _head() -> Mesh:
    ball = _ball()
    distance = (np.square(ball.vertices / [0.105, 0.095, 0.14])).sum(axis=1) ** -0.5
    lumps = [  # direction, width, height: nose, chin, brows, eyes, ears, nape
        ((1, 0, -0.1), 0.16, 0.035),
        ((1, 0, -0.75), 0.25, 0.03),
        *(((1, side, 0.35), 0.22, 0.012) for side in (-0.35, 0.35)),
        *(((1, side, 0.1), 0.16, -0.018) for side in (-0.35, 0.35)),
        *(((0, side, 0.05), 0.2, 0.028) for side in (-1, 1)),
        ((-1, 0, -0.6), 0.3, -0.02),
    ]
    for towards, wide, tall in lumps:
        apart = np.linalg.norm(ball.vertices - np.array(towards) / np.linalg.norm(towards), axis=1)
        distance = distance + tall * np.exp(-((apart / wide) ** 2))
    places = ball.vertices * distance[:, None] + [0, 0, 0.12]
    places[:, 2] = np.maximum(places[:, 2], 0)
    return Mesh(places, ball.faces)


def _turned(outline: Sequence[tuple[float, float]] | Floats, *, rounded: bool = True) -> Mesh:
    """The surface that an outline (K,2) of radius and height sweeps around the vertical axis."""
    known = np.asarray(outline, float)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(known, axis=0), axis=1))])
    at = np.union1d(way, np.linspace(0, way[-1], 160))
    if rounded:
        radius, height = PchipInterpolator(way, known)(at).T
    else:
        radius, height = (np.interp(at, way, side) for side in known.T)
    turn = np.linspace(0, 2 * np.pi, _AROUND + 1)
    return _welded(_around(radius[:, None] + 0 * turn, height[:, None] + 0 * turn, turn))


def _around(radius: Floats, height: Floats, turn: Floats) -> Mesh:
    """The surface of points at radius and height (R,C) in directions (R,C), its front outside where rows go up."""
    return _flipped(grid(np.stack([radius * np.cos(turn), radius * np.sin(turn), height + 0 * radius], axis=-1)))


def _flipped(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def _welded(mesh: Mesh) -> Mesh:
    """The mesh without its grid's seam, and without triangles that have no area."""
    _, first, place = np.unique(mesh.vertices.round(9), axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    solid = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return Mesh(mesh.vertices[first], faces[solid])


def _tube(axis: Floats, radius: Floats, sides: int = 12) -> Mesh:
    """A closed tube around the polyline axis (K,3)."""
    ahead = np.gradient(axis, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    across = [np.cross(ahead[0], np.eye(3)[np.abs(ahead[0]).argmin()])]
    for _, here in pairwise(ahead):
        across.append(across[-1] - here * (across[-1] @ here))
    first = np.stack(across) / np.linalg.norm(across, axis=1, keepdims=True)
    second = np.cross(ahead, first)
    turn = np.linspace(0, 2 * np.pi, sides + 1)
    wide = np.concatenate([[0], radius, [0]])
    rows = [0, *range(len(axis)), len(axis) - 1]
    rings = np.cos(turn)[:, None] * first[:, None] + np.sin(turn)[:, None] * second[:, None]
    return _welded(_flipped(grid(axis[rows][:, None] + wide[:, None, None] * rings[rows])))


def _fan(ring: Floats) -> Mesh:
    """Triangles between a ring (K,3) and its middle."""
    count = len(ring)
    corner = np.arange(count)
    faces = np.stack([corner, (corner + 1) % count, np.full(count, count)], axis=1)
    return Mesh(np.concatenate([ring, ring.mean(axis=0, keepdims=True)]), faces)


def _wall(height: Floats | float) -> Floats:
    """Radius of the basket at a height."""
    return np.asarray(0.1 + 0.25 * np.asarray(height))
