"""Ask a learned model for the depth of what a photo shows, where whoever runs the worker has added one (MoGe-2).

The photo goes on without the model where that is not there, fails, or contradicts itself: its normals must be those of
its depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Tick
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.graph import Graph
from capture2vr.edge.models.moge import MoGe, picture_size
from capture2vr.edge.models.nouns import LearnedView, LearnedViews, ModelError
from capture2vr.edge.single_photo.cutout import rotate_clockwise
from capture2vr.sentences.sentence import say

MODELS = "moge-2-large", "moge-2-base", "moge-2-small"
"""Their names in the table, the best first."""
_MOST_ANGLE = 45.0  # degrees between normals and depth's own, at the median pixel
_STEP = 0.02  # of a depth: where it changes by more from pixel to pixel, it is an edge, which has no normal


@dataclass(frozen=True, slots=True)
class LearnedDepth:
    """What a model made of a photo: its view of the upright picture, None where it made none, by which graph, and what
    to tell people."""

    view: LearnedView | None = None
    graph: Graph | None = None
    warnings: tuple[str, ...] = ()


def learned_depth(models: ModelFolder | None, photo: Photo, tick: Tick) -> LearnedDepth:
    """Ask the best model that is installed. Raises what `tick` and loading the photo raise."""
    try:
        graph = next(filter(None, map(models.find, MODELS)), None) if models else None
        if graph is None:
            return LearnedDepth()
        propose: LearnedViews = MoGe(graph.run)
        upright = rotate_clockwise(photo.load(max(picture_size(photo.size))), photo.turns)
        (view,) = propose([upright], tick)
    except ModelError as error:
        return LearnedDepth(warnings=(say("depth_model_left_out", name=photo.name, why=error.with_remedy),))
    if view.depth_m is None or contradiction(view) > _MOST_ANGLE:
        return LearnedDepth(warnings=(unsure(graph, photo.name),))
    return LearnedDepth(view, graph)


def unsure(graph: Graph, name: str) -> str:
    """Tell that a model's depth of a photo was not used."""
    return say("model_not_sure_of_depth", model=graph.card.title, name=name)


def contradiction(view: LearnedView) -> float:
    """Degrees between the normals of a view and those of its depth, at the median pixel; 90 where hardly any counts."""
    assert view.depth_m is not None, "it has depth"
    assert view.normals is not None, "it has normals"
    depth = view.depth_m
    points = _points(depth, view.focal_px)
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    facing = np.cross(down, across)
    length = np.linalg.norm(facing, axis=-1)
    middle = depth[1:-1, 1:-1]
    steps = np.maximum(np.abs(across[..., 2]), np.abs(down[..., 2]))
    around = [depth[1:-1, 2:], depth[1:-1, :-2], depth[2:, 1:-1], depth[:-2, 1:-1], middle]
    counts = (np.min(around, axis=0) > 0) & (steps < _STEP * middle) & (length > 0)
    if counts.sum() < 0.01 * depth.size:
        return 90.0
    cosine = (facing * view.normals[1:-1, 1:-1]).sum(axis=-1)[counts] / length[counts]
    return float(np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))))


def _points(depth: Floats, focal: float) -> Floats:
    """Points (h,w,3) of a depth image, OpenCV axes, the optical axis in its middle."""
    height, width = depth.shape
    x, y = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    return np.stack([x * depth / focal, y * depth / focal, depth], axis=-1)
