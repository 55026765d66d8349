"""Files of a bundle that show what it was made from: points of the capture, cameras of its photos.

They are for downloads; the edit page reads the cameras, too. No headset reads them. They are in metres with Z up, as
programs for point clouds and trainers of other methods want it.
"""

from __future__ import annotations

import json

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import PictureCamera
from capture2vr.edge.export.laz import laz_bytes
from capture2vr.edge.export.z_up import Z_UP, z_up
from capture2vr.edge.origin import nearest_origin
from capture2vr.edge.points.downsample import voxel_downsample_to
from capture2vr.edge.points.nouns import Points
from capture2vr.order.download_formats import CAMERAS, POINTS

MOST_POINTS = 1_000_000
"""Most points of the file: with colours 5 MB, and written in a second."""


def capture_files(points: Points, to_asset: Floats) -> dict[str, bytes]:
    """Return the files by name; cameras only of photos. to_asset (4,4): from the capture frame to the asset frame"""
    xyz, rgb = voxel_downsample_to(points.xyz, points.rgb, MOST_POINTS)
    origin = points.origin if xyz is points.xyz else nearest_origin(points.xyz, points.origin, xyz)
    files = {POINTS: laz_bytes(z_up(xyz @ to_asset[:3, :3].T + to_asset[:3, 3]), rgb, origin)}
    if points.cameras:
        files[CAMERAS] = json.dumps({"cameras": [_camera(each, to_asset) for each in points.cameras]}).encode()
    return files


def _camera(camera: PictureCamera, to_asset: Floats) -> dict[str, object]:
    """A camera as JSON; its pose is a rotation and metres, whatever the unit of the capture."""
    pose = np.array(camera.camera_to_world)
    rotation = to_asset[:3, :3] / np.cbrt(np.linalg.det(to_asset[:3, :3]))
    turned = Z_UP @ rotation @ pose[:, :3]
    place = Z_UP @ (to_asset[:3, :3] @ pose[:, 3] + to_asset[:3, 3])
    return {
        "name": camera.name,
        "size": camera.size,
        "camera": camera.camera,
        "distortion": camera.distortion,
        "camera_to_world": np.column_stack([turned, place]).round(9).tolist(),
        "turns": camera.turns,
        "part": camera.part,
    }
