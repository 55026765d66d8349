"""Valid but odd files of every kind of points and meshes: number N is always the same file, with what it means."""

from __future__ import annotations

import gzip
import io
import tempfile
import unicodedata
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.process.archives import ArchiveError, unpack
from tests.support.odd import clouds, meshes
from tests.support.odd.truth import Judge, Truth

Files = Mapping[str, bytes]


@dataclass(frozen=True, slots=True)
class OddFile:
    """A capture: its kind, what is odd about it, its files by their names, what is around them, and what it means."""

    kind: str
    way: str
    files: Files
    around: str
    truth: Truth


KINDS: dict[str, tuple[int, Callable[[Random], Any]]] = {
    "table": (24, clouds.table),
    "PTS": (4, clouds.pts),
    "PTX": (4, clouds.ptx),
    "PLY, points": (11, clouds.ply_cloud),
    "PLY, mesh": (10, meshes.ply_mesh),
    "OBJ, mesh": (12, meshes.obj),
    "OBJ, points": (2, meshes.obj_points),
    "STL": (8, meshes.stl),
    "OFF": (3, meshes.off),
    "PCD": (7, clouds.pcd),
    "LAS": (7, clouds.las),
    "E57": (2, clouds.e57),
    "glTF": (10, meshes.gltf),
    "NPY": (2, clouds.npy),
}
"""How many of a hundred files are of a kind, about, and what makes them."""


def odd_file(number: int) -> OddFile:
    """Return the file of this number."""
    chance = Random(number)
    kind = chance.choices(list(KINDS), [share for share, _ in KINDS.values()])[0]
    return around(chance, kind, KINDS[kind][1](chance))


def around(chance: Random, kind: str, made: Any) -> OddFile:
    """Put what was made behind gzip or into a zip, or leave it as it is."""
    if isinstance(made[0], str):
        name, data, way, truth = made
        files = {name: data}
    else:
        files, way, truth = made
    found = OddFile(kind, way, files, "nothing", truth)
    drawn = chance.random()
    if drawn < 0.1 and len(files) == 1:
        ((name, data),) = files.items()
        return replace(found, files={f"{name}.gz": gzip.compress(data, 1)}, around="gzip")
    if drawn < 0.3:
        how = chance.choice(list(ZIPS))
        return replace(found, files={"scan.zip": ZIPS[how](files)}, around=f"zip, {how}")
    return found


class _Named(zipfile.ZipInfo):
    """An entry whose name is stored in an encoding of its own, and says nothing of it."""

    encoding = "utf-8"

    def _encodeFilenameFlags(self) -> tuple[bytes, int]:  # noqa: N802 - as zipfile calls it
        return self.filename.encode(self.encoding), self.flag_bits & ~0x800


def zipped(files: Files, encoding: str = "") -> bytes:
    """A zip; its names in an encoding that they do not name, or as Python writes them."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            entry = _Named(name) if encoding else zipfile.ZipInfo(name)
            if encoding:
                entry.encoding = encoding  # type: ignore[attr-defined]
            entry.filename = name  # zipfile takes its own separators for slashes
            archive.writestr(entry, data)
    return stream.getvalue()


_JUNK = {
    "scan/Icon\r": b"icon",
    "__MACOSX/scan/._a.ply": b"\0\5\x16\7",
    "scan/Thumbs.db": b"\xd0\xcf\x11\xe0",
    "scan/.DS_Store": b"\0\0\0\1Bud1",
    "scan/desktop.ini": b"[.ShellClassInfo]\r\n",
}
ZIPS: dict[str, Callable[[Files], bytes]] = {
    "backslashes": lambda files: zipped({f"scan\\parts\\{name}": data for name, data in files.items()}),
    "cp437": lambda files: zipped({f"Möbel/{name}": data for name, data in files.items()}, "cp437"),
    "cp1252": lambda files: zipped({f"Möbel/{name}": data for name, data in files.items()}, "cp1252"),
    "UTF-8 without its flag": lambda files: zipped({f"Möbel/{name}": data for name, data in files.items()}, "utf-8"),
    "decomposed": lambda files: zipped(
        {unicodedata.normalize("NFD", f"Möbel/{name}"): data for name, data in files.items()}
    ),
    "junk": lambda files: zipped({**_JUNK, **{f"scan/{name}": data for name, data in files.items()}}),
}


@contextmanager
def reading(files: Files) -> Iterator[Capture]:
    """Read files as the product does, from a folder, which is there meanwhile; a zip is unpacked into it."""
    with tempfile.TemporaryDirectory(prefix="odd-") as name:
        sent, unpacked = Path(name) / "sent", Path(name) / "unpacked"
        for file, data in files.items():
            (sent / file).parent.mkdir(parents=True, exist_ok=True)
            (sent / file).write_bytes(data)
        if list(files) == ["scan.zip"]:
            unpack(sent / "scan.zip", unpacked)
        yield read_capture(unpacked if unpacked.exists() else sent)


def verdict(files: Files, judge: Judge) -> tuple[str, str]:
    """Read files, and return how they were read, "right", "wrong", "refused" or "crashed", and why."""
    try:
        with reading(files) as capture:
            why = judge(capture)
    except (CaptureError, ArchiveError) as error:
        return "refused", f"{error.code}: {error.message}"
    except Exception as error:  # noqa: BLE001 - whatever else comes out of a reader is a crash
        return "crashed", repr(error)
    return ("wrong", why) if why else ("right", "")
