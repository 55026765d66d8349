"""Zip archives from strangers: unpack() believes nothing that an archive says of itself; pack() is deterministic."""

from __future__ import annotations

import errno
import re
import shutil
import stat
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import BinaryIO

_BLOCK_BYTES = 1 << 20  # read at once: the most that a bomb gains before it is counted
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # all that phones write; LZMA's dictionary alone may claim GBs
_ENCRYPTED = 0x1  # general purpose flag, APPNOTE 4.4.4
_LONGEST = 255  # bytes in a file name on common file systems
_DROPPED = {"__MACOSX", "Thumbs.db", "desktop.ini"}
_DRIVE = re.compile(r"[A-Za-z]:")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first date that a zip can hold
_DIRECTORY_BYTES = 1024  # of the central directory per allowed entry: 46 and a name; beyond it is no capture
_NESTED = (  # magic numbers of archives; tar has its own far into the file
    b"PK\x03\x04",
    b"PK\x05\x06",
    b"\x1f\x8b\x08",
    b"7z\xbc\xaf\x27\x1c",
    b"Rar!\x1a\x07",
    b"\xfd7zXZ\x00",
    b"BZh91AY&SY",
    b"\x28\xb5\x2f\xfd",
)
_TAR_MAGIC, _TAR_OFFSET = b"ustar", 257
# What zipfile and zlib raise on damaged archives; a full disk is none of them.
_DAMAGE = (
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
class Limits:
    """How much an archive may hold.

    entries      files and folders
    total_bytes  unpacked, all together
    ratio        unpacked to packed, of one entry and of all; applied beyond `ratio_floor` bytes, because a small text
                 file may well shrink a thousandfold
    """

    entries: int = 5_000
    total_bytes: int = 4 << 30
    ratio: float = 100.0
    ratio_floor: int = 1 << 20


DEFAULT = Limits()


_WHAT_TO_DO = {
    "ARCHIVE_TRAVERSAL": "zip the files again, as plain files in one folder",
    "ARCHIVE_BOMB": "send the files themselves, or zip them without compression",
    "ARCHIVE_NESTED": "unpack the inner archive and zip its files",
    "ARCHIVE_TOO_MANY_ENTRIES": "send fewer frames, for example every second one",
    "ARCHIVE_BROKEN": "zip the files again, without a password, and send all of it",
}


class ArchiveError(Exception):
    """The archive is hostile or broken.

    code: ARCHIVE_...; message: one sentence; file: the entry at fault or None; hints: what the person can do about it
    """

    def __init__(self, code: str, message: str, file: str | None = None) -> None:
        super().__init__(f"{file}: {message}" if file else message)
        self.code = code
        self.message = message
        self.file = file
        self.hints = (_WHAT_TO_DO[code],)


@dataclass(frozen=True, slots=True)
class _Entry:
    info: zipfile.ZipInfo
    path: PurePosixPath


def unpack(archive: Path, into: Path, limits: Limits = DEFAULT) -> list[Path]:
    """Unpack a zip into the folder `into`, which must be absent or empty, and return the files, sorted.

    Dot files and `__MACOSX` are dropped, a single top folder is stripped. All or nothing: on an error `into` stays as
    it was. Raises ArchiveError ARCHIVE_TRAVERSAL, _BOMB, _NESTED, _TOO_MANY_ENTRIES or _BROKEN.
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
    """Zip a folder's files, or one file, without compressing (phones' files are compressed already).

    The same files give the same bytes.
    """
    paths = [source] if source.is_file() else sorted(path for path in source.rglob("*") if path.is_file())
    root = source.parent if source.is_file() else source
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_STORED) as target:
        for path in paths:
            info = zipfile.ZipInfo(_unicode(path.relative_to(root)), _EPOCH)
            info.external_attr = 0o644 << 16
            info.file_size = path.stat().st_size  # zipfile decides by it whether the entry needs 64-bit sizes
            with path.open("rb") as content, target.open(info, "w") as sink:
                shutil.copyfileobj(content, sink, _BLOCK_BYTES)


def _unicode(path: Path) -> str:
    """The path as a zip can hold it: bytes of a name that are no UTF-8 become replacement characters."""
    return path.as_posix().encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def is_zip(path: Path) -> bool:
    """Whether a file begins as a zip archive does."""
    with path.open("rb") as file:
        return file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")


def _unpack(archive: Path, into: Path, limits: Limits) -> list[PurePosixPath]:
    with _damage_named():
        _check_directory_size(archive, limits)
        with zipfile.ZipFile(archive) as opened:
            entries = _stripped(_listed(opened.infolist(), limits))
            _extract_all(opened, entries, into, limits, archive.stat().st_size)
    return [entry.path for entry in entries]


def _check_directory_size(archive: Path, limits: Limits) -> None:
    """Refuse an endless directory before zipfile reads all of it into memory.

    Reads the end record as zipfile does (APPNOTE 4.3.16, and 4.3.14 for 64 bits), so that both see the same one.
    """
    with archive.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - 22 - 0xFFFF))
        tail = file.read()
        at = len(tail) - 22 if tail[-22:-18] == b"PK\x05\x06" and tail[-2:] == b"\0\0" else tail.rfind(b"PK\x05\x06")
        if at < 0 or len(tail) - at < 22:
            raise ArchiveError("ARCHIVE_BROKEN", "the archive has no directory: it is no zip, or cut short")
        directory_bytes = struct.unpack_from("<I", tail, at + 12)[0]
        if at >= 76 and tail[at - 20 : at - 16] == b"PK\x06\x07":
            directory_bytes = max(directory_bytes % 0xFFFFFFFF, struct.unpack_from("<Q", tail, at - 36)[0])
    if directory_bytes > limits.entries * _DIRECTORY_BYTES:
        raise ArchiveError("ARCHIVE_TOO_MANY_ENTRIES", f"the archive's directory alone has {directory_bytes:,} bytes")


def _listed(infos: Sequence[zipfile.ZipInfo], limits: Limits) -> list[_Entry]:
    """The files worth unpacking; every entry is checked, wanted or not."""
    if len(infos) > limits.entries:
        raise ArchiveError(
            "ARCHIVE_TOO_MANY_ENTRIES", f"the archive has {len(infos):,} entries; {limits.entries:,} are allowed"
        )
    entries = []
    for info in infos:
        path = _safe_path(info)
        _check_kind(info)
        if not info.is_dir() and not any(part.startswith(".") or part in _DROPPED for part in path.parts):
            entries.append(_Entry(info, path))
    if sum(entry.info.file_size for entry in entries) > limits.total_bytes:
        raise _bomb(f"the archive claims more than {limits.total_bytes:,} bytes")
    _check_distinct(entries)
    return entries


def _safe_path(info: zipfile.ZipInfo) -> PurePosixPath:
    """The entry's path below the target. Raises ArchiveError for a name that leads out of it, on any system."""
    name = info.orig_filename
    if "\\" in name or name.startswith("/") or _DRIVE.match(name) or ".." in name.split("/"):
        raise ArchiveError("ARCHIVE_TRAVERSAL", "the name leads out of the archive's folder", _shown(name))
    path = PurePosixPath(name)
    if not path.parts or _CONTROL.search(name) or any(_bytes_of(part) > _LONGEST for part in path.parts):
        raise ArchiveError("ARCHIVE_BROKEN", "the archive has an impossible name", _shown(name))
    return path


