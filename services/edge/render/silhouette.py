"""Find a mesh's silhouette in a posed photo, and the outline of the thing in that photo.

The silhouette's gaps are closed and its holes filled; what the photo shows to be background, by its depth or by its
colours (GrabCut, Rother et al. 2004, started from the silhouette), is cut out of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, evenly
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.render.object_colours import SURE, ObjectColours
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.rays import Hits, RaycastingScene, pinhole
from capture2vr.edge.render.sample_image import pixels_at, resize_mask, shrink_to

LONGEST_PX = 480
"""Longer side of the pictures in which outlines are compared: a hole of 1 % of the picture is then 5 pixels wide."""
OUTLINE_PX = 1
"""How well an outline is known, in pixels: less beside it is no leak."""
_CLOSED = 0.02  # radius of the closing of a silhouette, of the root of its area: holes that reach the outline
_AROUND = 0.08  # reach of what is searched for parts of the thing that the mesh lacks, of the same length
_CERTAIN = 0.01  # how far inside the mesh's outline the photo surely shows the thing, of the same length
_CERTAIN_OF_RIM = 0.02  # the same where photos vote on rims, so that one photo's error has no effect
_ASIDE = 0.02  # of the mesh's longest side: what the photo's depth shows as far from the mesh is not the thing
_PAST = 0.04  # relative depth by which a photo that looks past a place sees farther
_BEFORE = 0.03  # relative depth by which something in front of a place is nearer
_ROUNDS = 3  # of GrabCut
_ROUNDS_OF_RIM = 1  # the same where photos vote on rims: three find no more of them
_LEAST_GROUND = 0.02  # of the picture: with less background around the thing nothing is cut out
_LEAST_PIXELS = 200  # of the silhouette; a photo that shows less of the mesh says nothing
_PROBES = 20_000  # vertices of a mesh that stand for all of them in a search
_MOST_ALIKE = 0.5  # likeness of the thing's colours and the background's: what is asked is in the silhouette's gaps
_MOST_COLOURED = 12  # photos from which a thing's colours are learned, evenly chosen
_FEWEST_VOTES = 2  # photos that must show background: the outline of one may be wrong
_SAME = 0.02  # relative depth within which a vertex is the surface that a photo sees
_MAJORITY = 2  # times as many photos must show background as the thing


@dataclass(frozen=True, slots=True)
class MeshInPhoto:
    """A mesh as a photo's camera sees it, of h × w pixels.

    rgb    (h,w,3) the photo
    hits   of the mesh, pixel by pixel; rays (h·w,3): their directions, of length 1 along the optical axis
    found  (h,w) pixels where the mesh is; whole (h,w): its silhouette, gaps closed and holes filled
    z      (h,w) depth of the mesh in the camera's units, 0 without mesh
    own    (h,w) the photo's own depth, 0 where it has none
    past   (h,w) pixels where the photo's depth looks past the mesh
    hidden (h,w) pixels where it shows something in front of the mesh
    """

    rgb: Bytes
    hits: Hits
    rays: Floats
    found: Bools
    whole: Bools
    z: Floats
    own: Floats
    past: Bools
    hidden: Bools


def see_mesh(picture: PosedPicture, scene: RaycastingScene, longest: int = LONGEST_PX) -> MeshInPhoto | None:
    """Render a mesh from a photo's camera, in pixels of which the longer side has so many; None where the photo shows
    too little of it."""
    import cv2

    rgb = shrink_to(picture.load_rgb(), longest)
    height, width = rgb.shape[:2]
    hits, rays = cast_pixels(picture, scene, width, height)
    found = (hits.face >= 0).reshape(height, width)
    whole = _filled_silhouette(found)
    if whole.sum() < _LEAST_PIXELS:
        return None
    z = np.where(found, hits.along.reshape(height, width), 0)  # the rays have depth 1 along the optical axis
    own: Floats = cv2.resize(picture.depth(), (width, height), interpolation=cv2.INTER_NEAREST).astype(np.float32)
    behind = _nearest_known(z, found)
    past, hidden = (own > 0) & (own > (1 + _PAST) * behind), (own > 0) & (own < (1 - _BEFORE) * behind)
    return MeshInPhoto(rgb, hits, rays, found, whole, z, own, past, hidden)


def outline_thing(
    view: MeshInPhoto,
    picture: PosedPicture,
    mesh: Mesh,
    scene: RaycastingScene,
    colours: ObjectColours | None,
    *,
    certain: float = _CERTAIN,
    rounds: int = _ROUNDS,
) -> Bools:
    """Find the thing in a photo (h,w): by the mask that came with the photo, else near the mesh's silhouette, without
    what is known to be something else.

    colours  the thing's, from `colours_of`
    certain  how far inside the mesh's outline the photo surely shows the thing, of the root of the silhouette's area
    rounds   of GrabCut
    """
    if picture.load_mask is not None:
        return resize_mask(picture.load_mask(), view.found.shape[::-1])
    places = picture.eye + view.own.reshape(-1, 1) * view.rays
    aside = (view.own > 0) & ~view.whole & (scene.longest > 0)
    aside[aside] = _far_from(places[aside.ravel()], mesh, _ASIDE * scene.longest)
    return _cut_out(view, view.past | aside | _seen_through(view, colours), _core(view, certain), rounds)


def colours_of(mesh: Mesh, pictures: Sequence[PosedPicture]) -> ObjectColours | None:
    """Learn the colours of a mesh's thing from photos of it; None where they do not tell it from its background.

    One photo is not enough: what it shows through a handle may be a part of the background that it shows nowhere else.
    """
    vertices = _some_vertices(mesh)

    def look(picture: PosedPicture) -> tuple[Bytes, Floats]:
        return shrink_to(picture.load_rgb(), LONGEST_PX), picture.in_view(vertices)[1]

    seen = in_threads(look, evenly(pictures, _MOST_COLOURED))
    return ObjectColours.learn([rgb for rgb, _ in seen], [at for _, at in seen], _MOST_ALIKE)


def _seen_through(view: MeshInPhoto, colours: ObjectColours | None) -> Bools:
    """Pixels (h,w) in the silhouette's gaps that have the background's colours.

    GrabCut takes them for the thing's, such as a dark wall between light stems, because it begins with them among it.
    """
    gaps = view.whole & ~view.found
    if colours is None or not gaps.any():
        return np.zeros_like(gaps)
    return gaps & (colours.evidence(view.rgb) < -SURE)


def outside_outlines(mesh: Mesh, pictures: Sequence[PosedPicture]) -> Bools:
    """Find the vertices (V,) of a mesh that photos show beside the thing: rims of background.

    At least two photos, and twice as many as show the thing there, must show background. Only photos in whose
    silhouette of the mesh a vertex lies near the outline are asked.
    """
    if len(pictures) < _FEWEST_VOTES:
        return np.zeros(len(mesh.vertices), bool)
    scene, colours = RaycastingScene(mesh), colours_of(mesh, pictures)
    background, thing = (np.zeros(len(mesh.vertices), np.int64) for _ in range(2))
    for beside, on in in_threads(lambda picture: _vote(picture, mesh, scene, colours), pictures):
        background[beside] += 1
        thing[on] += 1
    return (background >= _FEWEST_VOTES) & (background > _MAJORITY * thing)


def _vote(
    picture: PosedPicture, mesh: Mesh, scene: RaycastingScene, colours: ObjectColours | None
) -> tuple[Ints, Ints]:
    """Indices of the vertices that a photo sees near the silhouette's outline: beside the thing, and on it."""
    view = see_mesh(picture, scene)
    if view is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    thing = outline_thing(view, picture, mesh, scene, colours, certain=_CERTAIN_OF_RIM, rounds=_ROUNDS_OF_RIM)
    near = view.found & ~_core(view, _CERTAIN_OF_RIM)
    shown, at, z = picture.in_view(mesh.vertices)
    same = np.abs(z - pixels_at(view.z, at)) < _SAME * z
    shown, at = shown[same], at[same]
    beside, on = (pixels_at(mask, at) for mask in (near & beyond(thing), near & thing))
    return shown[beside > 0], shown[on > 0]


