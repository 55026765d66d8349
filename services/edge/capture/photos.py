"""Read a folder of photos without poses: JPEG, PNG, HEIC, WebP and TIFF. Only headers are read here, pixels lazily."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.gravity_tags import elevation_deg, up_in_camera
from capture2vr.edge.capture.images import read_bytes
from capture2vr.edge.capture.masks import mask_file, mask_loader, split_masks, stray_masks_warning
from capture2vr.edge.capture.nouns import MIN_PHOTOS, WALK_AROUND_ADVICE, Capture, Photo, PhotoVerdict
from capture2vr.edge.capture.panorama import VIEWS, Coverage, as_their_like, by_direction, coverage_of, views_of
from capture2vr.edge.capture.photo_copy import keep_copy
from capture2vr.edge.capture.picture import PhotoPixels, alpha_channel, camera_key, first_bytes, focal_px, read_header
from capture2vr.edge.capture.smaller_copies import without_copies
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MAX_PHOTOS = 300  # a walk-around has 20 to 100; each further photo costs seconds and improves almost nothing
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"avif")
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".heic", ".heif", ".avif")
_SEND_AGAIN = say("send_again_as_jpeg_heic")

_T = TypeVar("_T")


def matches(folder: Folder) -> bool:
    """Return whether any file has an image's magic number. Recordings have images too: try their formats first."""
    return any(_is_picture(folder, name) for name in folder.names)


def pictures(folder: Folder) -> list[str]:
    """Return the files that are images by their magic number or by their suffix, without the masks of others."""
    return split_masks(folder, _pictures_and_masks(folder))[0]


def _pictures_and_masks(folder: Folder) -> list[str]:
    return [name for name in folder.names if name.lower().endswith(SUFFIXES) or _is_picture(folder, name)]


