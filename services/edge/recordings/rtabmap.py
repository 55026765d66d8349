"""Read what RTAB-Map exports: folders of pictures, depth and calibration, and a table of poses beside them.

`depth/N.png` is u16 mm, `rgb/N.jpg` the colours, `calib/N.yaml` (or one calibration.yaml) the camera; N is a number or
a time. A row of `poses.txt` is a matrix of 3 x 4, or x y z qx qy qz qw, behind a time and before a number where there
are any. Poses are to the world, whose Z is up, from the camera in OpenCV axes or from the body that carries it:
`local_transform` of the calibration leads from the camera to that, and which of both they are the depth tells.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder, data_lines, numbers, read_text, translate_errors, unreadable
from capture2vr.edge.capture.frame_records import FrameRecord, frame_of_files, matrix_pinhole, no_poses, rgbd_capture
from capture2vr.edge.capture.images import image_size
from capture2vr.edge.capture.nouns import Capture, Intrinsics
from capture2vr.edge.capture.poses import pose_from_quaternion
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.recordings import tum
from capture2vr.sentences.sentence import say

METRES_PER_STEP = 1e-3
_POSES = "poses.txt"
_OWN_TRAJECTORIES = ("groundtruth.txt", "trajectory.txt", "traj.txt", "trajectory.log")  # of other layouts
_DEPTHS, _COLOURS = (".png", ".tif", ".tiff"), (".jpg", ".jpeg", ".png")
_MATRIX_WIDTHS, _LOOSE_WIDTHS = (12, 16), (7, 8, 9)
_MOST_BYTES = 65_536  # of a calibration
_CHECKED_PAIRS = 8  # of neighbouring frames, by which it is told whose poses they are
_STEP = 4  # pixels from one that is looked at to the next
_MOST_OFF_M = 0.5
_NUMBER = re.compile(r"\d{1,18}(\.\d{1,18})?")
_UP_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class _Calibration:
    """A camera, and the pose (4,4) of it on the body that carries it."""

    camera: Intrinsics
    local: Floats


def matches(folder: Folder) -> bool:
    """Return whether there are a table of poses and a folder of depth images, and no other layout's trajectory."""
    if any(map(folder.has, _OWN_TRAJECTORIES)):
        return False
    return _poses_file(folder) is not None and bool(_depths(folder))


def read(folder: Folder) -> Capture:
    """Read the RGB-D frames with their poses. Raises CaptureError, naming the file.

    Where the poses cannot be paired with the depth images, the frames have none, and that is said.
    """
    file, depths = _poses_file(folder), _depths(folder)
    assert file is not None
    table = _table(folder, file)
    rows = _rows_of(depths, table)
    if rows is None:
        warning = say("poses_of_other_frames", file=file, poses=len(table), depths=len(depths))
        capture = tum.read(folder)
        return replace(capture, warnings=(warning, *capture.warnings))
    posed = [(depth, _pose(table[row])) for depth, row in zip(depths, rows, strict=True) if row is not None]
    calibrations = _calibrations(folder, [depth for depth, _ in posed])
    records = [
        frame_of_files(
            folder,
            depth,
            calibration.camera,
            pose,
            METRES_PER_STEP,
            colour=_beside(folder, depth, "rgb", _COLOURS),
        )
        for (depth, pose), calibration in zip(posed, calibrations, strict=True)
    ]
    carried = [calibration.local for calibration in calibrations]
    on_body = any(not np.allclose(local, np.eye(4)) for local in carried)
    if on_body:
        records = _nearer(records, _moved(records, carried), prefer_first="camera" in file.lower())
    missing = len(depths) - len(posed)
    warnings = (say("depth_images_without_pose", count=missing, all=len(depths), file=file),) if missing else ()
    up = _UP_Z if on_body else None
    return rgbd_capture("rtabmap", records, axes="opencv", up=up, file="depth", warnings=warnings)


def _poses_file(folder: Folder) -> str | None:
    return next((name for name in folder.directly_in("", ".txt") if name.lower().endswith(_POSES)), None)


def _depths(folder: Folder) -> list[str]:
    """Return the depth images: of a folder `depth`, or of one that ends so."""
    tops = {name.split("/", 1)[0] for name in folder.names if name.count("/") == 1}
    top = next((top for top in sorted(tops) if top == "depth" or top.endswith("_depth")), None)
    return [] if top is None else folder.directly_in(top, *_DEPTHS)


def _beside(folder: Folder, depth: str, kind: str, suffixes: Sequence[str]) -> str | None:
    """Return the file of a depth image's name in the folder of another kind, as `a_rgb` beside `a_depth`."""
    place, name = posixpath.split(posixpath.splitext(depth)[0])
    tries = (f"{place.removesuffix('depth')}{kind}/{name}{suffix}" for suffix in suffixes)
    return next(filter(folder.has, tries), None)


def _table(folder: Folder, file: str) -> Floats:
    """Read the rows of numbers (N,7 to 16). Raises CAPTURE_NO_POSES and CAPTURE_UNREADABLE."""
    rows = data_lines(read_text(folder.path(file), file))
    if not rows:
        raise no_poses(file, f"a pose in {file}")
    with translate_errors(file, "table of poses"):
        table = np.loadtxt([row.replace(",", " ") for row in rows], np.float64, ndmin=2)
    if table.shape[1] not in (*_MATRIX_WIDTHS, *_LOOSE_WIDTHS):
        raise unreadable(file, say("has_columns_of_no_pose", count=table.shape[1]))
    return table


