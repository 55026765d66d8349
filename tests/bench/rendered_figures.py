"""Compare assets and depth images with the shape that rendered photos show: surface, openings, thin parts, luma."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product, starmap
from typing import Any

import numpy as np
import scipy.ndimage
import trimesh
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import Frame, Intrinsics
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.render.rays import RaycastingScene, pinhole
from tests.bench.captures import percent
from tests.bench.photos import SEEN_BY
from tests.support.photos.rendered.photos import RenderedPhotos

_WITHIN = 0.01  # of the shape's size: nearer is the same surface
_SAMPLES, _TRUE_SAMPLES, _OPENING_SAMPLES = 400_000, 1_000_000, 60_000
_SEEN_SAMPLES = 150_000
_REACH = 0.25  # of the shape's size, from an opening along its normal to what closes it: a lid may be a dome
_LIFT = 2e-3  # the same, off a surface, so that it does not hide itself
_LUMA = (0, 20, 40, 60, 90, 256)
_GREY = (0.299, 0.587, 0.114)
_WEB = 2.0  # widths of a thin part: farther from the truth is a web, or background
_THERE = 2.0  # radii from the axis to the mesh: nearer, the thin part is there
_THIN = 5.0  # radii around the axis of a thin part: what is within is of it


def to_truth(known: RenderedPhotos, frames: Sequence[Frame]) -> Floats:
    """(4,4) similarity that brings a capture's frame to that of the shape, by the cameras' places."""
    ours = np.stack([np.asarray(frame.camera_to_world)[:3, 3] for frame in frames])
    theirs = np.stack([known.cameras[frame.name][:3, 3] for frame in frames])
    laid: Floats = trimesh.registration.procrustes(ours, theirs, reflection=False)[0]
    return laid


class Comparison:
    """A mesh beside the true shape, both in the shape's frame; filled (V,): its vertices that nobody measured."""

    def __init__(self, mesh: Mesh, known: RenderedPhotos, filled: Bools | None = None) -> None:
        rng = np.random.default_rng(0)
        self._mesh, self._known, self._shape = mesh, known, known.shape
        self._filled = np.zeros(len(mesh.vertices), bool) if filled is None else filled
        self.size = float(np.ptp(known.shape.mesh.vertices, axis=0).max())
        self._made = sample(mesh, _SAMPLES, rng).xyz
        self._true = sample(known.shape.mesh, _TRUE_SAMPLES, rng).xyz
        self._true_tree, self._within = cKDTree(self._true), _WITHIN * self.size
        widest = max((float(axis[:, 3].max()) for axis in known.shape.axes), default=0.0)
        self._most = max(self._within, _WEB * 2 * widest)
        self._gap = self._from_truth(self._made)

    def figures(self) -> dict[str, Any]:
        """All of them, in percent; None where the shape has no opening, or nothing thin."""
        return {**self.surface(), **self.openings(), **self.thin_parts()}

    def surface(self) -> dict[str, float | None]:
        """Shares of the mesh that lies on the truth, and of the truth that the mesh is near to where photos see it."""
        true = self._true[:_SEEN_SAMPLES]
        scene = RaycastingScene(self._shape.mesh)
        cameras = self._known.cameras.values()
        seen = sum(is_visible(scene, pose, self._known.intrinsics, true) for pose in cameras) >= SEEN_BY
        gap, _ = cKDTree(self._made).query(true[seen], distance_upper_bound=self._within, workers=-1)
        return {"accurate %": _share(self._gap < self._within), "complete %": _share(np.isfinite(gap))}

    def openings(self) -> dict[str, float | None]:
        """Shares of the openings that the mesh closes, of the mesh that closes openings, and of what was filled there.

        A place of an opening is closed where the line through it, across the opening, first meets the mesh away from
        the truth.
        """
        if self._shape.openings is None:
            return {"closed openings %": None, "mesh over openings %": None, "filled over openings %": None}
        places = sample(self._shape.openings, _OPENING_SAMPLES, np.random.default_rng(0))
        free = self._from_truth(places.xyz) > self._within
        at, across = places.xyz[free], places.normals[free]
        scene, reach = RaycastingScene(self._mesh), _REACH * self.size
        closed = np.zeros(len(at), bool)
        for side in (1.0, -1.0):
            hits = scene.cast(at, side * across)
            met = np.flatnonzero(hits.along < reach)
            places_met = at[met] + side * hits.along[met, None] * across[met]
            closed[met] |= self._from_truth(places_met) > self._within
        away = self._made[self._gap > self._within]
        gap, nearest = cKDTree(at).query(away, distance_upper_bound=reach, workers=-1)
        away, gap, nearest = (each[np.isfinite(gap)] for each in (away, gap, nearest))
        height = np.einsum("nx,nx->n", away - at[nearest], across[nearest])
        over = away[gap**2 - height**2 < self._within**2]
        made_up = self._filled[cKDTree(self._mesh.vertices).query(over, workers=-1)[1]]
        return {
            "closed openings %": _share(closed),
            "mesh over openings %": percent(len(over) / len(self._made)),
            "filled over openings %": percent(float(made_up.sum() / len(self._made))),
        }

    def thin_parts(self) -> dict[str, float | None]:
        """Share of the mesh that is far from all truth, length of the thin parts that is there, width over the true."""
        if not self._shape.axes:
            return {"webs %": None, "length %": None, "width": None}
        axis = np.concatenate(self._shape.axes)
        tree, radius = cKDTree(axis[:, :3]), axis[:, 3]
        made, true = (_widths(tree, radius, points) for points in (self._made, self._true))
        there = cKDTree(self._made).query(axis[:, :3], workers=-1)[0] < _THERE * radius
        return {
            "webs %": _share(self._gap > _WEB * 2 * np.median(radius)),
            "length %": _share(there),
            "width": round(float(np.nanmedian((made / true)[there])), 2) if there.any() else None,
        }

    def _from_truth(self, points: Floats) -> Floats:
        """(N,) distances from the truth; infinite where they are longer than any that matters."""
        gaps: Floats = self._true_tree.query(points, distance_upper_bound=self._most, workers=-1)[0]
        return gaps


