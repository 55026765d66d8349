"""Unpack files behind gzip, as `scan.ply.gz`, with the limits that archives have."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from capture2vr.process.archives import DEFAULT_LIMITS, ArchiveError, ArchiveLimits, holds_archive
from capture2vr.sentences.sentence import say

_MAGIC = b"\x1f\x8b\x08"
_SUFFIX = ".gz"
_BLOCK_BYTES = 1 << 20  # per read: a bomb can write at most this much more than its limit
_PIECE_BYTES = 512  # that are unpacked at once of a head, of which what comes before damage counts
_DAMAGE_ERRORS = (EOFError, zlib.error, gzip.BadGzipFile)


def is_gzip(path: Path) -> bool:
    """Return whether a file begins with the magic number of gzip."""
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


def gunzip_head(path: Path, count: int) -> bytes:
    """Return at most `count` of the first bytes behind gzip; what comes before damage, where there is any."""
    plain, unpacker = b"", zlib.decompressobj(zlib.MAX_WBITS | 16)
    with path.open("rb") as file:
        try:
            while len(plain) < count and not unpacker.eof and (packed := file.read(_PIECE_BYTES)):
                plain += unpacker.decompress(packed, count - len(plain))
        except zlib.error:
            pass
    return plain


def gunzip(packed: Path, plain: Path, name: str, limits: ArchiveLimits = DEFAULT_LIMITS) -> int:
    """Write what is behind gzip to the file `plain`, which must be absent, and return its size.

    name  of the packed file, for errors. Raises ArchiveError ARCHIVE_BOMB and ARCHIVE_BROKEN.
    """
    size, most = 0, max(limits.ratio_floor, limits.ratio * packed.stat().st_size)
    with packed.open("rb") as file, plain.open("xb") as sink:
        try:
            with gzip.GzipFile(fileobj=file) as source:
                while block := source.read(_BLOCK_BYTES):
                    size += len(block)
                    if size > limits.total_bytes:
                        what = say("file_unpacks_to_more_bytes", most=limits.total_bytes)
                        raise ArchiveError("ARCHIVE_BOMB", what, name)
                    if size > most:
                        what = say("file_unpacks_to_more_times", times=limits.ratio)
                        raise ArchiveError("ARCHIVE_BOMB", what, name)
                    sink.write(block)
        except _DAMAGE_ERRORS as error:
            broken = ArchiveError("ARCHIVE_BROKEN", say("file_behind_gzip_damaged", why=error), name)
            broken.hints = (say("copy_export_file_again"),)
            raise broken from None
    return size


def gunzip_all(folder: Path, names: Sequence[str], limits: ArchiveLimits = DEFAULT_LIMITS) -> list[str]:
    """Replace the files of a folder that are behind gzip by what they hold, and return the names of all files.

    The ending ".gz" is dropped from a name, unless another file has the rest. An archive behind gzip, as a .tar.gz,
    stays as it is. Raises ArchiveError as `gunzip`; `limits.total_bytes` is of all such files together.
    """
    found = list(names)
    for at, name in enumerate(found):
        path = folder / name
        if not is_gzip(path) or holds_archive(gunzip_head(path, _BLOCK_BYTES)):
            continue
        plain = path.with_name(f".gunzip-{at}")
        size = gunzip(path, plain, name, limits)
        limits = replace(limits, total_bytes=limits.total_bytes - size)
        path.unlink()
        shorter = plain_name(name)
        found[at] = name if (folder / shorter).exists() else shorter
        plain.rename(folder / found[at])
    return found


def plain_name(name: str) -> str:
    """Return the name of a file that is behind gzip without the ending that says so."""
    stem = name[: -len(_SUFFIX)]
    return stem if name.lower().endswith(_SUFFIX) and stem.rpartition("/")[2] else name