def _rows_of(depths: Sequence[str], table: Floats) -> list[int | None] | None:
    """Return the row of each depth image: by its number, by its time, or by the order; None where none of it fits."""
    stems = [posixpath.splitext(posixpath.basename(depth))[0] for depth in depths]
    named = np.array([float(stem) if _NUMBER.fullmatch(stem) else np.nan for stem in stems])
    found: list[int | None] = [None] * len(depths)
    if table.shape[1] == 9:
        by_number = {number: row for row, number in enumerate(table[:, 8].tolist())}
        found = [by_number.get(number) for number in named.tolist()]
    if found.count(None) == len(found) and table.shape[1] in (8, 9):
        found = tum.nearest(table[:, 0], named)
    if found.count(None) < len(found):
        return found
    return list(range(len(depths))) if len(depths) == len(table) else None


def _pose(row: Floats) -> Floats:
    if len(row) in _MATRIX_WIDTHS:
        pose = np.eye(4)
        pose[:3] = row[:12].reshape(3, 4)
        return pose
    place = row[0:7] if len(row) == 7 else row[1:8]
    return pose_from_quaternion(place[:3], place[3:])


def _calibrations(folder: Folder, depths: Sequence[str]) -> list[_Calibration]:
    """Return the calibration of each frame; of those without one a camera as of TUM's layout, which nothing carries."""
    found = [_calibration(folder, depth) for depth in depths]
    if None not in found:
        return [each for each in found if each is not None]
    camera, _ = tum.folder_camera(folder, depths, 1 / METRES_PER_STEP)
    return [each or _Calibration(camera, np.eye(4)) for each in found]


def _calibration(folder: Folder, depth: str) -> _Calibration | None:
    """Read a frame's camera, or that of all frames; None without one, which has to be an OpenCV YAML."""
    own = _beside(folder, depth, "calib", (".yaml", ".yml"))
    tries = [own] if own else folder.directly_in("", ".yaml", ".yml")
    for name in tries:
        if folder.path(name).stat().st_size > _MOST_BYTES:
            continue
        text = read_text(folder.path(name), name)
        matrix = _matrix(text, "projection_matrix", 12, name)
        if matrix is None or matrix[0, 0] <= 0:
            matrix = _matrix(text, "camera_matrix", 9, name)
        if matrix is not None:
            sides = [re.search(rf"image_{side}\s*:\s*(\d{{1,6}})\b", text) for side in ("width", "height")]
            size = image_size(folder.path(depth), depth)
            size = (int(sides[0][1]), int(sides[1][1])) if sides[0] and sides[1] else size
            local = np.eye(4)
            if (carried := _matrix(text, "local_transform", 12, name)) is not None:
                local[:3] = carried
            return _Calibration(matrix_pinhole(matrix[:3, :3], size), local)
    return None


def _matrix(text: str, key: str, count: int, file: str) -> Floats | None:
    """Return the matrix (3,k) of `count` numbers that an OpenCV YAML has under a key, or None."""
    _, found, rest = text.partition(f"{key}:")
    _, listed, rest = rest.partition("[")
    if not found or not listed:
        return None
    return numbers(rest.partition("]")[0].replace(",", " ").split(), count, file=file, what=key).reshape(3, -1)


def _moved(records: Sequence[FrameRecord], carried: Sequence[Floats]) -> list[FrameRecord]:
    """Return the frames with poses of the camera, where those they have are of the body that carries it."""
    return [
        replace(record, camera_to_world=record.camera_to_world @ local)
        for record, local in zip(records, carried, strict=True)
    ]


def _nearer(first: list[FrameRecord], second: list[FrameRecord], *, prefer_first: bool) -> list[FrameRecord]:
    """Return whichever of the same frames with two kinds of poses agrees better on what neighbours see."""
    last = len(first) - 2
    chosen = sorted({round(at) for at in np.linspace(0, last, _CHECKED_PAIRS)}) if last >= 0 else []
    off = [
        float(np.median([_off_m(one[at], one[at + 1]) for at in chosen] or [_MOST_OFF_M])) for one in (first, second)
    ]
    if off[0] == off[1]:
        return first if prefer_first else second
    return first if off[0] < off[1] else second


def _off_m(one: FrameRecord, other: FrameRecord) -> float:
    """Return by how many metres the depth of two frames differs on average."""
    try:
        seen, known = one.depth.load(), other.depth.load()
    except CaptureError:  # which is said of it when the frames are checked
        return _MOST_OFF_M
    camera = one.intrinsics.scaled_to(seen.shape[1], seen.shape[0])
    v, u = np.indices(seen.shape)[:, ::_STEP, ::_STEP].reshape(2, -1)
    z = seen[v, u].astype(np.float64)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], axis=1)
    if not np.isfinite([one.camera_to_world, other.camera_to_world]).all():
        return _MOST_OFF_M
    there = np.linalg.pinv(other.camera_to_world) @ one.camera_to_world
    points = (rays * z[:, None])[z > 0] @ there[:3, :3].T + there[:3, 3]
    points = points[points[:, 2] > 1e-3]
    target = other.intrinsics.scaled_to(known.shape[1], known.shape[0])
    x = np.rint(points[:, 0] / points[:, 2] * target.fx + target.cx)
    y = np.rint(points[:, 1] / points[:, 2] * target.fy + target.cy)
    inside = (x >= 0) & (y >= 0) & (x < known.shape[1]) & (y < known.shape[0])
    measured = known[y[inside].astype(int), x[inside].astype(int)]
    off = np.abs(measured - points[inside, 2])[measured > 0]
    # Where the other one sees nothing counts as far off: poses that turn away would have no error otherwise.
    unseen = np.full(np.count_nonzero(z > 0) - len(off), _MOST_OFF_M)
    return float(np.mean(np.concatenate([off.clip(0, _MOST_OFF_M), unseen]))) if (z > 0).any() else _MOST_OFF_M
