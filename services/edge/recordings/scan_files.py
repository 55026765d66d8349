"""Tell and read a file that is a whole capture: points or a mesh, of the formats of `clouds` and of some more.

Any of them may be behind gzip, as `scan.ply.gz`.
"""

from __future__ import annotations

import posixpath
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from capture2vr.edge.capture.files import Folder, translate_errors
from capture2vr.edge.capture.nouns import Capture, Cloud, CloudParts
from capture2vr.edge.clouds.cloud import SNIFF_BYTES, format_by_head, read_cloud
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.recordings.ksplat import read_ksplat
from capture2vr.edge.recordings.ptx import is_ptx, read_ptx
from capture2vr.edge.recordings.splat_files import SPZ_MAGIC, is_packed_ply, read_packed_ply, read_splat, read_spz
from capture2vr.process.archives import ArchiveError
from capture2vr.process.gunzip import gunzip, gunzip_head, is_gzip, plain_name

_READERS: dict[str, Callable[[Folder, str], Capture]] = {
    "ksplat": lambda folder, name: read_ksplat(folder.path(name), name),
    "splat": lambda folder, name: read_splat(folder.path(name), name),
    "spz": lambda folder, name: read_spz(folder.path(name), name),
    "packed splats": lambda folder, name: read_packed_ply(folder.path(name), name),
    "ptx": lambda folder, name: read_ptx(folder.path(name), name, folder.tick),
}


def file_format(folder: Folder, name: str) -> str | None:
    """Detect the format of a file, also behind gzip; None where it is no point cloud and no mesh."""
    path = folder.path(name)
    with translate_errors(name, "file"), path.open("rb") as stream:
        head, size = stream.read(SNIFF_BYTES), path.stat().st_size
        if is_gzip(path):
            stream.seek(max(0, size - 4))
            size = int.from_bytes(stream.read(4), "little")  # as gzip has it at its end
            head, name = gunzip_head(path, SNIFF_BYTES), plain_name(name)
    if head.startswith(SPZ_MAGIC):
        return "spz"
    if is_ptx(head):
        return "ptx"
    kind = format_by_head(head, size, name)
    if kind == "ply" and is_packed_ply(head):
        return "packed splats"
    if kind is None and head and name.lower().endswith((".splat", ".ksplat")):
        return name.lower().rpartition(".")[2]
    return kind


def read_file(folder: Folder, name: str, kind: str) -> Capture:
    """Read a file of the format that `file_format` has told."""
    if is_gzip(folder.path(name)):
        return _read_gzip(folder, name, kind)
    read = _READERS.get(kind)
    return read_cloud(folder, name, kind) if read is None else read(folder, name)


def _read_gzip(folder: Folder, name: str, kind: str) -> Capture:
    """Unpack a file into a folder of its own, which is removed when nothing reads from it any more, and read it."""
    scratch = Path(tempfile.mkdtemp(prefix="capture2vr-"))
    plain = replace(folder, root=scratch, names=(posixpath.basename(plain_name(name)),))
    try:
        gunzip(folder.path(name), plain.path(plain.names[0]), name)
        capture = read_file(plain, plain.names[0], kind)
    except ArchiveError as error:
        shutil.rmtree(scratch, ignore_errors=True)
        raise CaptureError(error.code, error.message, file=error.file, hints=error.hints) from None
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise
    if capture.whole is None:
        shutil.rmtree(scratch)
        return capture
    whole = capture.whole

    def read() -> Iterator[Cloud]:
        return whole.read()

    weakref.finalize(read, shutil.rmtree, scratch, ignore_errors=True)
    return replace(capture, whole=CloudParts(whole.count, read))
