"""Propose the back of an object that a few photos show from one side: a relief's, behind the measured front.

As of one photo, the outline in the photo that shows most of the object is inflated; here the front is known, and so is
the depth of the outline, from which the back begins. The back is as thick as the front bulges before its outline: a
relief is symmetric. What a photo sees past, or through, is not proposed, nor what is near
known surface, nor below the plane that the object stands on. It is a guess, and marked as one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_fill_holes, distance_transform_edt, median_filter
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area, sample
from capture2vr.edge.mesh.spacing import point_spacing
from capture2vr.edge.origin import PROPOSED
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import pixels_at
from capture2vr.edge.single_photo.membrane import inflate
from capture2vr.edge.single_photo.outline_kind import inflation_of
from capture2vr.edge.single_photo.printed_views import toned_down
from capture2vr.edge.single_photo.relief import MOST_CONFIDENT

_GRID, _MARGIN = 120, 6
"""Pixels along the longer side of the outline that is inflated, and free ones around it."""
_ON = 0.02
"""Relative depth within which a photo shows a place, and by more than which it sees past one."""
_CLOSED_PX, _PART = 3, 0.02
"""Pixels between points over which the outline is closed, and the least share of its largest part that another has."""
_LEAST_PX = 400
"""Pixels of an outline that is worth a back."""
_RIM_PX = 7
"""Side in pixels of the median that depth at the outline is taken from: stereo is noisy there."""
_THICKNESS = (0.15, 1.25)
"""Least and most thickness of the back, of a relief's, which makes of a disc 0.8 of a ball."""
_BESIDE = 1.5
"""Spacings from known points within which nothing is proposed."""
_LEAST_KEPT = 0.2
"""Share of the back that nothing contradicts, below which the object is not one with such a back."""
_DENSITY = 1.0
"""Proposed points for every square of the spacing of measured ones: they are spread at random, and leave gaps."""


@dataclass(frozen=True, slots=True)
class _Front:
    """The measured front in the pixels of one photo's part: its outline, depth and colours.

    corner  tangents (2,) of the middle of the first pixel; pitch: from pixel to pixel
    mask    (h,w) the object; its border is free
    depth   (h,w) float64, of the nearest surface, known everywhere in the mask
    rgb     (h,w,3) uint8 sRGB, or None
    """

    corner: Floats
    pitch: float
    mask: Bools
    depth: Floats
    rgb: Bytes | None


def complete_back(points: Points, support: Plane | None) -> Points:
    """Return an object's points with those of a back behind them, where few photos left it open.

    support  the plane that it stood on, with its normal to the object
    """
    pictures = [posed_picture(view, np.eye(4)) for view in points.texture_views]
    given = points.subset(points.given)
    if not pictures:
        return points
    seen = [_seen(picture, given.xyz) for picture in pictures]
    best = int(np.argmax([len(each) for each in seen]))
    front = _front(pictures[best], given.subset(seen[best]))
    if front is None:
        return points
    back = _back(front)
    spacing = float(np.median(point_spacing(given.xyz, cKDTree(given.xyz))))
    surface = _in_world(back, front, pictures[best])
    count = int(_DENSITY * area(surface) / spacing**2)
    places = sample(surface, max(count, 1), np.random.default_rng(0)).xyz
    pixel = _pixels(front, pictures[best], places)
    placed, on_plane = _above(support, places)
    kept = ~_contradicted(placed, on_plane, pictures) & _is_apart(placed, points.xyz, _BESIDE * spacing)
    if kept.mean() < _LEAST_KEPT:
        return points
    rgb = None if front.rgb is None else toned_down(front.rgb, front.mask)[pixel[kept, 0], pixel[kept, 1]]
    sure = np.full(int(kept.sum()), MOST_CONFIDENT, np.float32)
    return points.joined(placed[kept], rgb, sure, PROPOSED)


def _seen(picture: PosedPicture, xyz: Floats) -> Ints:
    """Indices (M,) of the points (N,3) that a photo shows, by its depth."""
    index, at, z = picture.in_view(xyz)
    found: Ints = index[np.abs(pixels_at(picture.depth(), at) - z) <= _ON * z]
    return found


def _tangents(picture: PosedPicture, xyz: Floats) -> tuple[Floats, Floats]:
    """Directions (N,2) of places from a camera, as x/z and y/z, and their depth (N,)."""
    at, z = picture.project(xyz)
    return (at - picture.middle) / picture.focal, z


