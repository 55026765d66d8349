"""Captures that must be refused, each made from scratch: what is wrong with it, and the code and file it is told by."""

from __future__ import annotations

import gzip
import io
import stat
import struct
import tarfile
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from tests.support import captures
from tests.support.photos import private_pictures

Make = Callable[[Path], Path]

XYZ = captures.sphere()[0]
LETTER = b"Dear reader,\nthis is a letter and no point cloud.\n" * 20
HTML = b"<!doctype html>\n<html><head><title>404</title></head><body>Not here.</body></html>\n"
RAR = b"Rar!\x1a\x07\x01\x00" + bytes(100)
SEVEN_ZIP = b"7z\xbc\xaf\x27\x1c\x00\x04" + bytes(100)
EMOJI = "стул 椅子 🪑.ply"  # no letter of it is ASCII


@dataclass(frozen=True, slots=True)
class Bad:
    """code: what HTTP answers; file: what is to blame, "" for the whole capture; make: write it into a folder."""

    code: str
    file: str
    make: Make


def one(name: str, content: Callable[[], bytes]) -> Make:
    """A capture of one file."""

    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content())
        return folder / name

    return make


def zipped(entries: Mapping[str | zipfile.ZipInfo, bytes], *, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip whose names may be anything, also twice the same where they are ZipInfos."""
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", method) as archive:
        warnings.simplefilter("ignore")  # zipfile warns of duplicate names, which are the point here
        for name, content in entries.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def in_zip(entries: Mapping[str | zipfile.ZipInfo, bytes]) -> Make:
    return one("upload.zip", lambda: zipped(entries))


def recording(spoil: Callable[[Path], object]) -> Make:
    """A whole RGB-D folder in Open3D's layout, then something done to it."""

    def make(folder: Path) -> Path:
        captures.write_open3d(folder / "scan")
        spoil(folder / "scan")
        return folder / "scan"

    return make


def files(contents: Mapping[str, bytes]) -> Make:
    """A folder of some files."""

    def make(folder: Path) -> Path:
        for name, content in contents.items():
            (folder / "scan" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / "scan" / name).write_bytes(content)
        return folder / "scan"

    return make


def points(xyz: np.ndarray, name: str = "scan.ply") -> Make:
    return one(name, lambda: captures.ply_bytes(xyz.astype(np.float32)))


def _link() -> zipfile.ZipInfo:
    info = zipfile.ZipInfo("depth/link.png")
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info


def _encrypted() -> bytes:
    """As if with a password: zipfile cannot encrypt, so the flag is set in both headers of a plain entry."""
    data = bytearray(zipped({"scan.ply": captures.ply_bytes(XYZ)}))
    for magic, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(magic) + offset] |= 1
    return bytes(data)


def _tar() -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        info = tarfile.TarInfo("scan.ply")
        info.size = len(LETTER)
        archive.addfile(info, io.BytesIO(LETTER))
    return buffer.getvalue()


def _picture(mode: str, kind: str) -> bytes:
    buffer = io.BytesIO()
    private_pictures.picture(mode=mode).save(buffer, kind)
    return buffer.getvalue()


@cache
def _dark_png(side: int) -> bytes:
    """98 megapixels of nothing: less than a megabyte that decodes to 200."""
    buffer = io.BytesIO()
    Image.new("I;16", (side, side)).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _sky() -> bytes:
    """A JPEG of a sky without clouds, lighter towards the horizon."""
    y = np.linspace(0, 1, 300)[:, None, None]
    blue = np.broadcast_to((1 - y) * np.array([85, 135, 215]) + y * np.array([150, 190, 235]), (300, 400, 3))
    return captures.jpg_bytes(blue.astype(np.uint8))


def _few_poses(folder: Path) -> None:
    lines = (folder / "trajectory.log").read_text().splitlines()
    (folder / "trajectory.log").write_text("\n".join(lines[:10]) + "\n")


_LINE = np.outer(np.arange(500.0), [1.0, 2.0, 3.0])
_PLY = captures.ply_bytes(XYZ)

