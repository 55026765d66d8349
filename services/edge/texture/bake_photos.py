"""Project photos onto a mesh and blend them into its texture, so that no seams show.

1. align   refine the photos' poses on the mesh (`refine_poses`): prints of two photos a pixel apart would be blurred
2. expose  match the photos' exposures and white balances to each other (`match_exposures`): a phone exposes each photo
           anew
3. see     find the places that a photo sees, and how well (`photo_visibility`); close to outlines it is trusted less
           with inferred surface, which may stand out beyond the object
4. choose  of many photos the best few, for cells of some texels
5. sample  bicubically: prints are a fifth to a half sharper than bilinearly (docs/points.md)
6. blend   with a high power of how well each photo sees the place: next to the best view the others count little,
           which keeps a print sharp, and no view ends at a line, which would be a seam

The weight of a photo is q^p; q in [0,1] tells how well it sees the place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.parallel import in_threads, slices
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import bicubic, bilinear, pixels_at, shrink_to
from capture2vr.edge.srgb import to_linear
from capture2vr.edge.texture.bake import positions_and_normals, random_places
from capture2vr.edge.texture.match_exposures import match_exposures
from capture2vr.edge.texture.nearest_colour import ColouredPoints
from capture2vr.edge.texture.photo_visibility import (
    PhotoVisibility,
    VisiblePlaces,
    depth_of_object,
    pixel_width,
    usual_distance,
    without_steps,
)
from capture2vr.edge.texture.refine_poses import LONGEST_PX, SeenPlaces, refine_poses

_POWER = 12  # p: of views 10° apart the second best counts 0.8, the third 0.4, the fourth 0.2
_SURE, _UNSURE = 0.35, 0.15  # q of the best view: from the first on only photos count, below the second only points
_PROBES = 20_000  # places at which exposures are compared
_AT_ONCE = 1 << 16  # places projected together: their arrays fit into the processor's cache
_CELL_TEXELS = 12  # side of the cells for which pictures are chosen, in texels
_LEAST_CELL = 1 / 512  # of the longest side: the least side of a cell
_MOST_PICTURES = 4  # blended at a place: of 6, texels are up to 0.07 dB nearer, but a thirtieth less sharp
_HIDDEN = 0.1  # of the quality: what counts of a picture that does not see the middle of a cell
_OUTLINE, _STEP = 0.01, 1.05  # of the longer side: width of outlines; and the relative depth step that is one
_LOOK_SHARE = 0.5  # of the time before baking goes into loading the photos; the rest refines their poses


@dataclass(frozen=True, slots=True)
class _Look:
    """What one photo shows of the probes: rgb (h,w,3), downsampled; all that it sees, and what lies away from outlines;
    pixel (M,): width of a pixel at each place that it sees, in units of the mesh; within (h,w): how far inside of
    outlines its pixels lie, None where the mesh has no inferred surface."""

    rgb: Bytes
    all: SeenPlaces
    inner: SeenPlaces
    pixel: Floats
    within: Floats | None


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
    """Photos projected onto a mesh: a function from places to light, which threads may share. A few photos
    are in memory at a time.

    pixel  side of a photo's pixel on the surface, in units of the mesh: the median over places, each in the photo that
           sees it finest; 0 where no photo sees anything
    """

    def __init__(
        self, mesh: Mesh, pictures: Sequence[PosedPicture], points: ColouredPoints, tick: Tick = no_tick
    ) -> None:
        self._pictures = pictures
        self._depths = [depth_of_object(picture) for picture in pictures]
        places, normals = positions_and_normals(mesh, *random_places(mesh, _PROBES))
        self._visibility = PhotoVisibility(mesh, usual_distance(places, pictures, self._depths))
        self._points, known = points, points.light_at(places)
        looks = in_threads(
            lambda number: self._look_at(places, normals, number),
            range(len(pictures)),
            part_of(tick, 0, _LOOK_SHARE),
        )
        finest = np.full(len(places), np.inf)
        for each in looks:
            finest[each.all.index] = np.minimum(finest[each.all.index], each.pixel)
        anywhere = np.isfinite(finest)
        self.pixel = float(np.median(finest[anywhere])) if anywhere.any() else 0.0
        small, self._within = [each.rgb for each in looks], [each.within for each in looks]
        self._pictures = refine_poses(
            pictures,
            [_grey(rgb) for rgb in small],
            places,
            [each.inner for each in looks],
            part_of(tick, _LOOK_SHARE, 1),
        )
        self._gains = _gains(self._pictures, small, places, [each.all for each in looks], known)

    def _look_at(self, places: Floats, normals: Floats, number: int) -> _Look:
        """Load a photo, and find which places it sees."""
        picture, depth = self._pictures[number], self._depths[number]
        visible, rgb = self._visibility.visible_places(picture, depth, places, normals), picture.load_rgb()
        small = shrink_to(rgb, LONGEST_PX)
        within = self._visibility.within_outlines
        inner = pixels_at(_inner_mask(depth), visible.at)
        return _Look(
            small,
            SeenPlaces(visible.index, visible.quality),
            SeenPlaces(visible.index[inner], visible.quality[inner]),
            pixel_width(picture, rgb) * visible.depth,
            None if self._points.inferred is None else within(picture, small.shape[:2]),
        )

    def __call__(self, places: Floats, normals: Floats, texel: float, tick: Tick) -> tuple[Floats, Floats]:
        """Blend the photos' light at places (N,3) with unit normals, for texels of that size.

        Returns linear light (N,3), and (N,) how reliable it is in [0,1].
        """
        places, normals = places.astype(np.float32), normals.astype(np.float32)
        cell, chosen, inferred = self._choose_pictures(places, normals, texel)
        blend = _Blend.of(len(places))
        for number in range(len(self._pictures)):
            index = np.flatnonzero(chosen[cell, number])
            done = part_of(tick, number / len(self._pictures), (number + 1) / len(self._pictures))
            if len(index):
                add = self._adder(number, places, normals, index, texel, blend, inferred[cell])
                in_threads(add, slices(len(index), _AT_ONCE), done)
        light = blend.light / np.maximum(blend.weight, 1e-30)[:, None]
        return np.clip(light, 0, 1), np.clip((blend.best - _UNSURE) / (_SURE - _UNSURE), 0, 1)

    def _choose_pictures(self, places: Floats, normals: Floats, texel: float) -> tuple[Ints, Bools, Floats]:
        """Group places into cells, and choose the best pictures of each: the cell (N,) of each place, a mask (cells,
        pictures), and which share (cells,) of a cell's surface was inferred.

        A picture that is not chosen would have less than a tenth of the best one's weight. Where the middle of a cell
        is hidden, a part of it may still be seen: such a picture comes last.
        """
        cell, middles, facing = _cells(
            places, normals, max(_CELL_TEXELS * texel, _LEAST_CELL * self._visibility.longest)
        )
        inferred = self._points.inferred_share(middles)
        quality = np.zeros((len(middles), len(self._pictures)), np.float32)

        def judge(number: int) -> None:
            picture = self._pictures[number]
            quality[:, number] = _HIDDEN * self._visibility.unoccluded_quality(picture, middles, facing)
            seen = self._visibility.visible_places(picture, self._depths[number], middles, facing)
            quality[seen.index, number] = self._trusted(number, seen, inferred)

        in_threads(judge, range(len(self._pictures)))
        if quality.shape[1] <= _MOST_PICTURES:
            return cell, quality > 0, inferred
        least = np.partition(quality, -_MOST_PICTURES, axis=1)[:, -_MOST_PICTURES]
        return cell, (quality > 0) & (quality >= least[:, None]), inferred

    def _trusted(self, number: int, visible: VisiblePlaces, inferred: Floats) -> Floats:
        """(M,) how well a photo sees places: less close to outlines, the more of the surface (N,) was inferred."""
        within = self._within[number]
        if within is None:
            return visible.quality
        return visible.quality * (1 - inferred[visible.index] * (1 - pixels_at(within, visible.at)))

    def _adder(
        self, number: int, places: Floats, normals: Floats, index: Ints, texel: float, blend: _Blend, inferred: Floats
    ) -> Callable[[slice], None]:
        """Return a function that adds a photo's light to a slice of the places at `index`."""
        picture, gain, depth = self._pictures[number], self._gains[number], self._depths[number]
        rgb = picture.load_rgb()
        by_size: dict[int, Floats] = {}

        def add(part: slice) -> None:
            own = index[part]
            visible = self._visibility.visible_places(picture, depth, places[own], normals[own])
            if len(visible.index):
                pixel = pixel_width(picture, rgb) * float(np.median(visible.depth))
                shrink = max(1, int(texel / pixel)) if pixel > 0 else 1
                if shrink not in by_size:
                    by_size[shrink] = to_linear(_shrink(rgb, shrink))
                quality = self._trusted(number, visible, inferred[own])
                light = gain * np.maximum(bicubic(by_size[shrink], visible.at), 0)
                blend.add(own[visible.index], light, quality)

        return add


