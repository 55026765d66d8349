"""Check the files of an upload and pack them as one zip: what a check process does with hostile bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from capture2vr.gateway.uploads.add_photos import add_photos
from capture2vr.gateway.uploads.refusal import SEND_FEWER, Refused, too_many_files
from capture2vr.gateway.uploads.validate import FileReport, validate
from capture2vr.process.archives import ArchiveError, ArchiveLimits, is_zip, pack, unpack
from capture2vr.process.gunzip import gunzip_all
from capture2vr.sentences.sentence import say

_ZIPS = (".zip", ".r3d")  # extensions of archives: a file of such a name with other content is a broken archive


@dataclass(frozen=True, slots=True)
class CheckOrder:
    """What to check, as sent to a check process.

    folder            of the upload, where the archive is written; the files are in its folder `in`
    names             of the files, relative to that folder
    has_client_names  whether the names are the client's: the file of a raw body has none
    most_files        in an archive; most_bytes: of all files together
    continues         whether the folder has the archive of an earlier capture, to which the files are added
    """

    folder: str
    names: Sequence[str]
    has_client_names: bool
    most_files: int
    most_bytes: int
    continues: bool = False


@dataclass(frozen=True, slots=True)
class PackedFiles:
    """The archive of the checked files, its sha256 in hex, and the result for each file."""

    archive: Path
    sha256: str
    verdicts: Sequence[FileReport]


def archive_of(folder: Path) -> Path:
    """Return the path of the archive in an upload's folder."""
    return folder / "capture.zip"


def earlier_archive_of(folder: Path) -> Path:
    """Return the path, in an upload's folder, of the archive of the capture that it continues."""
    return folder / "earlier.zip"


def check_and_pack(order: CheckOrder, begin: Callable[[str], None]) -> PackedFiles:
    """Unpack an archive, validate every file, strip its metadata, and pack all as one zip.

    begin  is called with the name of each file before that is looked at

    Raises Refused.
    """
    folder = Path(order.folder)
    source, names = folder / "in", order.names
    if len(names) == 1 and (is_zip(source / names[0]) or names[0].lower().endswith(_ZIPS)):
        begin(names[0] if order.has_client_names else "")
        source, names = folder / "files", _unpack(source / names[0], folder / "files", order)
    names = _gunzip_all(source, names, order)
    if order.continues:
        source, names = _add_to_earlier(source, names, order)
    verdicts = validate(source, names, begin)
    archive = archive_of(folder)
    pack(source, archive)
    with archive.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return PackedFiles(archive, sha256, verdicts)


def _add_to_earlier(source: Path, names: Sequence[str], order: CheckOrder) -> tuple[Path, list[str]]:
    """Add the files to those of the earlier capture; return the folder with all of them, and their names.

    Raises Refused.
    """
    folder = Path(order.folder)
    earlier = folder / "earlier"
    earlier_names = _unpack(earlier_archive_of(folder), earlier, order)
    together = add_photos(source, names, earlier, earlier_names, order.most_files)
    if sum((earlier / name).stat().st_size for name in together) > order.most_bytes:
        detail = say("with_earlier_photos_capture", most=order.most_bytes)
        raise Refused("UPLOAD_TOO_LARGE", detail, hints=SEND_FEWER, status=413)
    return earlier, together


def _gunzip_all(folder: Path, names: Sequence[str], order: CheckOrder) -> list[str]:
    """Replace files behind gzip by what they hold, and return the names of all files. Raises Refused."""
    try:
        return gunzip_all(folder, names, ArchiveLimits(total_bytes=2 * order.most_bytes))
    except ArchiveError as error:
        file = error.file if order.has_client_names or folder.name != "in" else ""
        raise Refused(error.code, error.message, file or "", error.hints) from None


def _unpack(archive: Path, into: Path, order: CheckOrder) -> list[str]:
    """Unpack an archive and return the names of its files. Raises Refused."""
    client_name = order.names[0] if order.has_client_names and archive.parent.name == "in" else ""
    try:
        files = unpack(archive, into, ArchiveLimits(total_bytes=2 * order.most_bytes))
    except ArchiveError as error:
        raise Refused(error.code, error.message, error.file or client_name, error.hints) from None
    if not files:
        raise Refused("CAPTURE_EMPTY", say("archive_has_no_files"), client_name, (say("zip_files_again"),))
    if len(files) > order.most_files:
        raise too_many_files(order.most_files)
    archive.unlink()
    return [file.relative_to(into).as_posix() for file in files]
