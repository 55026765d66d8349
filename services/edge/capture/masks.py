"""Find and read the masks of photos: pictures that are white where a photo may be used.

A mask lies in a folder `masks` (or `mask`) beside the photos or beside their folder, as `NAME.jpg.png` (COLMAP),
`NAME.png` or `NAME_mask.png` (Metashape); or beside its photo, as `NAME_mask.png`, `NAME.mask.png` or
`NAME.jpg.mask.png` (RealityCapture). A photo's alpha channel is one too.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Tick
from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.frame_records import first_names
from capture2vr.edge.capture.images import broken_image, same_shape
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.capture.picture import pixels_as_stored, read_header
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.parallel import in_threads
from capture2vr.sentences.sentence import say

_FOLDERS = ("masks", "mask")
_FORMS = ("{file}{end}", "{stem}{end}", "{stem}_mask{end}", "{stem}.mask{end}", "{file}.mask{end}")
_BESIDE = _FORMS[2:]  # in the photos' own folder the others would be photos
_ENDS = (".png", ".PNG", ".jpg", ".JPG", ".jpeg", ".webp", ".tif", ".tiff")
_MARKED = re.compile(r"[._]mask$", re.IGNORECASE)
_LONGEST = 800  # pixels of a mask's longer side in memory: 0.5 MB; key points and depth are from 640 to 1,600 pixels
OPAQUE = 128  # alpha from which on a pixel may be used
_LEAST = 1e-3  # share of a photo that a mask shows at least; less is no object that could be seen


def mask_file(folder: Folder, photo: str) -> str | None:
    """Return the name of a photo's mask, or None."""
    place, file = posixpath.split(photo)
    stem = posixpath.splitext(file)[0]
    tops = [posixpath.join(place, each) for each in _FOLDERS]
    parts = place.split("/") if place else []
    tops += ["/".join((*parts[:at], each, *parts[at + 1 :])) for at in range(len(parts)) for each in _FOLDERS]
    tries = [(top, form) for top in tops for form in _FORMS] + [(place, form) for form in _BESIDE]
    names = (posixpath.join(top, form.format(file=file, stem=stem, end=end)) for top, form in tries for end in _ENDS)
    return next((name for name in names if folder.has(name)), None)


def split_masks(folder: Folder, pictures: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split a capture's pictures into photos and masks; where all of them would be masks, all are photos."""
    masks = {name for name in pictures if _is_mask(folder, name)}
    photos = [name for name in pictures if name not in masks]
    return (photos, sorted(masks)) if photos else (list(pictures), [])


def _is_mask(folder: Folder, name: str) -> bool:
    """Return whether a picture is in a folder of masks, or beside the photo whose name it has."""
    place, file = posixpath.split(name)
    if any(part.lower() in _FOLDERS for part in place.split("/")):
        return True
    stem = posixpath.splitext(file)[0]
    photo, marks = _MARKED.subn("", stem)
    return bool(marks) and any(folder.has(posixpath.join(place, photo + end)) for end in ("", *_ENDS))


def stray_masks_warning(folder: Folder, masks: Sequence[str], photos: Sequence[str]) -> tuple[str, ...]:
    """Return a warning about masks that belong to none of the photos, if any."""
    if not masks:
        return ()
    used = {mask_file(folder, photo) for photo in photos}
    stray = [name for name in masks if name not in used]
    return (say("masks_of_no_photo", names=first_names(stray)),) if stray else ()


def mask_loader(folder: Folder, name: str) -> Callable[[], Bools]:
    """Return a function that reads a mask: (h,w) bool, True where the photo may be used."""
    return partial(_read_mask, folder.path(name), name)


def _read_mask(path: Path, name: str) -> Bools:
    """Read a mask: what is lighter than half of its lightest pixel, as some have 0 and 1. Raises IMAGE_UNREADABLE."""
    read_header(path, name)  # refuses what is too large to be decoded
    pixels = pixels_as_stored(path, name)
    if pixels is None:
        raise broken_image(name, say("cannot_be_decoded_image_data"))
    light: Any = pixels if pixels.ndim == 2 else pixels[..., :3].max(axis=2)
    shown: Bools = light > light.max() / 2
    return shown if pixels.ndim == 2 or pixels.shape[2] < 4 else shown & (pixels[..., 3] > pixels[..., 3].max() / 2)


def with_masks(photos: Sequence[Photo], tick: Tick) -> tuple[tuple[Photo, ...], tuple[str, ...]]:
    """Load the masks of photos that have one; return the photos, and a warning about masks that are not used."""
    masks = in_threads(_mask_or_error, photos, tick)
    errors = [mask for mask in masks if isinstance(mask, CaptureError)]
    masked = tuple(
        photo if mask is None or isinstance(mask, CaptureError) else replace(photo, mask=mask)
        for photo, mask in zip(photos, masks, strict=True)
    )
    bare, found = sum(mask is None for mask in masks), len(masks)
    warnings = [say("masks_not_used", count=len(errors), all=found - bare, why=errors[0])] if errors else []
    if 0 < bare < found:
        warnings.append(say("photos_without_mask", count=bare, all=found))
    return masked, tuple(warnings)


def _mask_or_error(photo: Photo) -> Bools | CaptureError | None:
    """Return the mask of a photo, None for a photo without one, or why its mask cannot be used."""
    try:
        alpha = _mask_or_alpha(photo)
        if alpha is None or (photo.load_mask is None and alpha.min() >= OPAQUE):
            return None
        return _checked_mask(photo, (alpha >= OPAQUE).astype(np.uint8))
    except CaptureError as error:
        return error


def _mask_or_alpha(photo: Photo) -> Bytes | None:
    """Return a photo's mask, 0 and 255, or else its alpha channel; None without either. Raises IMAGE_UNREADABLE."""
    if photo.load_mask is not None:
        return photo.load_mask().astype(np.uint8) * np.uint8(255)
    return photo.load_alpha() if photo.load_alpha is not None else None


def _checked_mask(photo: Photo, mask: Bytes) -> Bools:
    """Return the mask as the photo is stored, at most _LONGEST pixels long.

    Raises IMAGE_UNREADABLE for one of another shape, and for one that hides everything.
    """
    import cv2

    drawn, (width, height) = mask.shape[::-1], photo.size
    if photo.turns % 2 and not same_shape(drawn, photo.size) and same_shape(drawn, (height, width)):
        mask = np.rot90(mask, photo.turns)  # it was drawn on the upright picture
    if not same_shape(mask.shape[::-1], photo.size):
        reason = say("mask_of_another_shape", width=mask.shape[1], height=mask.shape[0], w=width, h=height)
        raise broken_image(photo.name, reason)
    if mask.mean() < _LEAST:
        raise broken_image(photo.name, say("mask_hides_everything"))
    by = min(1.0, _LONGEST / max(mask.shape))
    size = (max(1, round(mask.shape[1] * by)), max(1, round(mask.shape[0] * by)))
    small: Bools = cv2.resize(255 * mask, size, interpolation=cv2.INTER_AREA) > 127
    return small