def _gains(
    pictures: Sequence[PosedPicture], small: Sequence[Bytes], places: Floats, seen: Sequence[SeenPlaces], known: Floats
) -> Floats:
    """(N,3) gains that bring the photos to one exposure.

    small: the photos, downsampled; seen: of the places (P,3), those that each sees; known (P,3): the points' light
    """
    shown = np.zeros((len(places), len(pictures), 3), np.float32)
    quality = np.zeros((len(places), len(pictures)), np.float32)
    for number, (picture, rgb, each) in enumerate(zip(pictures, small, seen, strict=True)):
        at, _ = picture.project(places[each.index])
        shown[each.index, number] = bilinear(to_linear(rgb), at)
        quality[each.index, number] = each.weight
    return match_exposures(shown, quality, known)


def _inner_mask(depth: Floats) -> Bools:
    """(H,W) pixels of a depth image away from outlines, where a blurred picture mixes the surface with what is behind;
    all of an image without depth."""
    if not depth.any():
        return np.ones(depth.shape, bool)
    return without_steps(depth, max(1, round(_OUTLINE * max(depth.shape))), _STEP)


def _grey(rgb: Bytes) -> Floats:
    """Brightness (h,w) float32 of a picture, in sRGB levels."""
    import cv2

    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.float32)


