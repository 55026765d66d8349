"""Find the photos in a stored capture that lassos may be in, and read one, without fetching the whole archive."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Callable
from pathlib import PurePosixPath
from typing import Any, TypeVar

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.capture_objects import capture_name, unknown_capture
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store

T = TypeVar("T")

_BLOCK_BYTES = 1 << 18  # of a read: the archive's list of files comes in one or two requests to the store
MOST_PICTURE_BYTES = 128 << 20
"""Most bytes of a photo that is shown: 48 megapixels take 15 MB, as a TIFF 144."""
# What `zipfile` raises for an archive with damaged bytes: they may ask for a method, a version or a password.
_DAMAGED = (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, zlib.error)
_PHOTOS = {".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".heic", ".heif", ".avif"}
_COLOURS = {".jpg", ".jpeg"}
"""Suffixes of the pictures beside depth images: PNGs there are the depth itself."""


def read_picture(store: Store, capture: str, kind: str, number: int) -> tuple[str, bytes]:
    """Return the name and the bytes of the photo at `number` in `pictures_in`.

    Raises Problem CAPTURE_UNKNOWN, CAPTURE_DAMAGED, PICTURE_UNKNOWN; OSError.
    """

    def read(archive: zipfile.ZipFile) -> tuple[str, bytes]:
        names = pictures_in(archive, kind)
        if number >= len(names):
            detail = say("capture_has_pictures_so_none", count=len(names), number=number)
            raise Problem(404, "PICTURE_UNKNOWN", detail, hints=("number them from 0",))
        return names[number], archive.read(names[number])

    return with_archive(store, capture, read)


def pictures_in(archive: zipfile.ZipFile, kind: str) -> list[str]:
    """Return the names of a capture's photos, sorted as in its archive.

    kind  of the capture, as its receipt tells it. Beside depth images only JPEGs are pictures; a single photo has no
          camera that lassos could be seen by
    """
    suffixes = {"rgbd": _COLOURS, "points": set[str](), "image": set[str]()}.get(kind, _PHOTOS)
    return [
        info.filename
        for info in archive.infolist()
        if PurePosixPath(info.filename).suffix.lower() in suffixes and info.file_size <= MOST_PICTURE_BYTES
    ]


def with_archive(store: Store, capture: str, read: Callable[[zipfile.ZipFile], T]) -> T:
    """Call `read` with a capture's archive, of which only what it reads is fetched.

    Raises Problem CAPTURE_UNKNOWN, CAPTURE_DAMAGED; OSError, and what `read` raises.
    """
    name = capture_name(capture)
    try:
        size = store.head(name).size
    except (FileNotFoundError, ValueError):
        raise unknown_capture(capture) from None
    stored = _ObjectReader(store, name, size)
    try:
        with io.BufferedReader(stored, _BLOCK_BYTES) as file, zipfile.ZipFile(file) as archive:
            return read(archive)
    except FileNotFoundError:  # deleted meanwhile
        raise unknown_capture(capture) from None
    except _DAMAGED:
        # `ZipFile` says of a file that it cannot read that it is no archive.
        if isinstance(stored.fault, FileNotFoundError):
            raise unknown_capture(capture) from None
        if stored.fault is not None:
            raise stored.fault from None
        hints = (say("delete_capture_upload_again"),)
        raise Problem(503, "CAPTURE_DAMAGED", say("files_damaged", capture=capture), hints=hints) from None


class _ObjectReader(io.RawIOBase):
    """An object of a store as a file that is read in parts. fault: the store's last error"""

    def __init__(self, store: Store, name: str, size: int) -> None:
        super().__init__()
        self._store, self._name, self._size, self._at = store, name, size, 0
        self.fault: OSError | None = None

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        if at < 0:
            raise zipfile.BadZipFile("an offset lies before the beginning of the file")
        self._at = at
        return at

    def readinto(self, buffer: Any) -> int:
        try:
            data = self._store.get(self._name, start=self._at, length=len(buffer))
        except OSError as error:
            self.fault = error
            raise
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)
