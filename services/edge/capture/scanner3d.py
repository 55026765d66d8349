"""3D Scanner App, "all data": `frame_N.json`, `depth_N.png`, `conf_N.png`, and `frame_N.jpg` for key frames.

Depth is u16 mm; `intrinsics` are 9 row-major at 1920 x 1440; `cameraPoseARFrame` is 16 row-major, camera-to-world in
ARKit's axes and world, Y against gravity.
"""

from __future__ import annotations

import re
from functools import partial

import numpy as np

from services.edge.capture.depth import ImageColour, confidence_image, depth_file
from services.edge.capture.files import Folder, numbers, read_json
from services.edge.capture.nouns import Capture
from services.edge.capture.shots import Shot, matrix_pinhole, mostly_matched, no_poses, rgbd_capture

METRES_PER_STEP = 1e-3
_SIZE = (1920, 1440)
_UP_Y = np.array([0.0, 1.0, 0.0])


def matches(folder: Folder) -> bool:
    return bool(_numbered(folder, r"depth_(\d+)\.(png|exr)"))


def read(folder: Folder) -> Capture:
    depths, frames = _numbered(folder, r"depth_(\d+)\.(png|exr)"), _numbered(folder, r"frame_(\d+)\.json")
    if not frames:
        raise no_poses(next(iter(depths.values())), "frame_N.json")
    both = [index for index in depths if index in frames]
    # The app writes a JSON for every frame and depth for some, so only depth without a JSON is a loss.
    warnings = mostly_matched(len(both), len(depths), len(depths), file=next(iter(frames.values())), what="frames")
    images, confidences = _numbered(folder, r"frame_(\d+)\.jpg"), _numbered(folder, r"conf_(\d+)\.png")
    shots = [_shot(folder, depths[index], frames[index], images.get(index), confidences.get(index)) for index in both]
    return rgbd_capture("3dscannerapp", shots, axes="opengl", up=_UP_Y, file="depth", warnings=warnings)


def _numbered(folder: Folder, pattern: str) -> dict[str, str]:
    """Frame number, without leading zeros -> name."""
    found = ((re.fullmatch(pattern, name), name) for name in folder.directly_in(""))
    return {match[1].lstrip("0"): name for match, name in found if match}


def _shot(folder: Folder, depth: str, frame: str, image: str | None, confidence: str | None) -> Shot:
    record = read_json(folder.path(frame), frame)
    pose = numbers(record.get("cameraPoseARFrame"), 16, file=frame, what="cameraPoseARFrame").reshape(4, 4)
    k = numbers(record.get("intrinsics"), 9, file=frame, what="intrinsics").reshape(3, 3)
    camera = matrix_pinhole(k, _SIZE)
    return Shot(
        depth,
        camera,
        pose,
        depth_file(folder.path(depth), depth, METRES_PER_STEP),
        None if confidence is None else partial(confidence_image, folder.path(confidence), confidence),
        None if image is None else ImageColour(folder.path(image), image),
    )
