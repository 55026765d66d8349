"""The photo as it is printed on a relief: on the front as it is, on the back mirrored and toned down. OpenCV.

Beside the thing both pictures go on in its colours, so that no rim shows the background. On the outline both have the
same colours: there is no seam. The back loses its detail and some light away from the outline, because a face or a
clock's hands are on one side only.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats

_INNER = 1.5  # pixels of the mask that are left out along the outline: half background, half thing
_SOFT = 0.012  # of the longer side: sigma of the blur that the back shows
_DARKER = 0.88  # times its sRGB levels, of the back's middle
_TONED = 0.06  # of the longer side: distance from the outline from which on the back is wholly toned down


@dataclass(frozen=True, slots=True)
class PrintedPicture:
    """One of the two pictures (h,w,3) uint8 sRGB, in memory: a loader of itself."""

    rgb: Bytes

    def __call__(self) -> Bytes:
        return self.rgb


def printed_pictures(rgb: Bytes, mask: Bools) -> tuple[PrintedPicture, PrintedPicture]:
    """Make the pictures for the front and the back of the thing in a picture (h,w,3) with its mask (H,W)."""
    front = continued(rgb, mask)
    return PrintedPicture(front), PrintedPicture(np.ascontiguousarray(toned_down(front, mask)[:, ::-1]))


def continued(rgb: Bytes, mask: Bools) -> Bytes:
    """Return a picture (h,w,3) whose colours inside of a mask (H,W) go on outside of it."""
    away = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    inner = np.clip(away - _INNER + 0.5, 0, 1)
    if not (inner >= 1).any():  # a thing of a few pixels
        inner = mask.astype(np.float32)
    height, width = mask.shape
    small = np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    filled = _fill(small, inner >= 1)
    size = rgb.shape[1::-1]
    share = cv2.resize(inner.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)[..., None]
    around = cv2.resize(filled, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray((share * rgb + (1 - share) * around).round(), np.uint8)


def toned_down(rgb: Bytes, mask: Bools) -> Bytes:
    """Return a picture without its detail, and darker, away from the outline of a mask (H,W)."""
    height, width = rgb.shape[:2]
    longer = max(mask.shape)
    away = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) / (_TONED * longer)
    share = cv2.resize(np.clip(away, 0, 1), (width, height), interpolation=cv2.INTER_LINEAR)[..., None]
    shrunk = cv2.resize(rgb, mask.shape[::-1], interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(shrunk, (0, 0), _SOFT * longer)
    toned = _DARKER * cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray((share * toned + (1 - share) * rgb).round(), np.uint8)


def _fill(rgb: Bytes, known: Bools) -> Floats:
    """Fill the unknown pixels of a picture (h,w,3) with those of the nearest known ones, smoothly."""
    labels_of = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    labels = labels_of[1]
    colour = np.zeros((labels.max() + 1, 3), np.float32)
    colour[labels[known]] = rgb[known]
    nearest = colour[labels]
    soft = cv2.GaussianBlur(nearest, (0, 0), 2.0)
    return np.where(known[..., None], rgb.astype(np.float32), soft)
