"""Validate the files of an upload and strip metadata that identify persons and places."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from capture2vr.gateway.strip import e57, exr, heif, jpeg, matroska, mp4, png, tiff, webp
from capture2vr.gateway.strip.in_place import Buffer, CleanResult, UnreadableError
from capture2vr.gateway.uploads.image_checks import MAX_PIXELS, TooLargeError, check_image, map_file
from capture2vr.gateway.uploads.refusal import Refused
from capture2vr.gateway.uploads.sniff import HEAD_BYTES, IMAGES, Kind, sniff
from capture2vr.order.raw_photos import is_raw_photo
from capture2vr.sentences.sentence import say

_CLEANERS: dict[Kind, Callable[[Buffer], CleanResult]] = {
    Kind.JPEG: jpeg.clean,
    Kind.PNG: png.clean,
    Kind.WEBP: webp.clean,
    Kind.TIFF: tiff.clean,
    Kind.HEIF: heif.clean,
    Kind.EXR: exr.clean,
    Kind.E57: e57.clean,
    Kind.VIDEO: mp4.clean,
    Kind.MATROSKA: matroska.clean,
}
_LEFT_OUT = {
    Kind.UNKNOWN: say("no_known_format"),
    Kind.RAW: say("raw_photos_not_read"),
    Kind.SIDECAR: say("only_says_where_when"),
}
_SIGNATURES = {Kind.JPEG: b"\xff\xd8\xff", Kind.PNG: b"\x89PNG\r\n\x1a\n"}


@dataclass(frozen=True, slots=True)
class FileReport:
    """Result for a file. verdict: "ok", or why it was left out; bytes, sha256: as stored; stripped: removed metadata"""

    file: str
    bytes: int
    sha256: str
    verdict: str
    stripped: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        return {**asdict(self), "stripped": list(self.stripped)}


def validate(folder: Path, names: Iterable[str], begin: Callable[[str], None]) -> list[FileReport]:
    """Check the files and strip their metadata in place; delete those that belong to no capture.

    begin  is called with the name of each file before it is checked

    Raises Refused, naming the file: IMAGE_TOO_LARGE, IMAGE_UNREADABLE, CAPTURE_UNREADABLE, ARCHIVE_NESTED;
    CAPTURE_EMPTY or CAPTURE_UNKNOWN_FORMAT where no usable file is left.
    """
    names = sorted(names)
    only = names[0] if len(names) == 1 else ""
    if only and _kind(folder / only) is Kind.ARCHIVE:  # not a zip, which would have been unpacked before
        hints = (say("send_zip_files_themselves"),)
        detail = say("kind_archive_not_supported")
        raise Refused("CAPTURE_UNKNOWN_FORMAT", detail, only, hints)
    verdicts = [_check_file(folder, name, begin) for name in names]
    if not any(verdict.bytes for verdict in verdicts):
        detail = say("file_empty") if only else say("all_files_upload_empty")
        raise Refused("CAPTURE_EMPTY", detail, only, (say("choose_other_files"),))
    if not any(verdict.verdict == "ok" for verdict in verdicts):
        raise _nothing_usable(verdicts)
    return verdicts


def _nothing_usable(verdicts: list[FileReport]) -> Refused:
    if raw := next((verdict for verdict in verdicts if is_raw_photo(verdict.file)), None):
        hints = (say("send_same_photos_as_jpeg"),)
        return Refused("CAPTURE_UNKNOWN_FORMAT", _LEFT_OUT[Kind.RAW], raw.file, hints)
    hints = (say("send_photos_video_ply_pcd"),)
    return Refused("CAPTURE_UNKNOWN_FORMAT", say("no_file_upload_photo_video"), verdicts[0].file, hints)


def _check_file(folder: Path, name: str, begin: Callable[[str], None]) -> FileReport:
    begin(name)
    path = folder / name
    kind = _kind(path)
    if kind is Kind.ARCHIVE:
        hints = (say("send_archive_by_itself"), say("or_unpack_send_files"))
        raise Refused("ARCHIVE_NESTED", say("upload_has_archive_among_other"), name, hints)
    size = path.stat().st_size
    if kind in _LEFT_OUT:
        path.unlink()
        return FileReport(name, size, "", say("left_out", why=_LEFT_OUT[kind]), ())
    stripped = _clean_file(kind, path, name) if kind in _CLEANERS else ()
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return FileReport(name, path.stat().st_size, sha256, "ok", stripped)


def _kind(path: Path) -> Kind:
    with path.open("rb") as file:
        return sniff(path.name, file.read(HEAD_BYTES))


def _clean_file(kind: Kind, path: Path, name: str) -> tuple[str, ...]:
    """Strip a file's metadata, then check the image, so that no decoder sees unknown parts; return what was removed.

    Raises Refused.
    """
    try:
        with map_file(path) as data:
            if not data[: len(_SIGNATURES.get(kind, b""))] == _SIGNATURES.get(kind, b""):
                raise UnreadableError(say("not_image_can_be_read_although"))
            result = _CLEANERS[kind](data)
        if result.length < path.stat().st_size:
            os.truncate(path, result.length)
        if kind in IMAGES:
            with map_file(path) as data:
                check_image(kind, path, data)
    except TooLargeError as error:
        hints = (say("send_images_most_megapixels", most=MAX_PIXELS // 1000000),)
        raise Refused("IMAGE_TOO_LARGE", str(error), name, hints) from None
    except UnreadableError as error:
        code = "IMAGE_UNREADABLE" if kind in IMAGES else "CAPTURE_UNREADABLE"
        hints = (say("send_file_again_leave"),)
        raise Refused(code, str(error), name, hints) from None
    return result.removed