def _bytes_of(name: str) -> int:
    return len(name.encode("utf-8", "surrogatepass"))


def _check_kind(info: zipfile.ZipInfo) -> None:
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise ArchiveError("ARCHIVE_TRAVERSAL", "the archive has a link or device in it", _shown(info.orig_filename))
    if info.flag_bits & _ENCRYPTED:
        raise ArchiveError("ARCHIVE_BROKEN", "the archive is encrypted", _shown(info.orig_filename))
    if info.compress_type not in _METHODS:
        raise ArchiveError(
            "ARCHIVE_BROKEN", f"compression method {info.compress_type} is not read", _shown(info.orig_filename)
        )


def _check_distinct(entries: Sequence[_Entry]) -> None:
    """No name twice, and none that is a folder of another: the second would take the place of the first."""
    seen: set[PurePosixPath] = set()
    for entry in entries:
        if entry.path in seen:
            raise ArchiveError("ARCHIVE_BROKEN", "the archive has this name twice", str(entry.path))
        seen.add(entry.path)
    for entry in entries:
        if not seen.isdisjoint(entry.path.parents):
            raise ArchiveError("ARCHIVE_BROKEN", "a folder and a file share a name", str(entry.path))


def _stripped(entries: list[_Entry]) -> list[_Entry]:
    """Without the single top folder that people zip around their files."""
    tops = {entry.path.parts[0] for entry in entries}
    if len(tops) != 1 or any(len(entry.path.parts) == 1 for entry in entries):
        return entries
    return [_Entry(entry.info, PurePosixPath(*entry.path.parts[1:])) for entry in entries]


