"""Project photos onto a mesh and blend them into its texture, so that no seams show.

1. expose  match every photo's exposure and white balance to the captured points, which are averages over all photos: a
           phone exposes each photo anew
2. see     a photo sees a place that lies within it, faces it, and is occluded neither by the mesh nor by a surface in
           the photo's depth image
3. blend   with a high power of how well each photo sees the place: next to the best view the others count little,
           which keeps a print sharp, and no view ends at a line, which would be a seam

Symbols: q = how well a place is seen, in [0,1]: the cosine of the angle to the photo, times how near it was taken,
times how far the place is from the photo's edge and from contradicting its depth. The weight is q^p.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from services.edge.arrays import Bools, Bytes, Floats, Ints, Tick, no_tick, part_of
from services.edge.mesh.nouns import Mesh
from services.edge.parallel import in_threads, slices
from services.edge.render.posed_picture import PosedPicture
from services.edge.render.rays import LIFT, Scene
from services.edge.srgb import to_linear
from services.edge.texture.bake import positions_and_normals, random_places
from services.edge.texture.nearest_colour import ColouredPoints

_POWER = 12  # p: of views 10° apart the second best counts 0.8, the third 0.4, the fourth 0.2
_LEAST_COSINE = 0.2  # 78°: beyond, a pixel covers five times its width
_RIM = 0.06  # of the photo's sides: towards the edge, places within this rim count less and less
_AGREES, _CONTRADICTS = 0.02, 0.05  # of the depth: how far a place may be from the depth image's surface
_NEAREST = 1.5  # nearer than the usual distance over this, q grows no more: one close-up must not replace all others
_SURE, _UNSURE = 0.35, 0.15  # q of the best view: from the first on only photos count, below the second only points
_PROBES = 20_000  # places at which exposures are compared
_FEWEST_PROBES = 100  # places that a photo must see to be compared; one that sees fewer keeps its exposure
_DARK, _BRIGHT = 0.01, 0.9  # linear light that is compared: darker or brighter values may be clipped
_MOST_GAIN = 3.0  # and least 1/3: a photo that differs more shows something else
_AT_ONCE = 1 << 18  # places projected together: their arrays take 50 MB


@dataclass(frozen=True, slots=True)
class _VisiblePlaces:
    """Places that a photo sees: index (M,) of the place; at (M,2) position in the photo, in shares of its sides; depth
    (M,) in the camera's units; quality (M,): q."""

    index: Ints
    at: Floats
    depth: Floats
    quality: Floats


@dataclass(frozen=True, slots=True)
class _Blend:
    """Accumulated weighted sums at N places: light (N,3), weight (N,), and the best q (N,), float32."""

    light: Floats
    weight: Floats
    best: Floats

    @classmethod
    def of(cls, count: int) -> _Blend:
        return cls(*(np.zeros(shape, np.float32) for shape in ((count, 3), count, count)))

    def add(self, index: Ints, light: Floats, quality: Floats) -> None:
        """Add light to places, each index at most once; threads may add to different places at the same time."""
        weight = quality**_POWER
        self.light[index] += weight[:, None] * light
        self.weight[index] += weight
        self.best[index] = np.maximum(self.best[index], quality)


