"""Clean the points of fused depth images: without outliers, and smoothed where the depth comes from stereo."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Tick, pick
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.fusion.fuse import FusedPoints, has_stereo_depth
from capture2vr.edge.fusion.texture_views import select_scene_views, select_texture_views
from capture2vr.edge.points.clean_cloud import MIN_POINTS
from capture2vr.edge.points.denoise_stereo import smooth_stereo_points
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.outliers import inliers
from capture2vr.edge.points.upright import find_up
from capture2vr.sentences.sentence import say


def points_of_frames(capture: Capture, fused: FusedPoints, tick: Tick) -> Points:
    """Make the points of a capture's fused frames, which are those of `capture`, in its frame and units.

    Raises CaptureError CAPTURE_TOO_FEW_POINTS where too few points remain.
    """
    stereo = has_stereo_depth(capture.frames)
    if fused.whole is None:
        keep = inliers(fused.xyz - fused.cameras[0], (lambda part: tick(0.4 * part)) if stereo else tick)
    else:  # box by box they were removed
        keep = np.ones(len(fused.xyz), bool)
        tick(1.0)
    if keep.sum() < MIN_POINTS:
        raise CaptureError(
            "CAPTURE_TOO_FEW_POINTS",
            say("fused_points_consistent_least_needed", kept=int(keep.sum()), count=len(keep), least=MIN_POINTS),
            hints=(say("move_slowly_in_good_light"),),
        )
    xyz = fused.xyz[keep]
    if stereo:
        xyz = smooth_stereo_points(xyz, fused.confidence[keep], lambda part: tick(0.4 + 0.6 * part))
    up, up_source = find_up(capture, xyz)
    return Points(
        xyz=xyz,
        rgb=pick(fused.rgb, keep),
        confidence=fused.confidence[keep],
        metres_per_unit=capture.metres_per_unit,
        scale_confidence=capture.scale_confidence,
        up=up,
        up_source=up_source,
        # Tracking and fusion may have met the same damaged picture.
        warnings=tuple(dict.fromkeys(capture.warnings + fused.warnings)),
        texture_views=select_texture_views(capture.frames, fused.sharpness),
        whole=fused.whole,
        scene_views=() if fused.whole is None else select_scene_views(capture.frames, fused.sharpness),
    )
