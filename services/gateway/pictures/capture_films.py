"""Find the films in a stored capture, and where their bytes lie in its archive: a browser reads a film by parts.

An archive's files are stored without compression (`capture2vr.process.archives.pack`), so a part of a film is a part of
the archive.
"""

from __future__ import annotations

import struct
import zipfile
from dataclasses import dataclass
from pathlib import PurePosixPath

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.capture_objects import capture_name
from capture2vr.gateway.pictures.capture_pictures import with_archive
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store

_TYPES = {
    ".mp4": "video/mp4",
    ".m4v": "video/mp4",
    ".mov": "video/mp4",  # browsers that refuse video/quicktime play what phones put into it
    ".webm": "video/webm",
    ".mkv": "video/webm",  # the same container
}
_LOCAL_HEADER = struct.Struct(
    "<4s22xHH"
)  # of a zip (APPNOTE 4.3.7): its signature, lengths of the name and the extra field


@dataclass(frozen=True, slots=True)
class StoredFilm:
    """A film of a capture: its name there, its media type, and where in the object `archive` it begins and how long it
    is, in bytes."""

    name: str
    media_type: str
    archive: str
    start: int
    size: int


def films_in(archive: zipfile.ZipFile, kind: str) -> list[zipfile.ZipInfo]:
    """Return the films whose key frames lassos may be in, sorted as in the capture's archive.

    kind  of the capture, as its receipt tells it. Of films beside depth images no cameras are published
    """
    if kind not in ("photos", ""):
        return []
    return [
        info
        for info in archive.infolist()
        if PurePosixPath(info.filename).suffix.lower() in _TYPES and info.compress_type == zipfile.ZIP_STORED
    ]


def find_film(store: Store, capture: str, kind: str, number: int) -> StoredFilm:
    """Return where the film at `number` in `films_in` lies.

    Raises Problem CAPTURE_UNKNOWN, CAPTURE_DAMAGED, FILM_UNKNOWN; OSError.
    """
    name = capture_name(capture)

    def find(archive: zipfile.ZipFile) -> StoredFilm:
        films = films_in(archive, kind)
        if number >= len(films):
            detail = say("capture_has_films_so_none", count=len(films), number=number)
            raise Problem(404, "FILM_UNKNOWN", detail, hints=("number them from 0",))
        info = films[number]
        header = store.get(name, start=info.header_offset, length=_LOCAL_HEADER.size)
        if len(header) < _LOCAL_HEADER.size or header[:4] != b"PK\x03\x04":
            raise zipfile.BadZipFile("a file's header is missing")
        _, name_bytes, extra_bytes = _LOCAL_HEADER.unpack(header)
        start = info.header_offset + _LOCAL_HEADER.size + name_bytes + extra_bytes
        suffix = PurePosixPath(info.filename).suffix.lower()
        return StoredFilm(info.filename, _TYPES[suffix], name, start, info.file_size)

    return with_archive(store, capture, find)
