"""Place photos with their cameras in the frame of a mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.points.nouns import TextureView, UnitFrame
from capture2vr.edge.render.posed_picture import PosedPicture


def in_unit_frame(views: Sequence[TextureView], unit: UnitFrame) -> list[PosedPicture]:
    """Place photos with their cameras in the unit frame."""
    to_unit = np.eye(4)
    to_unit[:3] = np.column_stack([np.eye(3), -unit.centre]) / unit.size
    return [posed_picture(view, to_unit) for view in views]


def posed_picture(view: TextureView, to_frame: Floats) -> PosedPicture:
    """Place a photo with its camera in another frame; to_frame (4,4): from the capture frame."""
    camera = view.intrinsics
    return PosedPicture(
        to_camera=np.linalg.inv(to_frame @ view.camera_to_world),
        focal=np.array([camera.fx / camera.width, camera.fy / camera.height]),
        middle=np.array([(camera.cx + 0.5) / camera.width, (camera.cy + 0.5) / camera.height]),
        load_rgb=view.load_rgb,
        load_depth=view.load_depth_m,
        name=view.name,
        tracked=view.tracked,
        load_mask=view.load_mask,
    )
