"""Find which places on a mesh a photo sees, and how well: within the photo, facing it, and hidden neither by the mesh
nor by a surface in the photo's depth image.

Symbols: q = how well a place is seen, in [0,1]: the cosine of the angle to the photo, times how near it was taken,
times how far the place is from the photo's edge and from contradicting its depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import LIFT, RaycastingScene
from capture2vr.edge.render.sample_image import pixels_at, resize_mask
from capture2vr.edge.render.silhouette import beyond, cast_pixels

_LEAST_COSINE = 0.2  # 78°: beyond, a pixel covers five times its width
_RIM = 0.06  # of the photo's sides: towards the edge, places within this rim count less and less
_AGREES, _CONTRADICTS = 0.02, 0.05  # of the depth: how far a place may be from the depth image's surface
_BEFORE_ALL = 1e-3  # of the depth: nearer than anything that is shown
_CONFIRMS = 0.004  # of the depth: a place as near to the depth image's surface needs no ray; nothing hides it
_STEP = 1.03  # relative step of the mesh's depth that is an outline
_NEAR_OUTLINE, _WELL_INSIDE = 0.03, 0.08  # of the root of the silhouette's area, from outlines
_NEAREST = 1.5  # nearer than the usual distance over this, q grows no more: one close-up must not replace all others


@dataclass(frozen=True, slots=True)
class VisiblePlaces:
    """Places that a photo sees: index (M,) of the place; at (M,2) position in the photo, in shares of its sides; depth
    (M,) in the camera's units; quality (M,): q."""

    index: Ints
    at: Floats
    depth: Floats
    quality: Floats


class PhotoVisibility:
    """Tells which places on a mesh photos see. Threads may share it.

    usual  the cameras' usual distance, in units of the mesh
    """

    def __init__(self, mesh: Mesh, usual: float) -> None:
        self._scene, self._usual = RaycastingScene(mesh), usual

    @property
    def longest(self) -> float:
        """Longest side of the mesh's bounding box."""
        return self._scene.longest

    def within_outlines(self, picture: PosedPicture, size: tuple[int, int]) -> Floats:
        """How far inside of the mesh's outlines a photo's pixels (h,w) lie, in [0,1]: 1 from a margin on; size: (h, w).

        Outlines are where the mesh ends, or a farther part of it begins. Close to them a photo may show what is behind:
        where surface was inferred, it may stand out beyond the object.
        """
        import cv2

        hits, _ = cast_pixels(picture, self._scene, size[1], size[0])
        z = np.where(hits.face >= 0, hits.along, 0).reshape(size).astype(np.float32)
        inner = without_steps(z, 1, _STEP).astype(np.uint8)
        away = cv2.distanceTransform(inner, cv2.DIST_L2, 3) / max(1.0, float(np.sqrt((z > 0).sum())))
        return np.asarray(np.clip((away - _NEAR_OUTLINE) / (_WELL_INSIDE - _NEAR_OUTLINE), 0, 1), np.float32)

    def unoccluded_quality(self, picture: PosedPicture, places: Floats, normals: Floats) -> Floats:
        """Quality (N,) of places as if nothing hid them: neither the mesh nor what the photo's depth shows."""
        return self._look(picture, None, places, normals)[0]

    def visible_places(self, picture: PosedPicture, depth: Floats, places: Floats, normals: Floats) -> VisiblePlaces:
        """Find the places that a photo sees. Rays are cast only where its depth neither confirms nor contradicts it."""
        quality, at, z, cosine, confirmed = self._look(picture, depth, places, normals)
        unsure = np.flatnonzero((quality > 0) & ~confirmed)
        facing = np.sign(cosine[unsure])[:, None] * normals[unsure]
        quality[unsure[self._is_occluded(places[unsure], facing, picture.eye)]] = 0
        index = np.flatnonzero(quality > 0)
        return VisiblePlaces(index, at[index], z[index], quality[index].astype(np.float32))

    def _look(
        self, picture: PosedPicture, depth: Floats | None, places: Floats, normals: Floats
    ) -> tuple[Floats, Floats, Floats, Floats, Bools]:
        """Return for places (N,): the quality without occlusion by the mesh, the place in the photo (N,2), the depth,
        the cosine of the normal to the ray, whose sign tells the side (faces are two-sided), and whether the photo's
        depth shows that it sees the place."""
        at, z = picture.project(places)
        towards = picture.eye.astype(places.dtype) - places
        cosine = np.einsum("nx,nx->n", towards, normals)
        cosine /= np.maximum(np.sqrt(np.einsum("nx,nx->n", towards, towards)), 1e-12)
        inside = np.minimum(np.minimum(at[:, 0], 1 - at[:, 0]), np.minimum(at[:, 1], 1 - at[:, 1]))
        steep = np.abs(cosine)
        near = np.minimum(self._usual / np.maximum(z * _scale(picture), 1e-12), _NEAREST) / _NEAREST
        quality = steep * near * np.clip(inside / _RIM, 0, 1) * ((z > 0) & (steep > _LEAST_COSINE))
        confirmed = np.zeros(len(places), bool)
        if depth is not None:
            good = np.flatnonzero(quality > 0)
            off = _depth_difference(depth, at[good], z[good])
            quality[good] *= np.clip((_CONTRADICTS - off) / (_CONTRADICTS - _AGREES), 0, 1)
            confirmed[good] = (off > 0) & (off < _CONFIRMS)
        return quality, at, z, cosine, confirmed

    def _is_occluded(self, places: Floats, facing: Floats, eye: Floats) -> Bools:
        """(N,) whether the mesh lies between a place and the camera; facing (N,3): normals towards the camera."""
        lift = LIFT * self._scene.longest
        start = places + lift * facing
        return self._scene.blocked(start, eye - start, 1.0)


