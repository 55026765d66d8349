"""What photos show of a mesh: each is projected upon it, and they are blended so that nobody sees where one ends.

1. level   every picture's brightness and tint are brought to those of the captured points, which are averages over all
           pictures: a phone exposes each of them anew
2. see     a place is seen by a picture where it lies within it, faces it, is hidden by nothing of the mesh and by
           nothing that the picture's depth image has in front of it
3. blend   by a high power of how well it is seen: next to the best view the others count little, which keeps a print
           sharp, and no view ends at a line, which would be a seam

Symbols: q = how well a place is seen, in [0,1]: the cosine of the angle to the picture, times how near it was taken,
times how far the place is from the picture's edge and from contradicting its depth. The weight is q^p.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from services.edge.arrays import Bools, Bytes, Floats, Ints, Tick, no_tick
from services.edge.mesh.bake import places_on, scattered
from services.edge.mesh.band import part_of
from services.edge.mesh.colour import ColouredPoints
from services.edge.mesh.nouns import Mesh
from services.edge.mesh.rays import LIFT, Scene
from services.edge.srgb import to_linear
from services.edge.threads import in_threads, slices

_POWER = 12  # p: of views 10° apart the second best counts 0.8, the third 0.4, the fourth 0.2
_LEAST_COSINE = 0.2  # 78°: beyond, a pixel covers five times its width
_RIM = 0.06  # of the picture's sides, within which a place counts ever less
_AGREES, _CONTRADICTS = 0.02, 0.05  # of the depth: by how much a place may lie off what the depth image saw
_NEAREST = 1.5  # times as near as usual a picture counts most: a single close-up is not to be all there is
_SURE, _UNSURE = 0.35, 0.15  # q of the best view from which on the points count nothing, and below which they are all
_PROBES = 20_000  # places that brightness is compared at
_FEWEST_PROBES = 100  # of them in a picture; one that shows less keeps its brightness
_DARK, _BRIGHT = 0.01, 0.9  # linear light between which pictures compare: what is clipped tells nothing
_MOST_GAIN = 3.0  # and least 1/3: what differs more shows another thing
_AT_ONCE = 1 << 18  # places projected together: their arrays take 50 MB


@dataclass(frozen=True, slots=True)
class PosedPicture:
    """A picture and its camera, loaded when asked for.

    to_camera     (4,4) the mesh's frame -> OpenCV axes of the camera, in the units of its depth image
    focal, middle  (2,) of the pinhole, in shares of the picture's width and height; its edges are at 0 and 1
    load_rgb      -> (h,w,3) uint8 sRGB
    load_depth    -> (H,W) float32 of the same field of view, 0 where unknown; None where there is none
    """

    to_camera: Floats
    focal: Floats
    middle: Floats
    load_rgb: Callable[[], Bytes]
    load_depth: Callable[[], Floats] | None = None


@dataclass(frozen=True, slots=True)
class _Seen:
    """Places that a picture sees: index (M,) of them; at (M,2) where, in shares of its sides; depth (M,) of the place
    in the camera's units; quality (M,): q."""

    index: Ints
    at: Floats
    depth: Floats
    quality: Floats


@dataclass(frozen=True, slots=True)
class _Blend:
    """Weighted sums at N places: light (N,3), weight (N,), and the best q (N,), float32."""

    light: Floats
    weight: Floats
    best: Floats

    @classmethod
    def of(cls, count: int) -> _Blend:
        return cls(*(np.zeros(shape, np.float32) for shape in ((count, 3), count, count)))

    def add(self, index: Ints, light: Floats, quality: Floats) -> None:
        """At places none of which is named twice; threads may add to different ones at once."""
        weight = quality**_POWER
        self.light[index] += weight[:, None] * light
        self.weight[index] += weight
        self.best[index] = np.maximum(self.best[index], quality)