def _front(picture: PosedPicture, points: Points) -> _Front | None:
    """Return the front that a photo shows of points; None where it is hardly anything."""
    if len(points) < _LEAST_PX:
        return None
    tangent, z = _tangents(picture, points.xyz)
    low, size = tangent.min(axis=0), np.ptp(tangent, axis=0)
    pitch = float(size.max()) / _GRID
    column, row = np.floor((tangent - low) / pitch).astype(int).T + _MARGIN
    shape = (int(size[1] / pitch) + 2 * _MARGIN + 2, int(size[0] / pitch) + 2 * _MARGIN + 2)
    number = np.full(shape, -1)
    order = np.argsort(-z)  # the nearest come last, and stay
    number[row[order], column[order]] = order
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _CLOSED_PX + 1,) * 2)
    closed = cv2.morphologyEx((number >= 0).astype(np.uint8), cv2.MORPH_CLOSE, disc)
    mask = _main_parts(np.asarray(binary_fill_holes(closed), bool))
    if mask.sum() < _LEAST_PX:
        return None
    nearest = distance_transform_edt(number < 0, return_distances=False, return_indices=True)
    whole = number[tuple(nearest)]
    corner = low - pitch * (_MARGIN - 0.5)
    rgb = None if points.rgb is None else points.rgb[whole]
    return _Front(corner, pitch, mask, z[whole], rgb)


def _main_parts(mask: Bools) -> Bools:
    """Return a mask without its specks."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    return np.asarray((areas >= max(1.0, _PART * float(areas.max())))[labels])


def _back(front: _Front) -> Floats:
    """Depth (h,w) of the back: it begins at the outline's depth, and bulges as the front does."""
    rim = front.mask & ~cv2.erode(front.mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    middle = _middle(np.asarray(median_filter(front.depth, _RIM_PX)), rim, front)
    _, inflation = inflation_of(front.mask)
    height = inflate(front.mask, inflation).height * front.pitch * middle
    inside = front.mask & ~rim
    bulge = float(np.median((middle - front.depth)[inside])) / max(float(np.median(height[inside])), 1e-12)
    back: Floats = np.maximum(middle, front.depth) + float(np.clip(bulge, *_THICKNESS)) * height
    return back


def _middle(depth: Floats, rim: Bools, front: _Front) -> Floats:
    """Depth (h,w) of the middle between front and back, which is that of the outline there; 1 outside.

    From afar it is spread from the outline with the least gradient. From near, a ball's outline is before its middle:
    the middles of its chords lie on the ball whose diameter ends in the camera and in its own middle (Thales), so that
    z = d / (1 + t²) for tangents t, and Δz = -4 z near t = 0. That equation is solved here.
    """
    mask = front.mask
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(int(mask.sum()))
    free = mask & ~rim
    rows, columns = np.nonzero(free)
    own = number[free]
    fixed = number[mask & rim]
    matrix = [(own, own, np.full(len(own), 4 - 4 * front.pitch**2)), (fixed, fixed, np.ones(len(fixed)))]
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):  # all neighbours of a pixel that is no rim are in the mask
        matrix.append((own, number[rows + down, columns + right], np.full(len(own), -1.0)))
    row, column, value = (np.concatenate(each) for each in zip(*matrix, strict=True))
    given = np.where(rim, depth, 0.0)[mask]
    middle = np.ones(mask.shape)
    middle[mask] = spsolve(csr_matrix((value, (row, column)), (len(given),) * 2), given)
    return middle


def _in_world(depth: Floats, front: _Front, picture: PosedPicture) -> Mesh:
    """Mesh of the mask's pixels at depths (h,w), in the pictures' frame."""
    rows, columns = np.nonzero(front.mask)
    tangent = front.corner + front.pitch * np.stack([columns, rows], axis=1)
    z = depth[front.mask][:, None]
    camera_to_world = np.linalg.inv(picture.to_camera)
    vertices = np.concatenate([tangent * z, z], axis=1) @ camera_to_world[:3, :3].T + camera_to_world[:3, 3]
    number = np.full(front.mask.shape, -1)
    number[front.mask] = np.arange(len(rows))
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    corners = np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))])
    return Mesh(vertices, corners[(corners >= 0).all(axis=1)])


def _pixels(front: _Front, picture: PosedPicture, places: Floats) -> Ints:
    """Rows and columns (N,2) of places in the front's pixels."""
    tangent, _ = _tangents(picture, places)
    found = np.rint((tangent - front.corner) / front.pitch).astype(int)[:, ::-1]
    inside: Ints = np.clip(found, 0, np.array(front.mask.shape) - 1)
    return inside


def _above(support: Plane | None, places: Floats) -> tuple[Floats, Bools]:
    """Move places (N,3) that are below the plane onto it, and tell which (N,) these are: there the object stands."""
    if support is None:
        return places, np.zeros(len(places), bool)
    below = np.minimum(support.height(places), 0.0)
    return places - below[:, None] * support.normal, below < 0


def _contradicted(places: Floats, on_plane: Bools, pictures: Sequence[PosedPicture]) -> Bools:
    """Tell which places (N,3) a photo sees past; of those on the plane also, which show it."""
    free = np.zeros(len(places), bool)
    for picture in pictures:
        index, at, z = picture.in_view(places)
        past = np.where(on_plane[index], 1 - _ON / 2, 1 + _ON) * z
        free[index] |= pixels_at(picture.depth(), at) > past
    return free


def _is_apart(places: Floats, xyz: Floats, reach: float) -> Bools:
    """Tell which places (N,3) are farther than that from all points."""
    return np.asarray(np.isinf(cKDTree(xyz).query(places, distance_upper_bound=reach, workers=-1)[0]))