BAD: dict[str, Bad] = {
    # single files
    "an empty file": Bad("CAPTURE_EMPTY", "scan.ply", one("scan.ply", bytes)),
    "a truncated PLY": Bad("CAPTURE_TRUNCATED", "scan.ply", one("scan.ply", lambda: _PLY[:-100])),
    "a PLY cut in its header": Bad("CAPTURE_TRUNCATED", "scan.ply", one("scan.ply", lambda: _PLY[:60])),
    "a PLY that claims 10^12 points": Bad(
        "CAPTURE_TRUNCATED", "scan.ply", one("scan.ply", lambda: _PLY.replace(b"vertex 500", b"vertex 1000000000000"))
    ),
    "NaN": Bad("CAPTURE_NOT_FINITE", "scan.ply", points(XYZ * np.nan)),
    "1e30": Bad("CAPTURE_NOT_FINITE", "scan.ply", points(XYZ * 1e30)),
    "12 points": Bad("CAPTURE_TOO_FEW_POINTS", "scan.ply", points(XYZ[:12])),
    "all points equal": Bad("CAPTURE_DEGENERATE", "scan.ply", points(np.tile(XYZ[:1], (1000, 1)))),
    "100,000 times one point": Bad("CAPTURE_DEGENERATE", "scan.ply", points(np.tile(XYZ[:1], (100_000, 1)))),
    "10,000 times 12 points": Bad("CAPTURE_TOO_FEW_POINTS", "scan.ply", points(np.tile(XYZ[:12], (10_000, 1)))),
    "points on a line": Bad("CAPTURE_DEGENERATE", "scan.ply", points(_LINE)),
    "a letter named .ply": Bad("CAPTURE_UNREADABLE", "letter.ply", one("letter.ply", lambda: LETTER)),
    "a letter": Bad("CAPTURE_UNKNOWN_FORMAT", "letter.txt", one("letter.txt", lambda: LETTER)),
    "a PDF": Bad("CAPTURE_UNKNOWN_FORMAT", "scan.pdf", one("scan.pdf", lambda: b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n" * 9)),
    "a name of other letters": Bad("CAPTURE_TRUNCATED", EMOJI, one(EMOJI, lambda: _PLY[:-100])),
    # pictures
    "a PNG of 60,000 × 60,000": Bad(
        "IMAGE_TOO_LARGE", "a.png", one("a.png", lambda: private_pictures.huge_png(60_000, 60_000))
    ),
    "a JPEG's beginning named .txt": Bad(
        "IMAGE_UNREADABLE", "photo.txt", one("photo.txt", lambda: b"\xff\xd8\xff\xe0 not really")
    ),
    "HTML named .jpg": Bad("IMAGE_UNREADABLE", "a.jpg", one("a.jpg", lambda: HTML)),
    "a truncated JPEG": Bad("IMAGE_UNREADABLE", "a.jpg", one("a.jpg", lambda: private_pictures.jpeg()[:1500])),
    "a CMYK JPEG of nothing": Bad("CAPTURE_NO_OBJECT", "a.jpg", one("a.jpg", lambda: _picture("CMYK", "JPEG"))),
    "a 16-bit PNG of nothing": Bad("CAPTURE_NO_OBJECT", "a.png", one("a.png", lambda: _picture("I;16", "PNG"))),
    "the sky": Bad("CAPTURE_NO_OBJECT", "a.jpg", one("a.jpg", _sky)),
    "a lens cap": Bad(
        "CAPTURE_NO_OBJECT", "a.jpg", one("a.jpg", lambda: captures.jpg_bytes(np.zeros((300, 400, 3), np.uint8)))
    ),
    "a GIF": Bad("CAPTURE_UNKNOWN_FORMAT", "a.gif", one("a.gif", lambda: _picture("P", "GIF"))),
    "a cut film": Bad("CAPTURE_UNREADABLE", "a.mp4", one("a.mp4", lambda: private_pictures.film()[:150])),
    # recordings
    "fewer poses than images": Bad("CAPTURE_COUNT_MISMATCH", "trajectory.log", recording(_few_poses)),
    "fewer depth images than colours": Bad(
        "CAPTURE_COUNT_MISMATCH", "trajectory.log", recording(lambda folder: (folder / "depth/00002.png").unlink())
    ),
    "a gigantic depth image": Bad(
        "IMAGE_TOO_LARGE",
        "depth/00001.png",
        recording(lambda folder: (folder / "depth/00001.png").write_bytes(private_pictures.huge_png(60_000, 60_000))),
    ),
    "a depth image that unpacks to more than 200 MB": Bad(
        "IMAGE_TOO_LARGE",
        "depth/00001.png",
        recording(lambda folder: (folder / "depth/00001.png").write_bytes(_dark_png(9_900))),
    ),
    "depth images of text": Bad(
        "IMAGE_UNREADABLE",
        "depth/00000.png",
        recording(lambda folder: (folder / "depth/00000.png").write_bytes(LETTER)),
    ),
    "a folder of empty files": Bad("CAPTURE_EMPTY", "", files({"a.ply": b"", "b.ply": b""})),
    "a folder of letters": Bad("CAPTURE_UNKNOWN_FORMAT", "", files({"a.txt": LETTER, "b.txt": LETTER})),
    "an archive among files": Bad("ARCHIVE_NESTED", "b.zip", files({"a.txt": LETTER, "b.zip": zipped({"c": b"1"})})),
    # archives
    "an empty zip": Bad("CAPTURE_EMPTY", "upload.zip", in_zip({})),
    "a zip of nothing but what macOS adds": Bad("CAPTURE_EMPTY", "upload.zip", in_zip({"__MACOSX/._a.ply": b"x"})),
    "a zip of an empty file": Bad("CAPTURE_EMPTY", "scan.ply", in_zip({"scan.ply": b""})),
    "a zip bomb": Bad("ARCHIVE_BOMB", "scan.ply", in_zip({"scan.ply": bytes(50_000_000)})),
    "a zip with ../": Bad("ARCHIVE_TRAVERSAL", "../evil.ply", in_zip({"a.ply": _PLY, "../evil.ply": _PLY})),
    "a zip with an absolute path": Bad("ARCHIVE_TRAVERSAL", "/tmp/evil.ply", in_zip({"/tmp/evil.ply": _PLY})),
    "a zip with a link": Bad("ARCHIVE_TRAVERSAL", "depth/link.png", in_zip({_link(): b"/etc/passwd"})),
    "a zip in a zip": Bad("ARCHIVE_NESTED", "inner.zip", in_zip({"inner.zip": zipped({"scan.ply": _PLY})})),
    "a zip of 6,000 entries": Bad(
        "ARCHIVE_TOO_MANY_ENTRIES",
        "upload.zip",
        one("upload.zip", lambda: zipped({f"{n}.png": b"" for n in range(6000)})),
    ),
    "a zip with a password": Bad("ARCHIVE_BROKEN", "scan.ply", one("upload.zip", _encrypted)),
    "a zip with a name twice": Bad(
        "ARCHIVE_BROKEN", "scan.ply", in_zip({zipfile.ZipInfo("scan.ply"): _PLY, zipfile.ZipInfo("scan.ply"): _PLY})
    ),
    "a zip with a name of 300 letters": Bad("ARCHIVE_BROKEN", "x" * 200, in_zip({"x" * 300: _PLY})),
    "a cut zip": Bad("ARCHIVE_BROKEN", "upload.zip", one("upload.zip", lambda: zipped({"scan.ply": _PLY})[:-40])),
    "a zip with damage inside": Bad(
        "ARCHIVE_BROKEN", "scan.ply", one("upload.zip", lambda: _flipped(zipped({"scan.ply": _PLY}), 200))
    ),
    "a letter named .zip": Bad("ARCHIVE_BROKEN", "upload.zip", one("upload.zip", lambda: LETTER)),
    "a truncated PLY in a zip": Bad("CAPTURE_TRUNCATED", "scan.ply", in_zip({"scan.ply": _PLY[:-100]})),
    "a RAR": Bad("CAPTURE_UNKNOWN_FORMAT", "scan.rar", one("scan.rar", lambda: RAR)),
    "a 7z": Bad("CAPTURE_UNKNOWN_FORMAT", "scan.7z", one("scan.7z", lambda: SEVEN_ZIP)),
    "a tar": Bad("CAPTURE_UNKNOWN_FORMAT", "scan.tar", one("scan.tar", _tar)),
    "a tar.gz": Bad("CAPTURE_UNKNOWN_FORMAT", "scan.tar.gz", one("scan.tar.gz", lambda: gzip.compress(_tar()))),
    "a cut .ply.gz": Bad("ARCHIVE_BROKEN", "scan.ply.gz", one("scan.ply.gz", lambda: gzip.compress(_PLY)[:-40])),
    "a bomb behind gzip": Bad("ARCHIVE_BOMB", "a.ply.gz", one("a.ply.gz", lambda: gzip.compress(bytes(50_000_000)))),
    "a RAR named .zip": Bad("ARCHIVE_BROKEN", "upload.zip", one("upload.zip", lambda: RAR)),
    "a Record3D file of text": Bad("ARCHIVE_BROKEN", "scan.r3d", one("scan.r3d", lambda: LETTER)),
}


def _flipped(data: bytes, at: int) -> bytes:
    return data[:at] + struct.pack("B", data[at] ^ 0xFF) + data[at + 1 :]