class PhotoProjection:
    """Photos projected onto a mesh: a function from places to light. Only one photo is in memory at a time.

    pixel  side of a photo's pixel on the surface, in units of the mesh: the median over places, each in the photo that
           sees it finest; 0 where no photo sees anything
    """

    def __init__(
        self, mesh: Mesh, pictures: Sequence[PosedPicture], points: ColouredPoints, tick: Tick = no_tick
    ) -> None:
        self._scene, self._pictures, self._gains = Scene(mesh), pictures, list[Floats]()
        places, normals = positions_and_normals(mesh, *random_places(mesh, _PROBES))
        self._usual = _usual_distance(places, pictures)
        known = points.light_at(places)
        finest = np.full(len(places), np.inf)
        for number, picture in enumerate(pictures):
            visible, rgb = self._visible_places(picture, picture.depth(), places, normals), picture.load_rgb()
            self._gains.append(_gain(known[visible.index], _bilinear(rgb, visible.at)))
            finest[visible.index] = np.minimum(finest[visible.index], _pixel(picture, rgb) * visible.depth)
            tick((number + 1) / len(pictures))
        anywhere = np.isfinite(finest)
        self.pixel = float(np.median(finest[anywhere])) if anywhere.any() else 0.0

    def __call__(self, places: Floats, normals: Floats, texel: float, tick: Tick) -> tuple[Floats, Floats]:
        """Blend the photos' light at places (N,3) with unit normals, for texels of that size.

        Returns linear light (N,3), and (N,) how reliable it is in [0,1].
        """
        blend, parts = _Blend.of(len(places)), slices(len(places), _AT_ONCE)
        for number in range(len(self._pictures)):
            add = self._adder(number, places, normals, texel, blend)
            in_threads(add, parts, part_of(tick, number / len(self._pictures), (number + 1) / len(self._pictures)))
        light = blend.light / np.maximum(blend.weight, 1e-30)[:, None]
        return np.clip(light, 0, 1), np.clip((blend.best - _UNSURE) / (_SURE - _UNSURE), 0, 1)

    def _adder(
        self, number: int, places: Floats, normals: Floats, texel: float, blend: _Blend
    ) -> Callable[[slice], None]:
        """Return a function that adds a photo's light to a slice of the places."""
        picture, gain = self._pictures[number], self._gains[number]
        rgb, depth = picture.load_rgb(), picture.depth()

        def add(part: slice) -> None:
            visible = self._visible_places(picture, depth, places[part], normals[part])
            if len(visible.index):
                pixel = _pixel(picture, rgb) * float(np.median(visible.depth))
                light = gain * _bilinear(_shrink_to(rgb, texel, pixel), visible.at)
                blend.add(visible.index + part.start, light, visible.quality)

        return add

    def _visible_places(self, picture: PosedPicture, depth: Floats, places: Floats, normals: Floats) -> _VisiblePlaces:
        """Find the places that a photo sees; faces are two-sided."""
        at, z = picture.project(places)
        eye = picture.eye
        towards = eye - places
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
        cosine = np.einsum("nx,nx->n", towards, normals)
        inside = np.minimum(at, 1 - at).min(axis=1)
        index = np.flatnonzero((z > 0) & (inside > 0) & (np.abs(cosine) > _LEAST_COSINE))
        index = index[~self._is_occluded(places[index], np.sign(cosine[index])[:, None] * normals[index], eye)]
        at, z, cosine = at[index], z[index], np.abs(cosine[index])
        near = np.clip(self._usual / (z * _scale(picture)), 0, _NEAREST) / _NEAREST
        quality = cosine * near * np.clip(inside[index] / _RIM, 0, 1) * _agreement(depth, at, z)
        good = quality > 0
        return _VisiblePlaces(index[good], at[good], z[good], quality[good].astype(np.float32))

    def _is_occluded(self, places: Floats, facing: Floats, eye: Floats) -> Bools:
        """(N,) whether the mesh lies between a place and the camera; facing (N,3): normals towards the camera."""
        lift = LIFT * self._scene.longest
        start = places + lift * facing
        return self._scene.blocked(start, eye - start, 1.0)


def _usual_distance(places: Floats, pictures: Sequence[PosedPicture]) -> float:
    """Median distance from the cameras to the places' median, in units of the mesh."""
    middle = np.median(places, axis=0)
    away = [np.linalg.norm(picture.eye - middle) for picture in pictures]
    return float(np.median(away)) if away else 1.0


def _scale(picture: PosedPicture) -> float:
    """Units of the mesh per unit of the camera."""
    stretch = float(np.linalg.norm(picture.to_camera[:3, 0]))  # the matrix is a rotation times one scale
    return 1 / stretch


def _pixel(picture: PosedPicture, rgb: Bytes) -> float:
    """Width of a pixel on a surface that faces the camera, per unit of depth, in units of the mesh."""
    return _scale(picture) / float(picture.focal[0] * rgb.shape[1])


def _agreement(depth: Floats, at: Floats, z: Floats) -> Floats:
    """(M,) 1 where the depth image (H,W) has that depth, or none; 0 where it has another, and in between a ramp."""
    height, width = depth.shape
    row, column = (at[:, 1] * height).astype(int), (at[:, 0] * width).astype(int)
    found = depth[row.clip(0, height - 1), column.clip(0, width - 1)]
    off = np.abs(z / np.where(found > 0, found, z) - 1)
    return np.asarray(np.clip((_CONTRADICTS - off) / (_CONTRADICTS - _AGREES), 0, 1))


def _gain(known: Floats, shown: Floats) -> Floats:
    """(3,) gain that matches a photo's light to the known light: median ratio of the values that are not clipped."""
    unclipped = ((known > _DARK) & (known < _BRIGHT) & (shown > _DARK) & (shown < _BRIGHT)).all(axis=1)
    if unclipped.sum() < _FEWEST_PROBES:
        return np.ones(3, np.float32)
    ratio = np.median(known[unclipped] / shown[unclipped], axis=0)
    return np.clip(ratio, 1 / _MOST_GAIN, _MOST_GAIN).astype(np.float32)


def _shrink_to(rgb: Bytes, texel: float, pixel: float) -> Bytes:
    """Downsample a photo whose pixels are smaller than half a texel, to avoid aliasing."""
    import cv2

    shrink = int(texel / pixel) if pixel > 0 else 1
    if shrink < 2:
        return rgb
    height, width = (max(1, side // shrink) for side in rgb.shape[:2])
    return np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _bilinear(rgb: Bytes, at: Floats) -> Floats:
    """Sample an image (h,w,3) at positions (M,2), in shares of its sides, bilinearly: (M,3) linear light."""
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
