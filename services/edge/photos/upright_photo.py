"""Map positions in a view's undistorted picture to the upright photo that a person sees, with its lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.nouns import PhotoView
from capture2vr.edge.capture.upright_places import turn_places
from capture2vr.edge.photos.undistorted import camera_matrix


@dataclass(frozen=True, slots=True)
class UprightPhoto:
    """Maps positions (N,2) in a view's picture, undistorted and turned upright, to the upright photo of its file.

    Both are shares of width and height. Positions that only undistorting brought into the picture map to its outside.
    """

    view: PhotoView

    def __call__(self, at: Floats) -> Floats:
        photo = self.view.photo
        stored = self._distort(turn_places(at, -photo.turns))
        left, top, right, bottom = photo.part
        return turn_places(stored * (right - left, bottom - top) + (left, top), photo.turns)

    def _distort(self, at: Floats) -> Floats:
        """Apply the lens's distortion to positions in the stored photo."""
        import cv2

        camera = self.view.intrinsics
        size = np.array([camera.width, camera.height])
        ray = (at * size - 0.5 - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        rays = np.column_stack([ray, np.ones(len(ray))])
        lens = np.asarray(self.view.distortion, np.float64)
        pixel, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera_matrix(camera), lens)
        places: Floats = (np.asarray(pixel, np.float64).reshape(-1, 2) + 0.5) / size
        return places
