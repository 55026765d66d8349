"""Small garments: hollow tubes of cloth, open at both ends, that are as wide at each height as they are told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.storage.bundle import Bundle, State
from tests.support.things import Colour, bundle_of

_AROUND = 32

DRESS = (
    (0.0, 0.34, 0.30),
    (0.45, 0.17, 0.13),
    (0.62, 0.14, 0.11),
    (0.85, 0.18, 0.13),
    (1.0, 0.16, 0.08),
    (1.04, 0.12, 0.07),
)
"""From hem to neck: height, half the width, half the depth, in metres."""
SKIRT = ((0.0, 0.30, 0.26), (0.3, 0.2, 0.17), (0.5, 0.13, 0.1))


def tube(outline: Sequence[tuple[float, float, float]], rows: int = 24) -> Mesh:
    """Cloth around the vertical axis, of ellipses (height, half the width, half the depth), in metres."""
    known = np.array(outline)
    height = np.linspace(known[0, 0], known[-1, 0], rows + 1)
    half_width, half_depth = (np.interp(height, known[:, 0], known[:, side]) for side in (1, 2))
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    points = np.stack(
        [
            half_width[:, None] * np.sin(turn),
            np.repeat(height[:, None], _AROUND, axis=1),
            half_depth[:, None] * np.cos(turn),
        ],
        axis=-1,
    )
    place = np.arange(rows * _AROUND)
    right = place - place % _AROUND + (place + 1) % _AROUND
    faces = np.concatenate(
        [np.stack([place, right, right + _AROUND], 1), np.stack([place, right + _AROUND, place + _AROUND], 1)]
    )
    return Mesh(points.reshape(-1, 3), faces)


def corners_of(mesh: Mesh) -> Floats:
    """Nine numbers for each triangle, as the viewer measures cloth."""
    return mesh.vertices[mesh.faces].reshape(-1)


def garment(
    label: str,
    colour: Colour,
    outline: Sequence[tuple[float, float, float]],
    *,
    state: State = "refined",
    labels: list[str],
) -> Bundle:
    """A garment of one colour, as the product publishes it."""
    cloth = tube(outline)
    rgb = np.tile(np.array(colour, np.uint8), (len(cloth.vertices), 1))
    glb = to_glb(Mesh(cloth.vertices, cloth.faces, rgb), "meshopt")
    low, high = cloth.vertices.min(axis=0), cloth.vertices.max(axis=0)
    width, height, depth = map(float, high - low)
    return bundle_of(label, {"lod0.glb": glb}, [len(cloth.faces)], (width, height, depth), state, labels=labels)
