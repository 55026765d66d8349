"""Depth of one photo by learned models with their true weights, beside what else tells it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Floats, no_tick
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.graph import Graph
from capture2vr.edge.models.moge import MoGe, picture_size
from capture2vr.edge.models.nouns import LearnedView
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.single_photo.cutout import rotate_clockwise
from capture2vr.edge.single_photo.learned_depth import contradiction
from capture2vr.edge.single_photo.relief import make_relief
from tests.bench.data_files import data_file
from tests.bench.peak_memory import peak_memory
from tests.bench.texture import cpu_seconds

ROOM = "rgbd_livingroom"
_FRAMES = 5  # of the room, evenly


def compare_depth(graphs: Sequence[Graph], paths: Sequence[Path]) -> None:
    """Print a table of photos, and one of a depth camera's frames. Raises DataMissing."""
    print(
        "\n| photo | model | focal length: its, the metadata's | normals off ° | object m | seconds | CPU s | peak MB |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for path in paths:
        photo = read_capture(path).photos[0]
        for graph in graphs:
            print(f"| {path.name} | {graph.card.title} | {_row(photo, graph)} |", flush=True)
    print(
        "\n| frame of the room | model | focal length: its, the camera's | depth off %: median, of one scale | scale |"
    )
    print("|---|---|---|---|---|")
    frames = read_capture(data_file(ROOM)).frames
    for frame in frames[:: max(1, len(frames) // _FRAMES)][:_FRAMES]:
        assert frame.load_rgb is not None, "its frames have colours"
        rgb, true = frame.load_rgb(), frame.load_depth_m()
        for graph in graphs:
            (view,) = MoGe(graph.run)([rgb], no_tick)
            focal = frame.intrinsics.fx * rgb.shape[1] / frame.intrinsics.width
            print(
                f"| {frame.name} | {graph.card.title} | {view.focal_px:.0f}, {focal:.0f} | {_off(view, true)} |",
                flush=True,
            )


def _row(photo: Photo, graph: Graph) -> str:
    """Figures of a photo: a view of it, and the relief that it makes."""
    upright = rotate_clockwise(photo.load(max(picture_size(photo.size))), photo.turns)
    began, busy = time.perf_counter(), cpu_seconds()
    with peak_memory() as peak:
        (view,) = MoGe(graph.run)([upright], no_tick)
    took = f"{time.perf_counter() - began:.1f} | {cpu_seconds() - busy:.1f} | {peak.megabytes:.0f}"
    if view.depth_m is None:
        return f"no surface | | | {took}"
    known = "" if photo.focal_px is None else f"{photo.focal_px * max(upright.shape) / max(photo.size):.0f}"
    return f"{view.focal_px:.0f}, {known} | {contradiction(view):.0f} | {_size(photo, graph)} | {took}"


def _size(photo: Photo, graph: Graph) -> str:
    """The longer side of the object in metres, as the product has it from the best model in that folder."""
    try:
        relief = make_relief(photo, models=ModelFolder(graph.file.parent), tick=no_tick)
    except CaptureError:
        return "no object"
    return "left out" if relief.metres is None else f"{relief.metres:.2f} ({relief.sized_by})"


def _off(view: LearnedView, true: Floats) -> str:
    """Median error of depth in percent as it is, and once one factor fits it, with that factor."""
    if view.depth_m is None:
        return "no surface | | "
    rows, columns = (np.linspace(0, side - 1, 100).astype(int) for side in true.shape)
    scaled = (np.linspace(0, side - 1, 100).astype(int) for side in view.depth_m.shape)
    measured, proposed = true[np.ix_(rows, columns)], view.depth_m[np.ix_(*scaled)]
    both = (measured > 0) & (proposed > 0)
    ratio = proposed[both] / measured[both]
    factor = float(np.median(ratio))
    return f"{100 * np.median(np.abs(ratio - 1)):.1f}, {100 * np.median(np.abs(ratio / factor - 1)):.1f} | {factor:.2f}"