def beyond(thing: Bools) -> Bools:
    """Pixels (h,w) farther outside of an outline than it is known."""
    import cv2

    return np.asarray(cv2.dilate(thing.astype(np.uint8), disc(OUTLINE_PX)) == 0)


def _core(view: MeshInPhoto, certain: float) -> Bools:
    """Pixels (h,w) so far inside the mesh's outline that the photo surely shows the thing."""
    import cv2

    radius = max(2, round(certain * float(np.sqrt(view.whole.sum()))))
    return np.asarray(cv2.erode(view.found.astype(np.uint8), disc(radius)) > 0)


def cast_pixels(picture: PosedPicture, scene: RaycastingScene, width: int, height: int) -> tuple[Hits, Floats]:
    """Cast a ray through every pixel; also return the rays (N,3), whose length along the optical axis is 1 of the
    camera's units."""
    back = np.linalg.inv(picture.to_camera)[:3, :3]
    x = ((np.arange(width) + 0.5) / width - picture.middle[0]) / picture.focal[0]
    y = ((np.arange(height) + 0.5) / height - picture.middle[1]) / picture.focal[1]
    rays = pinhole(x, y, *back.T)
    rows, columns = _window(picture, scene, width, height)
    within = scene.cast(picture.eye[None], rays.reshape(height, width, 3)[rows, columns].reshape(-1, 3))
    hits = Hits.missed(len(rays))
    for all_pixels, some in ((hits.face, within.face), (hits.along, within.along), (hits.bary, within.bary)):
        shape = all_pixels.shape[1:]
        window = all_pixels.reshape(height, width, *shape)[rows, columns]
        window[:] = some.reshape(window.shape)
    return hits, rays


