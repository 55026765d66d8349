"""Refine a model of a wide lens, such as an action camera's, which SIMPLE_RADIAL bends: as a fisheye.

The fisheye's model is that of OpenCV: a place at the angle θ from the axis is seen at the distance

    r = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)

from the middle, in focal lengths. Near the axis OpenCV's polynomial in tan θ tells the same, and replaces it.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.sfm_process import Lens
from capture2vr.edge.capture.nouns import Intrinsics

FISHEYE = "OPENCV_FISHEYE"
_BENT = 0.06
"""Share of its distance from the middle by which a lens moves a picture's corner, from which on it is refined: a
phone's moves it by .03. Of 16 simulated photos that span 110 degrees the cameras' places erred by .3 % of their
distance before, and by .01 % after; of 70 degrees by .05 and .007 %."""
_WIDEST = np.radians(52)
"""Angle from the axis up to which the polynomial is fitted, and follows an equidistant fisheye to .15 % of a focal
length. A picture of the same focal length without distortion ends below 50 degrees; what is seen beyond is left out."""
_SEEN_LESS = 0.9
"""Share of the observations that must be left for the refined model to be used."""


def refine_wide_lenses(database: Path, folder: Path, model: Any, options: Any) -> Any:
    """Return a solved model with its lenses refined as fisheyes where one bends much; else the model as it is."""
    if not any(_bend_of_corner(camera) > _BENT for camera in model.cameras.values()):
        return model
    refined = copy.deepcopy(model)
    adjusting = pycolmap.BundleAdjustmentOptions(print_summary=False)
    for camera in refined.cameras.values():
        focal, cx, cy, _ = camera.params
        camera.model, camera.params = FISHEYE, [focal, focal, cx, cy, 0.0, 0.0, 0.0, 0.0]
    pycolmap.bundle_adjustment(refined, adjusting)
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for camera in refined.cameras.values():
            opened.update_camera(camera)
    # The points beyond the old model's reach are found now.
    refined = pycolmap.triangulate_points(refined, database, folder, folder, options=options, refine_intrinsics=True)
    pycolmap.bundle_adjustment(refined, adjusting)
    _leave_out_edges(refined)
    better = refined.compute_mean_reprojection_error() < model.compute_mean_reprojection_error()
    enough = refined.compute_num_observations() > _SEEN_LESS * model.compute_num_observations()
    return refined if better and enough else model


def _bend_of_corner(camera: Any) -> float:
    """Return the share of its distance from the middle by which a SIMPLE_RADIAL camera moves its picture's corner."""
    focal, cx, cy, k1 = camera.params
    return float(abs(k1) * (cx**2 + cy**2) / focal**2)


def _leave_out_edges(model: Any) -> None:
    """Remove what is seen at wider angles than the lens is described for."""
    for number in model.reg_image_ids():
        image = model.image(number)
        fx, fy, cx, cy, *bend = image.camera.params
        farthest = _seen_at(np.array([_WIDEST]), bend)[0]
        for index, point in enumerate(image.points2D):
            x, y = point.xy
            if point.has_point3D() and np.hypot((x - cx) / fx, (y - cy) / fy) > farthest:
                model.delete_observation(number, index)


def lens_of_fisheye(camera: Any) -> Lens:
    """Convert COLMAP's OPENCV_FISHEYE to a lens with OpenCV's k1, k2 and k3, fitted to the angles near the axis."""
    fx, fy, cx, cy, *bend = (float(value) for value in camera.params)
    angle = np.linspace(0, _WIDEST, 200)
    plane = np.tan(angle)
    powers = plane[:, None] ** (3, 5, 7)
    k1, k2, k3 = np.linalg.lstsq(powers, _seen_at(angle, bend) - plane, rcond=None)[0].tolist()
    return Lens(Intrinsics(fx, fy, cx - 0.5, cy - 0.5, camera.width, camera.height), (k1, k2, 0.0, 0.0, k3), known=True)


def _seen_at(angle: Floats, bend: Sequence[float]) -> Floats:
    """Distances from the middle (N,), in focal lengths, at which angles (N,) from the axis are seen."""
    powers: Floats = angle[:, None] ** (2, 4, 6, 8)
    return np.asarray(angle * (1 + powers @ np.asarray(bend)))