def without_steps(depth: Floats, radius: int, step: float) -> Bools:
    """Return a mask (H,W) of the pixels around which a depth image is known, and nowhere as many times as deep."""
    import cv2

    window = np.ones((2 * radius + 1,) * 2, np.uint8)
    nearest, farthest = cv2.erode(depth, window), cv2.dilate(depth, window)
    return np.asarray((nearest > 0) & (farthest < step * nearest))


def depth_of_object(picture: PosedPicture) -> Floats:
    """Return a photo's depth image (H,W), with something just before the lens where its mask shows no object: there it
    gives no colours."""
    import cv2

    depth = picture.depth()
    if picture.load_mask is None:
        return depth
    beside = beyond(picture.load_mask())
    height, width = max(depth.shape, beside.shape)
    depth = np.asarray(cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST), np.float32)
    near = _BEFORE_ALL * float(depth.max(initial=0.0)) or _BEFORE_ALL
    return np.where(resize_mask(beside, (width, height)), np.float32(near), depth)


def usual_distance(places: Floats, pictures: Sequence[PosedPicture], depths: Sequence[Floats]) -> float:
    """Usual distance from which places (N,3) on a mesh were photographed, in units of the mesh.

    Around a thing it is the cameras' median distance from its middle. The middle of a room is nearer to them than its
    walls: then it is the median distance at which they see places; depths: the photos' depth images (H,W).
    """
    if not pictures:
        return 1.0
    middle = np.median(places, axis=0)
    from_middle = [float(np.linalg.norm(picture.eye - middle)) for picture in pictures]
    seen = [_seen_distance(places, picture, depth) for picture, depth in zip(pictures, depths, strict=True)]
    return float(max(np.median(from_middle), np.nanmedian(seen) if np.isfinite(seen).any() else 0.0))


def _seen_distance(places: Floats, picture: PosedPicture, depth: Floats) -> float:
    """Median distance of the places (N,3) in a photo that its depth does not contradict; NaN where there are none."""
    at, z = picture.project(places)
    within = np.flatnonzero((z > 0) & ((at > 0) & (at < 1)).all(axis=1))
    shown = z[within][_depth_difference(depth, at[within], z[within]) < _CONTRADICTS]
    return float(np.median(shown)) * _scale(picture) if len(shown) else np.nan


def _scale(picture: PosedPicture) -> float:
    """Units of the mesh per unit of the camera."""
    stretch = float(np.linalg.norm(picture.to_camera[:3, 0]))  # the matrix is a rotation times one scale
    return 1 / stretch


def pixel_width(picture: PosedPicture, rgb: Bytes) -> float:
    """Width of a pixel on a surface that faces the camera, per unit of depth, in units of the mesh."""
    return _scale(picture) / float(picture.focal[0] * rgb.shape[1])


def _depth_difference(depth: Floats, at: Floats, z: Floats) -> Floats:
    """(M,) relative difference of depths z (M,) and those of the depth image (H,W) at positions (M,2), positive; 0
    where the image has none."""
    found = pixels_at(depth, at)
    off: Floats = np.where(found > 0, np.maximum(np.abs(z / np.where(found > 0, found, 1) - 1), 1e-9), 0)
    return off
