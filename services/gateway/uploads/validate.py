"""Every file of an upload gets a verdict: whole, harmless, and without what tells who and where."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from services.gateway.errors import Problem
from services.gateway.uploads import exr, heif, jpeg, matroska, png, tiff, video, webp
from services.gateway.uploads.cleaned import Buffer, Cleaned, UnreadableError
from services.gateway.uploads.images import MOST_PIXELS, TooLargeError, check_image, mapped
from services.gateway.uploads.sniff import HEAD_BYTES, IMAGES, Kind, sniff

_CLEANERS: dict[Kind, Callable[[Buffer], Cleaned]] = {
    Kind.JPEG: jpeg.clean,
    Kind.PNG: png.clean,
    Kind.WEBP: webp.clean,
    Kind.TIFF: tiff.clean,
    Kind.HEIF: heif.clean,
    Kind.EXR: exr.clean,
    Kind.VIDEO: video.clean,
    Kind.MATROSKA: matroska.clean,
}
_SIGNATURES = {Kind.JPEG: b"\xff\xd8\xff", Kind.PNG: b"\x89PNG\r\n\x1a\n"}


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a file: "ok", or why it was left out. bytes and sha256 as stored; stripped: what was removed."""

    file: str
    bytes: int
    sha256: str
    verdict: str
    stripped: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        return {**asdict(self), "stripped": list(self.stripped)}


def validate(folder: Path, names: Iterable[str]) -> list[Verdict]:
    """Check and clean the files in place; those that no capture has are deleted.

    Raises Problem 422, naming the file: IMAGE_TOO_LARGE, IMAGE_UNREADABLE, CAPTURE_UNREADABLE, ARCHIVE_NESTED, or
    CAPTURE_EMPTY and CAPTURE_UNKNOWN_FORMAT where nothing is left.
    """
    names = sorted(names)
    only = names[0] if len(names) == 1 else ""
    if only and _kind(folder / only) is Kind.ARCHIVE:  # a zip would have been unpacked
        hints = ("send a .zip, or the files themselves",)
        raise Problem(422, "CAPTURE_UNKNOWN_FORMAT", "an archive of a kind that is not read", file=only, hints=hints)
    verdicts = [_verdict(folder, name) for name in names]
    if not any(verdict.bytes for verdict in verdicts):
        detail = "the file is empty" if only else "the upload has no file with anything in it"
        raise Problem(422, "CAPTURE_EMPTY", detail, file=only, hints=("choose some files",))
    if not any(verdict.verdict == "ok" for verdict in verdicts):
        raise Problem(
            422,
            "CAPTURE_UNKNOWN_FORMAT",
            "nothing in the upload is a photo, a film, a point cloud or a scan",
            file=verdicts[0].file,
            hints=("send photos, a film, .ply, .pcd, .las, .obj or the export of a scanner app",),
        )
    return verdicts


def _verdict(folder: Path, name: str) -> Verdict:
    path = folder / name
    kind = _kind(path)
    if kind is Kind.ARCHIVE:
        hints = ("send the archive by itself", "or unpack it and send the files")
        raise Problem(422, "ARCHIVE_NESTED", "an archive among other files", file=name, hints=hints)
    size = path.stat().st_size
    if kind is Kind.UNKNOWN:
        path.unlink()
        return Verdict(name, size, "", "left out: of no known format", ())
    stripped = _cleaned(kind, path, name) if kind in _CLEANERS else ()
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return Verdict(name, path.stat().st_size, sha256, "ok", stripped)


def _kind(path: Path) -> Kind:
    with path.open("rb") as file:
        return sniff(path.name, file.read(HEAD_BYTES))


def _cleaned(kind: Kind, path: Path, name: str) -> tuple[str, ...]:
    """Clean, then check what is left, so that no decoder ever sees the rest."""
    try:
        with mapped(path) as data:
            if not data[: len(_SIGNATURES.get(kind, b""))] == _SIGNATURES.get(kind, b""):
                raise UnreadableError("this is no picture that can be read, whatever its name says")
            cleaned = _CLEANERS[kind](data)
        if cleaned.length < path.stat().st_size:
            os.truncate(path, cleaned.length)
        if kind in IMAGES:
            with mapped(path) as data:
                check_image(kind, path, data)
    except TooLargeError as error:
        hints = (f"send pictures of at most {MOST_PIXELS // 1_000_000} megapixels",)
        raise Problem(422, "IMAGE_TOO_LARGE", str(error), file=name, hints=hints) from None
    except UnreadableError as error:
        code = "IMAGE_UNREADABLE" if kind in IMAGES else "CAPTURE_UNREADABLE"
        hints = ("send the file again, or leave it out",)
        raise Problem(422, code, str(error), file=name, hints=hints) from None
    return cleaned.removed