def read(folder: Folder) -> Capture:
    """Read the photos in the folder; for those that cannot be read the capture has verdicts.

    A single photo is a capture of kind "image". Where unreadable ones leave fewer than MIN_PHOTOS, raises
    CAPTURE_UNREADABLE or IMAGE_TOO_LARGE, naming the first; CAPTURE_LOW_OVERLAP where there is none.
    """
    everything, masks = split_masks(folder, _pictures_and_masks(folder))
    names, copies = without_copies(folder, everything)
    if len(names) == 1:
        return _single_photo(folder, read_photo(folder, names[0]))
    read: list[Photo] = []
    errors: list[CaptureError] = []
    covered: list[Coverage | None] = []
    for name in evenly_spaced(names):
        try:
            photo = read_photo(folder, name)
            covered.append(coverage_of(folder.path(name), photo))
            read.append(photo)
        except CaptureError as error:
            errors.append(error)
    every = list(zip(read, as_their_like(read, covered), strict=True))
    panoramas = [views_of(folder.path(photo.name), photo, shown) for photo, shown in every if shown is not None]
    photos = [photo for photo, shown in every if shown is None]
    used = evenly_spaced(panoramas, MAX_PHOTOS // VIEWS)
    photos += by_direction(used)
    if len(photos) < (MIN_PHOTOS if errors else 2):
        raise _too_few_readable(errors[0], len(photos)) if errors else _too_few_photos(photos)
    return Capture(
        "photos",
        "photos",
        photos=tuple(photos),
        verdicts=tuple(map(unreadable_verdict, errors)),
        warnings=(
            *left_out_warning(len(names)),
            *_panoramas_warning(len(used), len(panoramas)),
            *copies,
            *stray_masks_warning(folder, masks, everything),
        ),
    )


def _single_photo(folder: Folder, photo: Photo) -> Capture:
    """Make a capture of kind "image" from one photo. Raises CAPTURE_LOW_OVERLAP where that is a panorama."""
    if (shown := coverage_of(folder.path(photo.name), photo)) is not None:
        what = say("one_panorama") if shown.is_whole else say("one_panorama_of_degrees", degrees=shown.across)
        raise CaptureError("CAPTURE_LOW_OVERLAP", what, file=photo.name, hints=(say("take_panoramas_along_a_way"),))
    warning = say("one_photo_shows", advice=WALK_AROUND_ADVICE)
    return Capture("image", "photo", photos=(photo,), verdicts=(PhotoVerdict(photo.name, "ok"),), warnings=(warning,))


def read_photo(folder: Folder, name: str) -> Photo:
    """Make a `Photo` from a file's header. Raises IMAGE_TOO_LARGE and IMAGE_UNREADABLE."""
    path = folder.path(name)
    header = read_header(path, name)
    focal = focal_px(header.tags, header.size)
    camera = camera_key(header.tags, focal, header.size)
    pixels = PhotoPixels(partial(read_bytes, path, name), name, header.decoder, header.size, header.turned)
    mask = mask_file(folder, name)
    return Photo(
        name,
        header.size,
        camera,
        keep_copy(pixels),
        focal,
        header.turns,
        load_alpha=partial(alpha_channel, path, name) if header.alpha else None,
        load_mask=None if mask is None else mask_loader(folder, mask),
        up_in_camera=up_in_camera(header.tags, header.turns),
        elevation_deg=elevation_deg(header.tags),
    )


def evenly_spaced(photos: Sequence[_T], most: int = MAX_PHOTOS) -> list[_T]:
    """Select at most so many items, evenly spaced: photos are numbered in their order around the object."""
    if len(photos) <= most:
        return list(photos)
    return [photos[round(at)] for at in np.linspace(0, len(photos) - 1, most)]


def _panoramas_warning(used: int, count: int) -> tuple[str, ...]:
    """Say that panoramas were split, and how many were used."""
    return (say("panoramas_were_split", used=used, count=count, views=VIEWS),) if count else ()


def left_out_warning(count: int) -> tuple[str, ...]:
    """Return a warning when `evenly_spaced` leaves out some of `count` photos."""
    return (say("only_photos_used_evenly_spaced", most=MAX_PHOTOS, count=count),) if count > MAX_PHOTOS else ()


def unreadable_verdict(error: CaptureError) -> PhotoVerdict:
    """Return the verdict on a photo whose reading raised `error`."""
    hint = say("send_smaller_picture") if error.code == "IMAGE_TOO_LARGE" else _SEND_AGAIN
    return PhotoVerdict(error.file or "", "unreadable", say("it_does_and_hint", what=error.message, hint=hint))


def _too_few_readable(error: CaptureError, left: int) -> CaptureError:
    """Return the error for a folder where only `left` photos can be read; `error` is that of the first other one."""
    code = error.code if error.code == "IMAGE_TOO_LARGE" else "CAPTURE_UNREADABLE"
    reason = say("only_photos_can_be_read", what=error.message, left=left, least=MIN_PHOTOS)
    return CaptureError(code, reason, file=error.file, hints=(_SEND_AGAIN,))


def _too_few_photos(photos: Sequence[Photo]) -> CaptureError:
    """Return CAPTURE_LOW_OVERLAP for a folder of fewer than MIN_PHOTOS photos, all readable."""
    count = say("count_photos" if len(photos) > 1 else "count_photo", count=len(photos))
    reason = say("capture_has_only_least_needed", what=count, least=MIN_PHOTOS)
    return CaptureError("CAPTURE_LOW_OVERLAP", reason, file=photos[0].name, hints=(WALK_AROUND_ADVICE,))


def _is_picture(folder: Folder, name: str) -> bool:
    """Return whether a file starts with the magic number of a supported image format."""
    head = first_bytes(folder.path(name), name)
    if head[4:8] == b"ftyp":
        return head[8:12] in _HEIF_BRANDS  # MP4 videos start with "ftyp" too
    return head.startswith((b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"II*\0", b"MM\0*")) or (
        head[:4] == b"RIFF" and head[8:12] == b"WEBP"
    )
