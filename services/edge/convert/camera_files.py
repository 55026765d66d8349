"""The cameras of a capture's photos as other trainers read them: COLMAP's text model, nerfstudio's transforms.json.

Both have pixel centres at one half, where ours are at integers.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.convert.capture_points import CapturePoints
from capture2vr.edge.export.obj import zip_bytes

_MOST_POINTS = 200_000  # of the points that trainers begin with; COLMAP's text has 50 bytes for each
_OPENGL = np.diag([1.0, -1, -1, 1])  # from OpenGL's axes of a camera to OpenCV's
_HALF = 0.5


@dataclass(frozen=True, slots=True)
class _Camera:
    """A photo's camera, as `asset.capture_files` writes it."""

    name: str
    size: tuple[int, int]
    camera: tuple[float, float, float, float]
    distortion: tuple[float, float, float, float, float]
    camera_to_world: Floats

    @classmethod
    def of(cls, document: dict[str, Any]) -> _Camera:
        pose = np.vstack([np.array(document["camera_to_world"], np.float64).reshape(3, 4), [0, 0, 0, 1]])
        size, camera, distortion = (tuple(document[name]) for name in ("size", "camera", "distortion"))
        return cls(str(document["name"]), size, camera, distortion, pose)

    @property
    def centre(self) -> tuple[float, float]:
        """Principal point with pixel centres at one half."""
        return self.camera[2] + _HALF, self.camera[3] + _HALF


def _cameras(data: bytes) -> list[_Camera]:
    try:
        return [_Camera.of(each) for each in json.loads(data)["cameras"]]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"the cameras cannot be read: {error!r}") from None


def colmap_zip(cameras: bytes, laz: bytes) -> bytes:
    """Encode as COLMAP's text model in a zip: sparse/0/cameras.txt, images.txt, points3D.txt. Raises ValueError."""
    views = _cameras(cameras)
    models = sorted({(each.size, each.camera, each.distortion) for each in views})
    numbers = {model: number for number, model in enumerate(models, start=1)}
    lines = []
    for number, each in enumerate(views, start=1):
        model = numbers[each.size, each.camera, each.distortion]
        name = "_".join(each.name.split())  # COLMAP ends a name at its first blank
        lines.append(f"{number} {_colmap_pose(each.camera_to_world)} {model} {name}\n\n")  # no matches follow
    described = (_colmap_model(numbers[model], *model) for model in models)
    files = {
        "sparse/0/cameras.txt": "".join(described),
        "sparse/0/images.txt": "".join(lines),
        "sparse/0/points3D.txt": CapturePoints.read(laz).at_most(_MOST_POINTS).colmap_text(),
    }
    return zip_bytes({name: text.encode() for name, text in files.items()})


def _colmap_model(number: int, size: tuple[int, int], camera: tuple[float, ...], distortion: tuple[float, ...]) -> str:
    """A line of cameras.txt. Without k3 it is the model OPENCV, which every trainer reads."""
    fx, fy, cx, cy = camera
    k1, k2, p1, p2, k3 = distortion
    parameters = [fx, fy, cx + _HALF, cy + _HALF, k1, k2, p1, p2]
    model, rest = ("FULL_OPENCV", [k3, 0.0, 0.0, 0.0]) if k3 else ("OPENCV", [])
    return f"{number} {model} {size[0]} {size[1]} {' '.join(f'{each:.9g}' for each in (*parameters, *rest))}\n"


def _colmap_pose(camera_to_world: Floats) -> str:
    """Quaternion (w first) and translation from the world to the camera."""
    to_camera = np.linalg.inv(camera_to_world)
    x, y, z, w = Rotation.from_matrix(to_camera[:3, :3]).as_quat()
    return " ".join(f"{each:.9g}" for each in (w, x, y, z, *to_camera[:3, 3]))


def transforms_zip(cameras: bytes, laz: bytes) -> bytes:
    """Encode as nerfstudio's transforms.json with points.ply, in a zip. Photos belong in images/. Raises ValueError."""
    document = {
        "camera_model": "OPENCV",
        "ply_file_path": "points.ply",
        "frames": [_nerfstudio_frame(each) for each in _cameras(cameras)],
    }
    points = CapturePoints.read(laz).at_most(_MOST_POINTS).ply()
    return zip_bytes({"transforms.json": json.dumps(document, indent=1).encode(), "points.ply": points})


def _nerfstudio_frame(view: _Camera) -> dict[str, Any]:
    values = (*view.size, *view.camera[:2], *view.centre, *view.distortion)
    names = ("w", "h", "fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    return {
        "file_path": f"images/{view.name}",
        **dict(zip(names, values, strict=True)),
        "transform_matrix": (view.camera_to_world @ _OPENGL).tolist(),
    }
