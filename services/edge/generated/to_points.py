"""Turn a capture of one photo into the points of what a generator makes of it. None of them was measured."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Tick, no_tick, part_of
from capture2vr.edge.capture.nouns import Capture, Photo
from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.edge.generated.align import align
from capture2vr.edge.generated.read_mesh import read_generated
from capture2vr.edge.generated.server import GeneratorServer, failed
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.origin import PROPOSED
from capture2vr.edge.points.clean_cloud import cloud_points
from capture2vr.edge.points.nouns import CutReport, Points
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.preset import Preset
from capture2vr.edge.single_photo.cutout import CutOut, cut_out
from capture2vr.edge.single_photo.photo_window import SIDE, USUAL_M, PhotoWindow
from capture2vr.edge.single_photo.relief import MOST_CONFIDENT
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say

_PICTURE_PX = 1024  # most pixels along the sides of the picture that is sent: generators look at no more
_UNLIKE = 0.7  # IoU of the silhouettes below which a person is told that it may be another object
_ASKED, _READ = 0.1, 0.8  # shares of the time at which the generator is asked, and at which its answer is read


def generator_of(preset: Preset, server: GeneratorServer | None) -> GeneratorServer | None:
    """Return the server that a preset asks; None for one that asks none. Raises EdgeError GENERATOR_ABSENT."""
    if not preset.generates:
        return None
    if server is None:
        raise EdgeError("GENERATOR_ABSENT", say("generator_absent"), hints=(say("set_edge_generator"),))
    return server


def require_one_photo(capture: Capture) -> None:
    """Raise CaptureError GENERATOR_ONE_PHOTO for a capture of anything else."""
    if capture.kind != "image":
        what = say("generator_needs_one_photo", format=capture.format)
        raise CaptureError("GENERATOR_ONE_PHOTO", what, hints=(say("send_one_photo_or_other_preset"),))


def generated_points(
    capture: Capture,
    server: GeneratorServer,
    *,
    box: PhotoBox | None = None,
    models: ModelFolder | None = None,
    tick: Tick = no_tick,
) -> Points:
    """Have the object in the one photo, or in a rectangle of it, made by a generator; return points of it, y up and as
    the photo shows it from +z. Only the object is sent. models: may cut it out

    Raises CaptureError CAPTURE_NO_OBJECT, EdgeError GENERATOR_UNAVAILABLE and GENERATOR_FAILED.
    """
    (photo,) = capture.photos
    cut = cut_out(photo, box, models=models, tick=part_of(tick, 0.0, _ASKED))
    picture = MattedPicture.of(photo, cut)
    with tempfile.TemporaryDirectory(prefix="generated-") as name:
        glb = Path(name) / "generated.glb"
        server.generate(picture.png, glb, part_of(tick, _ASKED, _READ))
        read = read_generated(glb, Path(name), part_of(tick, _READ, 0.85))
    try:
        points = cloud_points(read)
    except CaptureError as error:
        raise failed(say("generator_mesh_unreadable", why=error.message)) from None
    unit = unit_frame(points.xyz)
    xyz = unit.to_unit(points.xyz)
    pose = align(xyz, points.rgb, picture.mask, picture.rgb, part_of(tick, 0.85, 1.0))
    unlike = (say("generated_unlike_photo", share=pose.iou),) if pose.iou < _UNLIKE else ()
    told = (say("generated_not_measured", share=pose.iou), *unlike)
    return replace(
        points,
        xyz=pose.placed(xyz),
        confidence=np.full(len(xyz), MOST_CONFIDENT, np.float32),
        origin=np.full(len(xyz), PROPOSED, np.uint8),
        metres_per_unit=USUAL_M,
        scale_confidence="unknown",
        up_source=None,
        warnings=(*told, *capture.warnings, *cut.warnings, *points.warnings),
        models=cut.models,
        cut=CutReport("object", say("made_by_generator")),
    )


@dataclass(frozen=True, slots=True)
class MattedPicture:
    """The square around an object in its photo: rgb (S,S,3) uint8 sRGB, mask (M,M) of the object, and `png`, both as
    RGBA, black where the object is not."""

    rgb: Bytes
    mask: Bools
    png: bytes

    @classmethod
    def of(cls, photo: Photo, cut: CutOut) -> MattedPicture:
        """Matte the object that was cut out of a photo."""
        from PIL import Image

        window = PhotoWindow.around(photo, cut.bounds())
        rgb = window.load(photo, _PICTURE_PX)
        shown = window.mask_of(cut, len(rgb)) if len(rgb) >= SIDE else window.mask_of(cut, SIDE)
        alpha = cv2.resize(255 * shown.astype(np.uint8), rgb.shape[1::-1], interpolation=cv2.INTER_AREA)
        rgba = np.dstack([np.where(alpha[..., None] > 0, rgb, 0), alpha]).astype(np.uint8)
        out = BytesIO()
        Image.fromarray(rgba).save(out, "PNG")
        return cls(rgb, shown, out.getvalue())