def _extract_all(
    opened: zipfile.ZipFile, entries: Sequence[_Entry], into: Path, limits: Limits, archive_bytes: int
) -> None:
    total = 0
    for entry in entries:
        target = into / entry.path
        target.parent.mkdir(parents=True, exist_ok=True)
        size = 0
        with target.open("xb") as sink:
            for block in _blocks(opened, entry):
                size, total = size + len(block), total + len(block)
                _check_growth(entry, size, total, limits, archive_bytes)
                sink.write(block)
        if size != entry.info.file_size:
            raise ArchiveError(
                "ARCHIVE_BROKEN", f"{size:,} of {entry.info.file_size:,} bytes are there", str(entry.path)
            )
        _check_not_nested(target, str(entry.path))


def _blocks(opened: zipfile.ZipFile, entry: _Entry) -> Iterator[bytes]:
    with _damage_named(str(entry.path)), opened.open(entry.info) as source:
        while block := source.read(_BLOCK_BYTES):
            yield block


@contextmanager
def _damage_named(file: str | None = None) -> Iterator[None]:
    try:
        yield
    except _DAMAGE as error:
        raise ArchiveError("ARCHIVE_BROKEN", f"the archive is damaged: {error}", file) from None
    except OSError as error:
        if (
            error.errno != errno.EINVAL
        ):  # a seek before the beginning, which only a wrong offset in the archive asks for
            raise
        raise ArchiveError("ARCHIVE_BROKEN", "the archive is damaged: an offset points nowhere", file) from None


def _check_growth(entry: _Entry, size: int, total: int, limits: Limits, archive_bytes: int) -> None:
    """Counts what really comes out. The ratio of all together also meets bombs whose entries share their bytes."""
    if total > limits.total_bytes:
        raise _bomb(f"more than {limits.total_bytes:,} bytes come out", str(entry.path))
    packed = max(1, entry.info.compress_size)
    if size > limits.ratio_floor and size > limits.ratio * packed:
        raise _bomb(f"unpacks to more than {limits.ratio:.0f} times its size", str(entry.path))
    if total > limits.ratio_floor and total > limits.ratio * archive_bytes:
        raise _bomb(f"the archive unpacks to more than {limits.ratio:.0f} times its size", str(entry.path))


def _check_not_nested(path: Path, name: str) -> None:
    with path.open("rb") as file:
        if _is_archive(file):
            raise ArchiveError("ARCHIVE_NESTED", "an archive inside the archive", name)


def _is_archive(file: BinaryIO) -> bool:
    start = file.read(_TAR_OFFSET + len(_TAR_MAGIC))
    return start.startswith(_NESTED) or start[_TAR_OFFSET:] == _TAR_MAGIC


def _bomb(message: str, file: str | None = None) -> ArchiveError:
    return ArchiveError("ARCHIVE_BOMB", message, file)


def _shown(name: str) -> str:
    """A hostile name, safe and short enough for a log line."""
    return ascii(name)[1:-1][:200]