def _shrink(rgb: Bytes, by: int) -> Bytes:
    """Downsample a photo, whose pixels are smaller than a texel, to avoid aliasing."""
    import cv2

    if by < 2:
        return rgb
    height, width = (max(1, side // by) for side in rgb.shape[:2])
    return np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _cells(places: Floats, normals: Floats, side: float) -> tuple[Ints, Floats, Floats]:
    """Group places (N,3) that lie in one cube and face one way: the cell (N,) of each, and the mean places (M,3) and
    unit normals (M,3) of the cells."""
    grid = np.floor((places - places.min(axis=0)) / max(side, 1e-30)).astype(np.int64)
    extent = grid.max(axis=0) + 1
    way = np.argmax(np.abs(normals), axis=1)
    way = 2 * way + (np.take_along_axis(normals, way[:, None], axis=1)[:, 0] > 0)
    key = ((grid[:, 0] * extent[1] + grid[:, 1]) * extent[2] + grid[:, 2]) * 6 + way
    _, cell, size = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.stack([np.bincount(cell, each[:, axis]) for axis in range(3)], axis=1) for each in (places, normals)]
    facing = sums[1] / np.maximum(np.linalg.norm(sums[1], axis=1, keepdims=True), 1e-12)
    return cell, sums[0] / size[:, None], facing