def is_visible(scene: RaycastingScene, pose: Floats, camera: Intrinsics, points: Floats) -> Bools:
    """(N,) which points of a surface are in a camera's picture, and hidden by nothing."""
    x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
    ahead = np.where(z > 0, z, np.inf)
    column, row = camera.fx * x / ahead + camera.cx, camera.fy * y / ahead + camera.cy
    shown = (z > 0) & (np.abs(column - camera.cx) < camera.width / 2) & (np.abs(row - camera.cy) < camera.height / 2)
    towards = pose[:3, 3] - points[shown]
    start = points[shown] + _LIFT * scene.longest * towards / np.linalg.norm(towards, axis=1, keepdims=True)
    visible = np.zeros(len(points), bool)
    visible[shown] = ~scene.blocked(start, towards, 1.0)
    return visible


def _widths(tree: cKDTree, radius: Floats, points: Floats) -> Floats:
    """(K,) median distance of the points around each place of thin parts' axes; NaN where there are none."""
    gap, nearest = tree.query(points, distance_upper_bound=_THIN * float(radius.max()), workers=-1)
    gap, nearest = gap[np.isfinite(gap)], nearest[np.isfinite(gap)]
    around = gap < _THIN * radius[nearest]
    places = np.unique(nearest[around])
    widths = np.full(len(radius), np.nan)
    if len(places):
        widths[places] = scipy.ndimage.median(gap[around], nearest[around], places)
    return widths


def depth_by_luma(known: RenderedPhotos, frames: Sequence[Frame], to_shape: Floats) -> dict[str, str | None]:
    """Of the shape's pixels of each luma in all frames: share that has depth, and share of these that is wrong.

    Depth is right within 1 % of the shape's size of the true depth in the pixel or in one beside it.
    """
    scale = float(np.cbrt(np.linalg.det(to_shape[:3, :3])))
    scene = RaycastingScene(known.shape.mesh)
    within = _WITHIN * float(np.ptp(known.shape.mesh.vertices, axis=0).max())
    counts = sum(_counts(frame, true_depth(scene, known, frame), scale, within) for frame in frames)
    assert isinstance(counts, np.ndarray)
    bands = [f"luma {low} to {high}" for low, high in pairwise(_LUMA[:-1])]
    return dict(zip([*bands, f"luma over {_LUMA[-2]}"], starmap(_kept_and_wrong, counts), strict=True))


def true_depth(scene: RaycastingScene, known: RenderedPhotos, frame: Frame) -> Floats:
    """(H,W) depth of the shape along the optical axis of a frame's camera; infinite beside it."""
    camera, pose = frame.intrinsics, known.cameras[frame.name]
    x, y = (np.arange(camera.width) - camera.cx) / camera.fx, (np.arange(camera.height) - camera.cy) / camera.fy
    along = scene.cast(pose[None, :3, 3], pinhole(x, y, *pose[:3, :3].T)).along
    depth: Floats = along.reshape(camera.height, camera.width)
    return depth


def _counts(frame: Frame, true: Floats, scale: float, within: float) -> Floats:
    """(bands,3) pixels of the shape, those of them with depth, and those of these whose depth is wrong."""
    assert frame.load_rgb is not None
    depth, luma = scale * frame.load_depth_m(), frame.load_rgb() @ np.array(_GREY)
    error = np.full(depth.shape, np.inf)
    for shift in product((-1, 0, 1), repeat=2):
        error = np.fmin(error, np.abs(np.roll(true, shift, axis=(0, 1)) - depth))
    shown, kept = np.isfinite(true), depth > 0
    each = [shown, shown & kept, shown & kept & (error > within)]
    return np.stack([np.histogram(luma[which], _LUMA)[0] for which in each], axis=1)


def _kept_and_wrong(shown: int, kept: int, wrong: int) -> str | None:
    """ "84.1, 2.3" where 84.1 % have depth, 2.3 % of which is wrong; None where less than 1,000 pixels are shown."""
    if shown < 1_000:
        return None
    return f"{100 * kept / shown:.1f}, {100 * wrong / max(kept, 1):.1f}"


def _share(which: Bools) -> float | None:
    return percent(float(which.mean())) if len(which) else None
