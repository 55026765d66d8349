"""Leave out what a person drew a line around in a photo: points that the photo shows there, and its colours there.

Symbols: a place's share (x, y) is its position in the upright photo, from (0, 0) to (1, 1), with the lens's distortion;
z is its depth. A photo shows a place where z ≤ r, r being just behind the farthest surface that the photo's depth image
has within a pixel of it, or, where that has none, that the points have (`shown_depth`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.capture.nouns import Capture, Frame, Intrinsics, ShownPicture
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.points.frame_faults import FrameFaults
from capture2vr.edge.points.nouns import TextureView
from capture2vr.edge.points.shown_depth import pixels_of, shown_depth
from capture2vr.order.photo_lasso import PhotoLasso
from capture2vr.sentences.sentence import say

_NEAR = 1e-3
"""Depth, of the deepest in the image, of what hides everything where a person drew: nothing that is kept is so near."""
_NAMED = 5  # photos that a sentence names
_STAYS, _GOES_IF_SEEN, _GOES = 0, 1, 2


def _first_of(names: Sequence[str]) -> str:
    """The first few names, in one line."""
    return ", ".join(names[:_NAMED]) + (", …" if len(names) > _NAMED else "")


def require_photos(capture: Capture, lassos: Sequence[PhotoLasso]) -> None:
    """Raise EdgeError EDITS_UNKNOWN_PHOTO for a lasso in a photo that the capture does not have, or whose camera nobody
    can know: that of a single photo."""
    names = [photo.name for photo in capture.photos] + [frame.shown.name for frame in capture.frames if frame.shown]
    known = {*names, *(verdict.name for verdict in capture.verdicts)}
    wrong = next((number for number, lasso in enumerate(lassos) if lasso.photo not in known), None)
    if lassos and capture.kind == "image":
        hint = say("leave_lassos_out_mark_thing")
        raise EdgeError("EDITS_UNKNOWN_PHOTO", say("edits_lassos_capture_single_photo"), hints=(hint,))
    if wrong is not None:
        some = _first_of(names)
        raise EdgeError(
            "EDITS_UNKNOWN_PHOTO",
            say(
                "edits_lassos_photo_no_photo",
                number=wrong,
                photo=lassos[wrong].photo,
                format=capture.format,
                names=some or "no photos",
            ),
            hints=(say("name_one_them_as_capture") if names else say("leave_lassos"),),
        )


@dataclass(frozen=True, slots=True)
class DrawnView:
    """A photo with a person's lines, and the depth up to which it shows places.

    camera     of the depth image
    to_camera  (4,4) capture frame -> OpenCV axes
    reach      (H,W) z up to which a place is shown; infinite where the photo shows no surface
    shown      maps positions in the image to the upright photo
    """

    camera: Intrinsics
    to_camera: Floats
    reach: Floats
    shown: ShownPicture
    lassos: tuple[PhotoLasso, ...]

    def leaves_out(self, xyz: Floats) -> Bools:
        """Return a mask (N,) of the points (N,3) in the capture frame that the lines leave out."""
        at, z = _project(self.camera, self.to_camera, xyz)
        out = np.zeros(len(xyz), bool)
        index = np.flatnonzero((z > 0) & (at >= 0).all(axis=1) & (at < 1).all(axis=1))
        if not len(index):  # the photo shows nothing of them
            return out
        verdict = left_out(self.shown.to_upright(at[index]), self.lassos)
        seen = z[index] <= self.reach[pixels_of(at[index], self.reach.shape)]
        out[index] = (verdict == _GOES) | ((verdict == _GOES_IF_SEEN) & seen)
        return out


def drawn_views(frames: Sequence[Frame], lassos: Sequence[PhotoLasso], xyz: Floats) -> tuple[DrawnView, ...]:
    """Prepare posed frames for judging points by the lines in their pictures.

    xyz (N,3)  all points, which hide each other where a frame has no depth
    """
    return tuple(_drawn_view(frame, _lines_in(frame, lassos), xyz) for frame in frames)


def hide_left_out(
    views: Sequence[TextureView], frames: Sequence[Frame], lassos: Sequence[PhotoLasso]
) -> tuple[TextureView, ...]:
    """Return the views such that nothing is seen through what the lines in their pictures leave out.

    Their depth there is that of something just before the lens. So they give no colours there, and tell nothing of what
    is behind: neither that there is a surface, nor that there is none.
    """
    drawn = {frame.name: frame for frame in frames}
    return tuple(
        replace(view, load_depth_m=partial(_covered_depth, view.load_depth_m, frame.shown, _lines_in(frame, lassos)))
        if (frame := drawn.get(view.name)) and frame.shown
        else view
        for view in views
    )


def left_out(at: Floats, lassos: Sequence[PhotoLasso]) -> Bytes:
    """Return (N,) for positions (N,2) in an upright photo, as shares of its sides: 0 what is there stays, 1 what the
    photo shows there goes, 2 what is hidden behind it goes too.
    """
    verdict = np.full(len(at), _STAYS, np.uint8)
    keeping = [lasso for lasso in lassos if lasso.keeps]
    if keeping:
        kept = np.any([inside(at, lasso.line) for lasso in keeping], axis=0)
        verdict[~kept] = _GOES if any(lasso.through for lasso in keeping) else _GOES_IF_SEEN
    for lasso in lassos:
        if not lasso.keeps:
            level = np.uint8(_GOES if lasso.through else _GOES_IF_SEEN)
            within = inside(at, lasso.line)
            verdict[within] = np.maximum(verdict[within], level)
    verdict[((at < 0) | (at > 1)).any(axis=1)] = _STAYS  # beyond what the photo shows
    return verdict


def inside(at: Floats, line: Sequence[tuple[float, float]]) -> Bools:
    """Return a mask (N,) of the positions (N,2) that a closed line goes round an odd number of times (even-odd)."""
    x, y = at[:, 0], at[:, 1]
    odd = np.zeros(len(at), bool)
    for (x0, y0), (x1, y1) in zip(line, (*line[1:], line[0]), strict=True):
        beside = np.flatnonzero((y0 > y) != (y1 > y))  # whose row the edge crosses: it is not level then
        odd[beside] ^= x[beside] < x0 + (x1 - x0) * ((y[beside] - y0) / (y1 - y0))
    return odd


def _lines_in(frame: Frame, lassos: Sequence[PhotoLasso]) -> tuple[PhotoLasso, ...]:
    return tuple(lasso for lasso in lassos if frame.shown and lasso.photo == frame.shown.name)


def _drawn_view(frame: Frame, lassos: tuple[PhotoLasso, ...], xyz: Floats) -> DrawnView:
    assert frame.shown is not None
    assert frame.camera_to_world is not None
    read = FrameFaults().read_depth(frame)
    depth, camera = (read[0], read[2]) if read else (np.zeros((1, 1), np.float32), frame.intrinsics)
    to_camera = np.linalg.inv(np.asarray(frame.camera_to_world, np.float64))
    shape = depth.shape if depth.size > 1 else (camera.height, camera.width)
    at, z = _project(camera, to_camera, xyz)
    within = (z > 0) & (at >= 0).all(axis=1) & (at < 1).all(axis=1)
    reach = shown_depth(np.broadcast_to(depth, shape), at[within], z[within])
    return DrawnView(camera, to_camera, reach, frame.shown, lassos)


def _project(camera: Intrinsics, to_camera: Floats, xyz: Floats) -> tuple[Floats, Floats]:
    """Return positions (N,2) in the image, as shares of its sides, and depths (N,); those ≤ 0 have no position."""
    x, y, z = to_camera[:3, :3] @ np.asarray(xyz, np.float64).T + to_camera[:3, 3:]
    over: Floats = 1 / np.where(z > 0, z, 1)
    column, row = camera.fx * x * over + camera.cx, camera.fy * y * over + camera.cy
    return np.stack([(column + 0.5) / camera.width, (row + 0.5) / camera.height], axis=1), z


def _covered_depth(load: Callable[[], Floats], shown: ShownPicture, lassos: tuple[PhotoLasso, ...]) -> Floats:
    """Load a depth image (H,W), with something just before the lens where the lines leave something out."""
    depth = load()
    row, column = np.indices(depth.shape).reshape(2, -1)
    at = np.stack([(column + 0.5) / depth.shape[1], (row + 0.5) / depth.shape[0]], axis=1)
    out = left_out(shown.to_upright(at), lassos).reshape(depth.shape) != _STAYS
    near = _NEAR * float(depth.max(initial=0.0)) or _NEAR
    return np.where(out, np.float32(near), depth).astype(np.float32, copy=False)
