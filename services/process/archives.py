"""Safe unpacking of untrusted zip archives (zip bombs, path traversal, links), and deterministic packing.

unpack() trusts no size, name or offset that an archive states about itself.
"""

from __future__ import annotations

import errno
import re
import shutil
import stat
import struct
import tempfile
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from capture2vr.errors import Capture2vrError
from capture2vr.sentences.sentence import say

_BLOCK_BYTES = 1 << 20  # per read: a zip bomb can write at most this much more than its limit
_COMPRESSIONS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # what phones write; LZMA's dictionary alone may need GBs
_ENCRYPTED = 0x1  # general purpose bit flag, APPNOTE 4.4.4
_MAX_NAME_BYTES = 255  # of a file name on common file systems
_MAX_PATH_BYTES = 1000  # of a file with its folders; Linux opens none over 4,096, those above the target included
JUNK_NAMES = {"__MACOSX", "Thumbs.db", "desktop.ini", "Icon\r"}
_UTF8 = 0x800  # flag of an entry whose name is UTF-8
_DRIVE_LETTER = re.compile(r"[A-Za-z]:")
_CONTROL_CHARACTER = re.compile(r"[\x00-\x1f\x7f]")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first date that a zip can hold
_DIRECTORY_BYTES = 1024  # of the central directory per allowed entry: 46 and a name; no real capture needs more
_ARCHIVE_MAGIC = (  # magic numbers of archives, but for gzip, behind which a file may be; tar has its own far in
    b"PK\x03\x04",
    b"PK\x05\x06",
    b"7z\xbc\xaf\x27\x1c",
    b"Rar!\x1a\x07",
    b"\xfd7zXZ\x00",
    b"BZh91AY&SY",
    b"\x28\xb5\x2f\xfd",
)
_TAR_MAGIC, _TAR_OFFSET = b"ustar", 257
# Exceptions that zipfile and zlib raise for damaged archives. A full disk (OSError) is not one of them.
_DAMAGE_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    struct.error,
    NotImplementedError,
    ValueError,
    RuntimeError,
    OverflowError,
    IndexError,
)


@dataclass(frozen=True, slots=True)
class ArchiveLimits:
    """Largest number of entries, unpacked size and compression ratio that unpack() accepts.

    entries      files and folders
    total_bytes  unpacked size of all files together
    ratio        unpacked size / packed size, of one entry and of the whole archive; checked only beyond `ratio_floor`
                 bytes, because a small text file may shrink a thousandfold
    """

    entries: int = 5_000
    total_bytes: int = 4 << 30
    ratio: float = 100.0
    ratio_floor: int = 1 << 20


DEFAULT_LIMITS = ArchiveLimits()


_HINTS = {
    "ARCHIVE_TRAVERSAL": "zip the files again, as plain files in one folder",
    "ARCHIVE_BOMB": "send the files themselves, or zip them without compression",
    "ARCHIVE_NESTED": "unpack the inner archive and zip its files",
    "ARCHIVE_TOO_MANY_ENTRIES": say("send_fewer_frames_example_every"),
    "ARCHIVE_BROKEN": "zip the files again, without a password, and send all of it",
}


class ArchiveError(Capture2vrError):
    """An archive that is hostile or damaged.

    code: ARCHIVE_...; message: one sentence; file: the entry at fault, or None; hints: what the user can do about it
    """

    def __init__(self, code: str, message: str, file: str | None = None) -> None:
        super().__init__(f"{file}: {message}" if file else message)
        self.code = code
        self.message = message
        self.file = file
        self.hints = (_HINTS[code],)


@dataclass(frozen=True, slots=True)
class _Entry:
    info: zipfile.ZipInfo
    path: PurePosixPath


def unpack(archive: Path, into: Path, limits: ArchiveLimits = DEFAULT_LIMITS) -> list[Path]:
    """Unpack a zip into the folder `into`, which must be absent or empty, and return the files' paths, sorted.

    Leaves out dot files and `__MACOSX`, and strips a single top folder. On an error `into` stays as it was. Raises
    ArchiveError ARCHIVE_TRAVERSAL, _BOMB, _NESTED, _TOO_MANY_ENTRIES or _BROKEN.
    """
    into.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=".unpack-", dir=into.parent))
    try:
        paths = _unpack(archive, scratch, limits)
        scratch.chmod(0o755)
        scratch.replace(into)  # rename(2) takes the place of an empty folder
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise
    return sorted(into / path for path in paths)


def pack(source: Path, archive: Path) -> None:
    """Zip the files of a folder, or one file, without compression: phones' files are compressed already.

    The same files always give the same bytes.
    """
    paths = [source] if source.is_file() else sorted(path for path in source.rglob("*") if path.is_file())
    root = source.parent if source.is_file() else source
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_STORED) as target:
        for path in paths:
            info = zipfile.ZipInfo(_zip_name(path.relative_to(root)), _EPOCH)
            info.external_attr = 0o644 << 16
            info.file_size = path.stat().st_size  # tells zipfile whether the entry needs 64-bit sizes
            with path.open("rb") as content, target.open(info, "w") as sink:
                shutil.copyfileobj(content, sink, _BLOCK_BYTES)


