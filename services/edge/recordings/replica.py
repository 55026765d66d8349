"""Read rendered RGB-D walks in the layout in which SLAM systems share Replica: `results/` and `traj.txt`.

`results/depthN.png` is u16 in steps of `scale` a metre, `results/frameN.jpg` the colours; a line of `traj.txt` has the
16 numbers of a camera-to-world matrix, row by row, in OpenCV axes and metres. `cam_params.json` has the camera; it
stands above the scenes, so that a single scene comes without it.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder, data_lines, number, numbers, read_json, read_text, unreadable
from capture2vr.edge.capture.frame_records import (
    check_counts_match,
    frame_of_files,
    image_dimensions,
    no_poses,
    pinhole,
    rgbd_capture,
)
from capture2vr.edge.capture.images import image_size
from capture2vr.edge.capture.nouns import Capture, Intrinsics
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

CAMERA = Intrinsics(600.0, 600.0, 599.5, 339.5, 1200, 680)  # with which all scenes were rendered
STEPS_PER_METRE = 6553.5
_TRAJECTORY, _CAMERA = "traj.txt", "cam_params.json"


def matches(folder: Folder) -> bool:
    """Return whether the folder has depth images in `results` and a trajectory beside it."""
    return folder.has(_TRAJECTORY) and bool(_images(folder, "depth"))


def read(folder: Folder) -> Capture:
    """Read the RGB-D frames; images and poses pair by order. Raises CaptureError, naming the file."""
    depths, colours = _images(folder, "depth"), _images(folder, "frame")
    poses = _read_trajectory(folder)
    check_counts_match(len(depths), len(poses), file=_TRAJECTORY, what=f"poses in {_TRAJECTORY}")
    if colours:
        check_counts_match(len(depths), len(colours), file="results", what=say("word_colour_images"))
    camera, steps_per_metre = _camera(folder, depths[0])
    pairs: list[str | None] = [*colours] if colours else [None] * len(depths)
    records = [
        frame_of_files(folder, depth, camera, pose, 1 / steps_per_metre, colour=colour)
        for depth, colour, pose in zip(depths, pairs, poses, strict=True)
    ]
    return rgbd_capture("replica", records, axes="opencv", up=None, file="results")


def _images(folder: Folder, prefix: str) -> list[str]:
    """Return the images in `results` whose names begin with `prefix`, in natural order."""
    return [name for name in folder.directly_in("results", ".png", ".jpg") if name.startswith(f"results/{prefix}")]


def _read_trajectory(folder: Folder) -> list[Floats]:
    lines = data_lines(read_text(folder.path(_TRAJECTORY), _TRAJECTORY))
    if not lines:
        raise no_poses(_TRAJECTORY, f"a pose in {_TRAJECTORY}")
    return [numbers(line.split(), 16, file=_TRAJECTORY, what="a line").reshape(4, 4) for line in lines]


def _camera(folder: Folder, depth: str) -> tuple[Intrinsics, float]:
    """Return intrinsics and depth steps per metre, from the camera's file, or else those of all scenes."""
    if folder.has(_CAMERA):
        record = read_json(folder.path(_CAMERA), _CAMERA).get("camera")
        if not isinstance(record, dict):
            raise unreadable(_CAMERA, say("has_no_object_camera"))
        focal_and_middle = np.array([number(record, key, file=_CAMERA) for key in ("fx", "fy", "cx", "cy")])
        width, height, steps = (number(record, key, file=_CAMERA) for key in ("w", "h", "scale"))
        if not 0 < steps < np.inf:
            raise unreadable(_CAMERA, say("has_scale_not_positive_finite", value=steps))
        return pinhole(focal_and_middle, image_dimensions(width, height, _CAMERA)), steps
    size = image_size(folder.path(depth), depth)
    if size != (CAMERA.width, CAMERA.height):
        what = say("x_not_x", width=size[0], height=size[1], w=CAMERA.width, h=CAMERA.height, file=_CAMERA)
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=depth, hints=(say("add_data_set", file=_CAMERA),))
    return CAMERA, STEPS_PER_METRE
