"""Photos alone: JPEG, PNG, HEIC, WebP and TIFF in a folder. Headers are read here, pixels when they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from services.edge.capture.files import Folder
from services.edge.capture.images import read_bytes
from services.edge.capture.nouns import AROUND, MIN_PHOTOS, Capture, Photo, PhotoVerdict
from services.edge.capture.picture import PhotoPixels, alpha_channel, camera_key, first_bytes, focal_px, read_header
from services.edge.errors import CaptureError

MAX_PHOTOS = 300  # a walk-around has 20 to 100; beyond, each photo costs seconds and adds next to nothing
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"avif")
_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".heic", ".heif", ".avif")
_SEND_AGAIN = "send it again as a JPEG or HEIC"

_T = TypeVar("_T")


def matches(folder: Folder) -> bool:
    """Whether any file is a picture by its bytes. Recordings have pictures too: ask for their formats first."""
    return any(_is_picture(folder, name) for name in folder.names)


def pictures(folder: Folder) -> list[str]:
    """The files that are pictures by their bytes, or call themselves so."""
    return [name for name in folder.names if name.lower().endswith(_SUFFIXES) or _is_picture(folder, name)]


def read(folder: Folder) -> Capture:
    """Every picture in the folder, those that cannot be read as verdicts.

    A single picture is a capture of its own kind, "image". Raises CAPTURE_UNREADABLE or IMAGE_TOO_LARGE, naming the
    first such file, when fewer than MIN_PHOTOS are left, and CAPTURE_LOW_OVERLAP when there never were more.
    """
    names = pictures(folder)
    if len(names) == 1:
        return _alone(read_photo(folder, names[0]))
    photos: list[Photo] = []
    errors: list[CaptureError] = []
    for name in spread(names):
        try:
            photos.append(read_photo(folder, name))
        except CaptureError as error:
            errors.append(error)
    if len(photos) < MIN_PHOTOS:
        raise _too_few(errors[0], len(photos)) if errors else _too_few_taken(photos)
    return Capture(
        "photos",
        "photos",
        photos=tuple(photos),
        verdicts=tuple(map(refused, errors)),
        warnings=spread_warning(len(names)),
    )


def _alone(photo: Photo) -> Capture:
    told = f"One photo shows one side: the rest is a guess. For its true shape, {AROUND}."
    return Capture("image", "photo", photos=(photo,), verdicts=(PhotoVerdict(photo.name, "ok"),), warnings=(told,))


def read_photo(folder: Folder, name: str) -> Photo:
    """One picture by its header. Raises IMAGE_TOO_LARGE and IMAGE_UNREADABLE."""
    path = folder.path(name)
    header = read_header(path, name)
    focal = focal_px(header.tags, header.size)
    camera = camera_key(header.tags, focal, header.size)
    pixels = PhotoPixels(partial(read_bytes, path, name), name, header.decoder, header.size, header.turned)
    alpha = partial(alpha_channel, path, name) if header.decoder != "heif" else None
    return Photo(name, header.size, camera, pixels, focal, header.turns, load_alpha=alpha)


def spread(photos: Sequence[_T]) -> list[_T]:
    """At most MAX_PHOTOS of them, evenly: photos are numbered along the way round the thing."""
    if len(photos) <= MAX_PHOTOS:
        return list(photos)
    return [photos[round(at)] for at in np.linspace(0, len(photos) - 1, MAX_PHOTOS)]


def spread_warning(count: int) -> tuple[str, ...]:
    """A sentence about what `spread` left out."""
    return (f"{MAX_PHOTOS} of {count:,} photos are used, spread evenly",) if count > MAX_PHOTOS else ()


def refused(error: CaptureError) -> PhotoVerdict:
    """On a photo that raised `error` when it was read."""
    hint = "send a smaller picture" if error.code == "IMAGE_TOO_LARGE" else _SEND_AGAIN
    return PhotoVerdict(error.file or "", "unreadable", f"It {error.message}; {hint}.")


def _too_few(error: CaptureError, left: int) -> CaptureError:
    code = error.code if error.code == "IMAGE_TOO_LARGE" else "CAPTURE_UNREADABLE"
    reason = f"{error.message}, and only {left} other photos can be read"
    return CaptureError(code, reason, file=error.file, hints=(_SEND_AGAIN,))


def _too_few_taken(photos: Sequence[Photo]) -> CaptureError:
    reason = f"holds {len(photos)} photo{'s' if len(photos) > 1 else ''}; at least {MIN_PHOTOS} are needed"
    return CaptureError("CAPTURE_LOW_OVERLAP", reason, file=photos[0].name, hints=(AROUND,))


def _is_picture(folder: Folder, name: str) -> bool:
    head = first_bytes(folder.path(name), name)
    if head[4:8] == b"ftyp":
        return head[8:12] in _HEIF_BRANDS  # films begin so too
    return head.startswith((b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"II*\0", b"MM\0*")) or (
        head[:4] == b"RIFF" and head[8:12] == b"WEBP"
    )
