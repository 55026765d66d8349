"""Read recordings in the layout of ARKitScenes: an iPad's depth at 256 x 192, with ARKit's trajectory.

`lowres_depth/ID_TIME.png` is u16 mm, `confidence/ID_TIME.png` 0, 1 or 2, `lowres_wide/ID_TIME.png` the colours, and
`lowres_wide_intrinsics/ID_TIME.pincam` one line: width height fx fy cx cy. A line of `lowres_wide.traj` is a time, the
rotation as axis times angle, and the translation, from the world to the camera, whose axes are OpenCV's. There are
fewer poses than depth images.
"""

from __future__ import annotations

import posixpath

import numpy as np
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder, data_lines, numbers, read_text
from capture2vr.edge.capture.frame_records import frame_of_files, image_dimensions, no_poses, pinhole, rgbd_capture
from capture2vr.edge.capture.nouns import Capture, Intrinsics
from capture2vr.edge.recordings.tum import nearest

METRES_PER_STEP = 1e-3
_TRAJECTORY = "lowres_wide.traj"
_DEPTH, _COLOUR, _CONFIDENCE, _CAMERAS = "lowres_depth", "lowres_wide", "confidence", "lowres_wide_intrinsics"


def matches(folder: Folder) -> bool:
    """Return whether the folder is a recording of ARKitScenes."""
    return folder.has_folder(_DEPTH) and folder.has_folder(_CAMERAS)


def read(folder: Folder) -> Capture:
    """Read the depth images that have a pose. Raises CaptureError, naming the file."""
    if not folder.has(_TRAJECTORY):
        raise no_poses(_DEPTH, _TRAJECTORY)
    times, poses = _read_trajectory(folder)
    colours, confidences = _by_time(folder, _COLOUR, ".png"), _by_time(folder, _CONFIDENCE, ".png")
    cameras = _by_time(folder, _CAMERAS, ".pincam")
    camera_times, camera_files = np.array([*cameras]), [*cameras.values()]
    depths, records = _by_time(folder, _DEPTH, ".png"), []
    wanted = np.array([*depths])
    near = zip(depths.items(), nearest(times, wanted), nearest(camera_times, wanted), strict=True)
    for (time, depth), pose, camera in near:
        if pose is None or camera is None:
            continue
        records.append(
            frame_of_files(
                folder,
                depth,
                _read_camera(folder, camera_files[camera]),
                poses[pose],
                METRES_PER_STEP,
                colour=colours.get(time),
                confidence=confidences.get(time),
            )
        )
    if not records:
        raise no_poses(_TRAJECTORY, f"a pose in {_TRAJECTORY} at the time of a depth image")
    return rgbd_capture("arkitscenes", records, axes="opencv", up=None, file=_DEPTH)


def _by_time(folder: Folder, part: str, suffix: str) -> dict[float, str]:
    """Return the seconds of the file names -> file, for the files of a folder, in the order of time."""
    found = {}
    for name in folder.directly_in(part, suffix):
        seconds = posixpath.splitext(posixpath.basename(name))[0].rpartition("_")[2]
        found[float(numbers(seconds, 1, file=name, what="file name's time")[0])] = name
    return dict(sorted(found.items()))


def _read_camera(folder: Folder, name: str) -> Intrinsics:
    width, height, *focal_and_middle = numbers(
        read_text(folder.path(name), name).split(), 6, file=name, what="width height fx fy cx cy"
    )
    return pinhole(np.array(focal_and_middle), image_dimensions(width, height, name))


def _read_trajectory(folder: Folder) -> tuple[Floats, Floats]:
    """Read times (N,) in seconds and camera-to-world poses (N,4,4); NaN, refused later, where one is not finite."""
    lines = data_lines(read_text(folder.path(_TRAJECTORY), _TRAJECTORY))
    if not lines:
        raise no_poses(_TRAJECTORY, f"a pose in {_TRAJECTORY}")
    table = np.stack([numbers(line.split(), 7, file=_TRAJECTORY, what="a line") for line in lines])
    known = np.isfinite(table[:, 1:]).all(axis=1)
    poses = np.full((len(table), 4, 4), np.nan)
    to_world = Rotation.from_rotvec(table[known, 1:4]).inv().as_matrix()
    poses[known] = np.eye(4)
    poses[known, :3, :3] = to_world
    poses[known, :3, 3] = -np.einsum("nij,nj->ni", to_world, table[known, 4:7])
    return table[:, 0], poses
