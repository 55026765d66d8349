"""Find the outline that an object has in a photo, from points that are known to be the object's or something else's.

Every pixel takes the label of the nearest point that the photo shows there; GrabCut (Rother et al. 2004), which starts
from these labels, moves the outline to where the colours change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.points.shown_depth import pixels_of, shown_depth
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import pixels_at, shrink_to
from capture2vr.edge.render.silhouette import beyond, disc
from capture2vr.edge.single_photo.segmentation import grab_cut

LONGEST_PX = 480
"""Longer side of the pictures in which outlines are found: GrabCut takes half a second."""
_CERTAIN = 0.03  # how far inside its labels' outline something surely is what they say, of the root of their area
_AROUND = 0.25  # reach around the object's points in which its outline is searched, of the same length
_GAP_PX = 3  # between points that are beside each other: fused points are 2 pixels apart
_LEAST_PIXELS = 60  # of the object's points in a picture; fewer tell no colours
_NOTHING, _OTHER, _OBJECT = 0, 1, 2


@dataclass(frozen=True, slots=True)
class SeenPoints:
    """The points that a photo shows: their indices (M,), positions (M,2) in shares of its sides, and depths (M,)."""

    index: Ints
    at: Floats
    z: Floats


def seen_points(picture: PosedPicture, xyz: Floats) -> SeenPoints:
    """Find which points (N,3) a photo shows, neither beyond its sides nor hidden."""
    index, at, z = picture.in_view(xyz)
    depth = picture.depth()
    seen = z <= pixels_at(shown_depth(depth, at, z), at)
    return SeenPoints(index[seen], at[seen], z[seen])


def label_pixels(seen: SeenPoints, is_object: Bools, shape: tuple[int, int]) -> Bytes:
    """Label the pixels (h,w) of a picture by the nearest points in it: 0 none, 1 something else, 2 the object."""
    import cv2

    labels = np.zeros(shape, np.uint8)
    order = np.argsort(-seen.z)  # the nearest come last, and stay
    labels[pixels_of(seen.at[order], shape)] = np.where(is_object[seen.index[order]], _OBJECT, _OTHER)
    empty = (labels == _NOTHING).astype(np.uint8)
    if not empty.any() or empty.all():
        return labels
    away, nearest = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    of_nearest = np.zeros(nearest.max() + 1, np.uint8)
    of_nearest[nearest[empty == 0]] = labels[empty == 0]
    return np.where(away <= _GAP_PX, of_nearest[nearest], _NOTHING).astype(np.uint8)


def outline_points(picture: PosedPicture, seen: SeenPoints, is_object: Bools) -> Bools | None:
    """Find the object in a photo (h,w): by the mask that came with it, else from its points, a mask (N,) of all points.

    None where the photo shows too few of them.
    """
    if picture.load_mask is not None:
        return np.asarray(picture.load_mask())
    rgb = shrink_to(picture.load_rgb(), LONGEST_PX)
    labels = label_pixels(seen, is_object, (rgb.shape[0], rgb.shape[1]))
    if (labels == _OBJECT).sum() < _LEAST_PIXELS:
        return None
    window = _window(labels == _OBJECT)
    mask = np.zeros(labels.shape, bool)
    mask[window] = _cut_out(rgb[window], labels[window])
    return mask


def beside_and_on(mask: Bools, at: Floats) -> tuple[Bools, Bools]:
    """Tell of positions (M,2) whether they are surely beside the object of a mask (h,w), and whether they are on it."""
    return np.asarray(pixels_at(beyond(mask), at) > 0), np.asarray(pixels_at(mask, at) > 0)


def _cut_out(rgb: Bytes, labels: Bytes) -> Bools:
    """The object in a picture (h,w,3) by GrabCut, started from labels (h,w)."""
    import cv2

    object_, other = np.asarray(labels == _OBJECT), np.asarray(labels == _OTHER)
    length = float(np.sqrt(object_.sum()))
    inner = disc(max(1, round(_CERTAIN * length)))
    core, away = (cv2.erode(each.astype(np.uint8), inner) > 0 for each in (object_, other))
    far = cv2.dilate(object_.astype(np.uint8), disc(max(3, round(_AROUND * length)))) == 0
    seeds = np.full(labels.shape, cv2.GC_PR_BGD, np.uint8)
    seeds[object_] = cv2.GC_PR_FGD
    seeds[core] = cv2.GC_FGD
    seeds[away | far] = cv2.GC_BGD
    if not core.any() or not (away | far).any():
        return object_
    return _with_core(grab_cut(rgb, seeds), core)


def _with_core(mask: Bools, core: Bools) -> Bools:
    """Keep the parts of a mask (h,w) that reach into what is surely the object: others are alike in colour alone."""
    import cv2

    _, part = cv2.connectedComponents(mask.astype(np.uint8))
    return np.asarray(mask & np.isin(part, np.unique(part[core & mask])))


def _window(mask: Bools) -> tuple[slice, slice]:
    """Rows and columns around a mask (h,w), with as much around it as is searched, and some that is background."""
    around = round(1.5 * _AROUND * float(np.sqrt(mask.sum()))) + 8
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(0, rows[0] - around), rows[-1] + around + 1),
        slice(max(0, columns[0] - around), columns[-1] + around + 1),
    )
