"""Read Record3D's export "EXR + JPG": `metadata.json`, `rgb/N.jpg`, and `depth/N.exr` with metres.

The metadata is that of a .r3d: K for the colour image of w x h, and poses, camera-to-world in OpenGL axes.
"""

from __future__ import annotations

import posixpath

from capture2vr.edge.capture.depth import ImageColour
from capture2vr.edge.capture.exr import ExrDepth
from capture2vr.edge.capture.files import Folder, read_json
from capture2vr.edge.capture.frame_records import FrameRecord, check_mostly_paired, rgbd_capture
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.recordings.record3d import cameras_of, poses_of, up_of
from capture2vr.sentences.sentence import say

_METADATA = "metadata.json"
_COLOURS = (".jpg", ".jpeg", ".png")


def matches(folder: Folder) -> bool:
    """Return whether there are the metadata and a folder of depth as EXR."""
    return folder.has(_METADATA) and bool(folder.directly_in("depth", ".exr"))


def read(folder: Folder) -> Capture:
    """Read the RGB-D frames; depth and colour have the number of their pose. Raises CaptureError, naming the file."""
    meta = read_json(folder.path(_METADATA), _METADATA)
    poses = poses_of(meta, _METADATA)
    depths = {index: name for name in folder.directly_in("depth", ".exr") if (index := _number(name)) is not None}
    colours = {index: name for name in folder.directly_in("rgb", *_COLOURS) if (index := _number(name)) is not None}
    posed = sorted(index for index in depths if index < len(poses))
    warnings = check_mostly_paired(len(posed), len(depths), len(poses), file=_METADATA, what=say("word_poses"))
    cameras = cameras_of(meta, len(poses), _METADATA)
    records = [
        FrameRecord(
            depths[index],
            cameras[index],
            poses[index],
            ExrDepth(folder.path(depths[index]), depths[index]),
            None,
            ImageColour(folder.path(colours[index]), colours[index]) if index in colours else None,
        )
        for index in posed
    ]
    return rgbd_capture("record3d", records, axes="opengl", up=up_of(meta), file="depth", warnings=warnings)


def _number(name: str) -> int | None:
    stem = posixpath.splitext(posixpath.basename(name))[0]
    return int(stem) if stem.isascii() and stem.isdigit() and len(stem) < 9 else None