def _zip_name(path: Path) -> str:
    """Convert a path to a name that a zip can hold: bytes that are not UTF-8 become replacement characters."""
    return path.as_posix().encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def is_zip(path: Path) -> bool:
    """Return whether a file begins with the magic number of a zip archive."""
    with path.open("rb") as file:
        return file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")


def _unpack(archive: Path, into: Path, limits: ArchiveLimits) -> list[PurePosixPath]:
    with _translate_damage():
        _check_directory_size(archive, limits)
        with zipfile.ZipFile(archive) as zip_file:
            entries = _strip_top_folder(_entries_to_unpack(zip_file.infolist(), limits))
            _extract_all(zip_file, entries, into, limits, archive.stat().st_size)
    return [entry.path for entry in entries]


def _check_directory_size(archive: Path, limits: ArchiveLimits) -> None:
    """Refuse an archive with a huge central directory, before zipfile reads all of it into memory.

    Finds the end record as zipfile does (APPNOTE 4.3.16, and 4.3.14 for 64 bits), so that both see the same one.
    """
    with archive.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - 22 - 0xFFFF))
        tail = file.read()
        at = len(tail) - 22 if tail[-22:-18] == b"PK\x05\x06" and tail[-2:] == b"\0\0" else tail.rfind(b"PK\x05\x06")
        if at < 0 or len(tail) - at < 22:
            raise ArchiveError("ARCHIVE_BROKEN", say("zip_central_directory_missing"))
        directory_bytes = struct.unpack_from("<I", tail, at + 12)[0]
        if at >= 76 and tail[at - 20 : at - 16] == b"PK\x06\x07":
            directory_bytes = max(directory_bytes % 0xFFFFFFFF, struct.unpack_from("<Q", tail, at - 36)[0])
    if directory_bytes > limits.entries * _DIRECTORY_BYTES:
        raise ArchiveError("ARCHIVE_TOO_MANY_ENTRIES", say("archive_list_files_has_bytes", size=directory_bytes))


def _entries_to_unpack(infos: Sequence[zipfile.ZipInfo], limits: ArchiveLimits) -> list[_Entry]:
    """Check every entry's name, type and size, and return those to unpack: not folders, not junk files.

    Raises ArchiveError.
    """
    if len(infos) > limits.entries:
        raise ArchiveError(
            "ARCHIVE_TOO_MANY_ENTRIES",
            say("archive_has_entries_most_allowed", count=len(infos), most=limits.entries),
        )
    entries = []
    for info in infos:
        name = _plain_name(info)
        _check_inside(name)
        _check_kind(info)
        if not name.endswith("/") and not any(map(_is_junk, PurePosixPath(name).parts)):
            entries.append(_Entry(info, _path_of(name)))
    if sum(entry.info.file_size for entry in entries) > limits.total_bytes:
        raise _bomb(f"the archive's files would take more than {limits.total_bytes:,} bytes")
    _check_distinct(entries)
    return entries


def _plain_name(info: zipfile.ZipInfo) -> str:
    """Return an entry's name with slashes between its folders, where .NET writes backslashes, and composed letters.

    The bytes of a name without the flag for UTF-8 are UTF-8 all the same on a Mac, and cp437 or Windows-1252 elsewhere:
    whichever of the two makes more letters of them.
    """
    name = info.orig_filename
    if not name.isascii() and not info.flag_bits & _UTF8:
        stored = name.encode("cp437", "replace")
        try:
            name = stored.decode("utf-8")
        except UnicodeDecodeError:
            name = max(name, stored.decode("cp1252", "replace"), key=lambda each: sum(map(str.isalpha, each)))
    return unicodedata.normalize("NFC", name).replace("\\", "/")


def _check_inside(name: str) -> None:
    """Raise ArchiveError for a name that leads out of the target folder on any operating system (path traversal)."""
    if name.startswith("/") or _DRIVE_LETTER.match(name) or ".." in name.split("/"):
        raise ArchiveError("ARCHIVE_TRAVERSAL", say("file_name_points_outside_archive"), _printable(name))


def _is_junk(part: str) -> bool:
    """Return whether a part of a name is of what systems leave in zips: `Icon\\r` has a folder's picture on a Mac."""
    return part.startswith(".") or part in JUNK_NAMES


def _path_of(name: str) -> PurePosixPath:
    """Return an entry's path relative to the target folder. Raises ArchiveError for a name that none can have."""
    path = PurePosixPath(name)
    if (
        not path.parts
        or _CONTROL_CHARACTER.search(name)
        or any(_utf8_bytes(part) > _MAX_NAME_BYTES for part in path.parts)
        or _utf8_bytes(name) > _MAX_PATH_BYTES
    ):
        raise ArchiveError("ARCHIVE_BROKEN", say("file_name_empty_too_long"), _printable(name))
    return path


def _utf8_bytes(name: str) -> int:
    return len(name.encode("utf-8", "surrogatepass"))