class Pictures:
    """Pictures of a mesh, ready to be asked for the light at places on it; one of them is in memory at a time.

    pixel  side of a picture's pixel on the surface, in units of the mesh, from where it is seen best; 0 where nothing
           is seen
    """

    def __init__(
        self, mesh: Mesh, pictures: Sequence[PosedPicture], points: ColouredPoints, tick: Tick = no_tick
    ) -> None:
        self._scene, self._pictures, self._gains = Scene(mesh), pictures, list[Floats]()
        places, normals = places_on(mesh, *scattered(mesh, _PROBES))
        self._usual = _usual_distance(places, pictures)
        known = points.light_at(places)
        finest = np.full(len(places), np.inf)
        for number, picture in enumerate(pictures):
            seen, rgb = self._seen(picture, _depth(picture), places, normals), picture.load_rgb()
            self._gains.append(_gain(known[seen.index], _bilinear(rgb, seen.at)))
            finest[seen.index] = np.minimum(finest[seen.index], _pixel(picture, rgb) * seen.depth)
            tick((number + 1) / len(pictures))
        shown = np.isfinite(finest)
        self.pixel = float(np.median(finest[shown])) if shown.any() else 0.0

    def __call__(self, places: Floats, normals: Floats, texel: float, tick: Tick) -> tuple[Floats, Floats]:
        """Light at places (N,3) with unit normals, for texels of that size -> (N,3) linear, (N,) how sure in [0,1]."""
        blend, parts = _Blend.of(len(places)), slices(len(places), _AT_ONCE)
        for number in range(len(self._pictures)):
            add = self._adds(number, places, normals, texel, blend)
            in_threads(add, parts, part_of(tick, number / len(self._pictures), (number + 1) / len(self._pictures)))
        light = blend.light / np.maximum(blend.weight, 1e-30)[:, None]
        return np.clip(light, 0, 1), np.clip((blend.best - _UNSURE) / (_SURE - _UNSURE), 0, 1)

    def _adds(
        self, number: int, places: Floats, normals: Floats, texel: float, blend: _Blend
    ) -> Callable[[slice], None]:
        """What adds a picture's light to a part of the places."""
        picture, gain = self._pictures[number], self._gains[number]
        rgb, depth = picture.load_rgb(), _depth(picture)

        def add(part: slice) -> None:
            seen = self._seen(picture, depth, places[part], normals[part])
            if len(seen.index):
                pixel = _pixel(picture, rgb) * float(np.median(seen.depth))
                light = gain * _bilinear(_at_scale(rgb, texel, pixel), seen.at)
                blend.add(seen.index + part.start, light, seen.quality)

        return add

    def _seen(self, picture: PosedPicture, depth: Floats, places: Floats, normals: Floats) -> _Seen:
        """What the picture sees of the places; either side of a face is its front."""
        local = places @ picture.to_camera[:3, :3].T + picture.to_camera[:3, 3]
        z = np.maximum(local[:, 2], 1e-9)
        at = local[:, :2] / z[:, None] * picture.focal + picture.middle
        eye = np.linalg.inv(picture.to_camera)[:3, 3]
        towards = eye - places
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
        cosine = np.einsum("nx,nx->n", towards, normals)
        inside = np.minimum(at, 1 - at).min(axis=1)
        index = np.flatnonzero((local[:, 2] > 0) & (inside > 0) & (np.abs(cosine) > _LEAST_COSINE))
        index = index[~self._hidden(places[index], np.sign(cosine[index])[:, None] * normals[index], eye)]
        at, z, cosine = at[index], z[index], np.abs(cosine[index])
        near = np.clip(self._usual / (z * _scale(picture)), 0, _NEAREST) / _NEAREST
        quality = cosine * near * np.clip(inside[index] / _RIM, 0, 1) * _agreement(depth, at, z)
        kept = quality > 0
        return _Seen(index[kept], at[kept], z[kept], quality[kept].astype(np.float32))

    def _hidden(self, places: Floats, facing: Floats, eye: Floats) -> Bools:
        """(N,) whether something of the mesh lies between a place and the eye."""
        lift = LIFT * self._scene.longest
        start = places + lift * facing
        return self._scene.blocked(start, eye - start, 1.0)


def _usual_distance(places: Floats, pictures: Sequence[PosedPicture]) -> float:
    """The median distance of the places from the cameras, in units of the mesh."""
    middle = np.median(places, axis=0)
    away = [np.linalg.norm(np.linalg.inv(picture.to_camera)[:3, 3] - middle) for picture in pictures]
    return float(np.median(away)) if away else 1.0


def _scale(picture: PosedPicture) -> float:
    """Units of the mesh per unit of the camera."""
    stretch = float(np.linalg.norm(picture.to_camera[:3, 0]))  # of a rotation times one scale
    return 1 / stretch


def _pixel(picture: PosedPicture, rgb: Bytes) -> float:
    """Width of a pixel on a surface that faces the camera, per unit of depth, in units of the mesh."""
    return _scale(picture) / float(picture.focal[0] * rgb.shape[1])


def _depth(picture: PosedPicture) -> Floats:
    return np.zeros((1, 1), np.float32) if picture.load_depth is None else picture.load_depth()


def _agreement(depth: Floats, at: Floats, z: Floats) -> Floats:
    """(M,) 1 where the depth image (H,W) saw a surface at that depth, or none; 0 where it saw another."""
    height, width = depth.shape
    row, column = (at[:, 1] * height).astype(int), (at[:, 0] * width).astype(int)
    found = depth[row.clip(0, height - 1), column.clip(0, width - 1)]
    off = np.abs(z / np.where(found > 0, found, z) - 1)
    return np.asarray(np.clip((_CONTRADICTS - off) / (_CONTRADICTS - _AGREES), 0, 1))


def _gain(known: Floats, shown: Floats) -> Floats:
    """(3,) by which a picture's light is brought to what is known: the median ratio of what is not clipped."""
    told = ((known > _DARK) & (known < _BRIGHT) & (shown > _DARK) & (shown < _BRIGHT)).all(axis=1)
    if told.sum() < _FEWEST_PROBES:
        return np.ones(3, np.float32)
    ratio = np.median(known[told] / shown[told], axis=0)
    return np.clip(ratio, 1 / _MOST_GAIN, _MOST_GAIN).astype(np.float32)


def _at_scale(rgb: Bytes, texel: float, pixel: float) -> Bytes:
    """The picture with pixels no smaller than half a texel: finer ones would flicker."""
    import cv2

    shrink = int(texel / pixel) if pixel > 0 else 1
    if shrink < 2:
        return rgb
    height, width = (max(1, side // shrink) for side in rgb.shape[:2])
    return np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _bilinear(rgb: Bytes, at: Floats) -> Floats:
    """(M,3) linear light of a picture (h,w,3) at (M,2), shares of its sides."""
    height, width = rgb.shape[:2]
    place = at * [width, height] - 0.5
    low = np.clip(np.floor(place), 0, [max(width - 2, 0), max(height - 2, 0)]).astype(np.int64)
    u, v = np.clip(place - low, 0, 1).astype(np.float32).T[:, :, None]
    column, row = low.T
    right, below = np.minimum(column + 1, width - 1), np.minimum(row + 1, height - 1)
    above = (1 - u) * to_linear(rgb[row, column]) + u * to_linear(rgb[row, right])
    under = (1 - u) * to_linear(rgb[below, column]) + u * to_linear(rgb[below, right])
    mixed: Floats = (1 - v) * above + v * under
    return mixed