def _window(picture: PosedPicture, scene: RaycastingScene, width: int, height: int) -> tuple[slice, slice]:
    """Rows and columns of a picture of that size outside of which no ray meets the mesh: those of its bounding box."""
    at, z = picture.project(scene.corners())
    if z.min() <= 0:
        return slice(0, height), slice(0, width)
    low, high = np.floor(at.min(axis=0) * (width, height)) - 1, np.ceil(at.max(axis=0) * (width, height)) + 1
    (left, top), (right, bottom) = (np.clip(each, 0, (width, height)).astype(int) for each in (low, high))
    return slice(top, bottom), slice(left, right)


def _filled_silhouette(found: Bools) -> Bools:
    """Close the gaps of a mask (h,w) and fill its holes."""
    import cv2
    from scipy.ndimage import binary_fill_holes

    radius = max(2, round(_CLOSED * float(np.sqrt(found.sum()))))
    padded = np.pad(found.astype(np.uint8), radius)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc(radius))[radius:-radius, radius:-radius]
    return np.asarray(binary_fill_holes(closed > 0))


def disc(radius: int) -> Bytes:
    import cv2

    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), np.uint8)


def _nearest_known(z: Floats, found: Bools) -> Floats:
    """Depth (h,w) of the mesh, and where it is not, of the mesh's nearest pixel."""
    import cv2

    if found.all():
        return z
    _, label = cv2.distanceTransformWithLabels(
        (~found).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(label.max() + 1, z.dtype)
    of_label[label[found]] = z[found]
    nearest: Floats = of_label[label]
    return nearest


def _some_vertices(mesh: Mesh) -> Floats:
    """(N,3) vertices that stand for all of a mesh's."""
    return mesh.vertices[:: max(1, len(mesh.vertices) // _PROBES)]


def _far_from(places: Floats, mesh: Mesh, reach: float) -> Bools:
    """(N,) whether places lie farther from every vertex of the mesh."""
    from scipy.spatial import cKDTree

    away, _ = cKDTree(_some_vertices(mesh)).query(places, distance_upper_bound=reach)
    return np.asarray(~np.isfinite(away))


def _cut_out(view: MeshInPhoto, other: Bools, core: Bools, rounds: int) -> Bools:
    """The thing in a photo (h,w) by GrabCut, started from the mesh's silhouette.

    other, core (h,w): what is known to be something else, and what is known to be the thing.
    """
    import cv2

    length = float(np.sqrt(view.whole.sum()))
    around = cv2.dilate(view.whole.astype(np.uint8), disc(max(3, round(_AROUND * length)))) > 0
    ground = ~around | other
    if ground.mean() < _LEAST_GROUND or not (core & ~other).any():
        return view.whole & ~other
    labels = np.full(view.whole.shape, cv2.GC_PR_BGD, np.uint8)
    labels[view.whole] = cv2.GC_PR_FGD
    labels[core] = cv2.GC_FGD
    labels[ground] = cv2.GC_BGD
    bgr, models = np.ascontiguousarray(view.rgb[..., ::-1]), (np.zeros((1, 65)), np.zeros((1, 65)))
    cv2.setRNGSeed(0)  # GrabCut draws its first colour clusters
    cv2.grabCut(bgr, labels, (0, 0, 0, 0), *models, rounds, cv2.GC_INIT_WITH_MASK)
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))