def _check_kind(info: zipfile.ZipInfo) -> None:
    """Raises ArchiveError for links, devices, encrypted entries and unknown compression methods."""
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise ArchiveError("ARCHIVE_TRAVERSAL", say("entry_link_device_not_file"), _printable(info.orig_filename))
    if info.flag_bits & _ENCRYPTED:
        raise ArchiveError("ARCHIVE_BROKEN", say("file_encrypted_with_password"), _printable(info.orig_filename))
    if info.compress_type not in _COMPRESSIONS:
        raise ArchiveError(
            "ARCHIVE_BROKEN",
            say("compression_method_not_supported", number=info.compress_type),
            _printable(info.orig_filename),
        )


def _check_distinct(entries: Sequence[_Entry]) -> None:
    """Raises ArchiveError where two entries have the same name, or a file has the name of another file's folder.

    When unpacked, the second would overwrite the first.
    """
    paths: set[PurePosixPath] = set()
    for entry in entries:
        if entry.path in paths:
            raise ArchiveError("ARCHIVE_BROKEN", say("archive_has_two_files_name"), str(entry.path))
        paths.add(entry.path)
    for entry in entries:
        if not paths.isdisjoint(entry.path.parents):
            raise ArchiveError("ARCHIVE_BROKEN", say("folder_file_have_same_name"), str(entry.path))


def _strip_top_folder(entries: list[_Entry]) -> list[_Entry]:
    """Remove the single top folder that many zip programs put around the files."""
    tops = {entry.path.parts[0] for entry in entries}
    if len(tops) != 1 or any(len(entry.path.parts) == 1 for entry in entries):
        return entries
    return [_Entry(entry.info, PurePosixPath(*entry.path.parts[1:])) for entry in entries]


def _extract_all(
    zip_file: zipfile.ZipFile, entries: Sequence[_Entry], into: Path, limits: ArchiveLimits, archive_bytes: int
) -> None:
    total = 0
    for entry in entries:
        target = into / entry.path
        target.parent.mkdir(parents=True, exist_ok=True)
        size = 0
        with target.open("xb") as sink:
            for block in _blocks(zip_file, entry):
                size, total = size + len(block), total + len(block)
                _check_growth(entry, size, total, limits, archive_bytes)
                sink.write(block)
        if size != entry.info.file_size:
            raise ArchiveError(
                "ARCHIVE_BROKEN", say("file_has_bytes", size=size, whole=entry.info.file_size), str(entry.path)
            )
        _check_not_nested(target, str(entry.path))


def _blocks(zip_file: zipfile.ZipFile, entry: _Entry) -> Iterator[bytes]:
    with _translate_damage(str(entry.path)), zip_file.open(entry.info) as source:
        while block := source.read(_BLOCK_BYTES):
            yield block


@contextmanager
def _translate_damage(file: str | None = None) -> Iterator[None]:
    """Turn the exceptions that zipfile raises for damaged archives into ArchiveError ARCHIVE_BROKEN."""
    try:
        yield
    except _DAMAGE_ERRORS as error:
        raise ArchiveError("ARCHIVE_BROKEN", say("archive_damaged", why=error), file) from None
    except OSError as error:
        if (
            error.errno != errno.EINVAL
        ):  # a seek before the beginning, which only a wrong offset in the archive asks for
            raise
        raise ArchiveError("ARCHIVE_BROKEN", say("archive_damaged_offset_wrong"), file) from None


def _check_growth(entry: _Entry, size: int, total: int, limits: ArchiveLimits, archive_bytes: int) -> None:
    """Raises ArchiveError ARCHIVE_BOMB when the bytes unpacked so far exceed a limit.

    size   bytes of this entry so far; total: of all entries
    The ratio of the whole archive also catches bombs whose entries share the same compressed bytes.
    """
    if total > limits.total_bytes:
        raise _bomb(f"the archive unpacks to more than {limits.total_bytes:,} bytes", str(entry.path))
    packed = max(1, entry.info.compress_size)
    if size > limits.ratio_floor and size > limits.ratio * packed:
        raise _bomb(f"the file unpacks to more than {limits.ratio:.0f} times its size", str(entry.path))
    if total > limits.ratio_floor and total > limits.ratio * archive_bytes:
        raise _bomb(f"the archive unpacks to more than {limits.ratio:.0f} times its size", str(entry.path))


def _check_not_nested(path: Path, name: str) -> None:
    with path.open("rb") as file:
        if holds_archive(file.read(_TAR_OFFSET + len(_TAR_MAGIC))):
            raise ArchiveError("ARCHIVE_NESTED", say("archive_contains_another_archive"), name)


def holds_archive(head: bytes) -> bool:
    """Return whether the first bytes of a file are those of an archive."""
    return head.startswith(_ARCHIVE_MAGIC) or head[_TAR_OFFSET:].startswith(_TAR_MAGIC)


def _bomb(message: str, file: str | None = None) -> ArchiveError:
    return ArchiveError("ARCHIVE_BOMB", message, file)


def _printable(name: str) -> str:
    """Escape and shorten an untrusted file name for a log line."""
    return ascii(name)[1:-1][:200]
