"""Tell by the outlines in photos which of two surfaces is the object's, where one of them lies deeper than the other.

Photos that see such a place edge on have pixels between the two surfaces' outlines. Each of them has the colours that
lie inside of both outlines, and then the object reaches as far as the outer one, or those outside of both.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import RaycastingScene
from capture2vr.edge.render.silhouette import cast_pixels

_NEIGHBOURS, _BESIDE = 8, 0.01  # points under a vertex, and how far beside its normal they may lie, of the size
_DEEPEST = 0.035  # of the size: a point deeper under a vertex is of another side
_ALIKE = 0.3  # least cosine between the normals of the two surfaces
_AWAY_PX = 2  # from both outlines lie the pixels of which the colours are sure
_AROUND_PX = 15  # how far such pixels are looked for
_COMPARED = 9  # nearest of them, whose median counts
_CONTRAST = 25.0  # in CIELAB between inside and outside: less tells nothing
_SURE = 0.4  # of the way from the colours of one side to those of the other, up to which a pixel is of the first


def depths_under(mesh: Mesh, points: Floats, normals: Floats, size: float) -> Floats:
    """How deep (V,) another surface lies under the vertices of a mesh, where it is known, else 0; above it negative.

    points, normals (N,3) of the other surface; size of the object
    """
    ours = vertex_normals(mesh)
    _, nearest = cKDTree(points).query(mesh.vertices, k=_NEIGHBOURS, workers=-1)
    apart = points[nearest] - mesh.vertices[:, None]
    height = np.einsum("vkx,vx->vk", apart, ours)
    beside = np.linalg.norm(apart - height[..., None] * ours[:, None], axis=2) / size
    known = (beside < _BESIDE) & (np.abs(height) < _DEEPEST * size)
    known &= np.einsum("vkx,vx->vk", normals[nearest], ours) > _ALIKE
    weight = known * np.exp(-np.square(2.5 * beside / _BESIDE))
    deep: Floats = -(weight * height).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-12)
    return deep


def votes_of_outlines(mesh: Mesh, depth: Floats, pictures: Sequence[PosedPicture]) -> tuple[int, int]:
    """Count the pixels between the outlines of a mesh and of the same mesh with its vertices pressed in by depth (V,):
    those that show the object there, and those that show background."""
    pressed = Mesh(mesh.vertices - np.maximum(depth, 0)[:, None] * vertex_normals(mesh), mesh.faces)
    scenes, votes = (RaycastingScene(mesh), RaycastingScene(pressed)), np.zeros(2, np.int64)
    for picture in pictures:
        rgb = picture.load_rgb()
        height, width = rgb.shape[:2]
        ours, theirs = (
            (cast_pixels(picture, scene, width, height)[0].face >= 0).reshape(height, width) for scene in scenes
        )
        votes += _votes(rgb, ours, theirs)
    return int(votes[0]), int(votes[1])


def _votes(rgb: Bytes, ours: Bools, theirs: Bools) -> tuple[int, int]:
    """Count the pixels of a photo (h,w,3) in the first silhouette, not in the second, by what they show."""
    between = ours & ~theirs
    near = cv2.dilate(between.astype(np.uint8), np.ones((2 * _AROUND_PX + 1,) * 2)) > 0
    inside, outside = (near & _eroded(mask) for mask in (ours & theirs, ~(ours | theirs)))
    if not between.any() or min(inside.sum(), outside.sum()) < _COMPARED:
        return 0, 0
    lab = cv2.cvtColor(np.float32(rgb) / 255, cv2.COLOR_RGB2LAB)
    at, colour = np.argwhere(between), lab[between]
    (inner, outer) = (_colours_near(at, lab, mask) for mask in (inside, outside))
    across = outer - inner
    way = np.einsum("nc,nc->n", colour - inner, across) / np.maximum(np.square(across).sum(axis=1), 1e-9)
    clear = np.linalg.norm(across, axis=1) > _CONTRAST
    return int((clear & (way < _SURE)).sum()), int((clear & (way > 1 - _SURE)).sum())


def _eroded(mask: Bools) -> Bools:
    return np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((2 * _AWAY_PX + 1,) * 2)) > 0)


def _colours_near(at: Floats, lab: Floats, mask: Bools) -> Floats:
    """Median colours (N,3) of the pixels of a mask that are nearest to each of the pixels at (N,2)."""
    _, nearest = cKDTree(np.argwhere(mask)).query(at, k=_COMPARED)
    return np.asarray(np.median(lab[mask][nearest], axis=1))
