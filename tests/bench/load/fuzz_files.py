"""Hostile files of every format that is read: number N is always the same file.

A file is a good one that was damaged (bytes flipped, cut, doubled, lengths set to extremes, numbers of texts replaced),
or made by a small grammar that keeps checksums and lengths right, so that readers get beyond the first check.
"""

from __future__ import annotations

import io
import json
import random
import re
import struct
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.support import captures, costly
from tests.support.photos import private_pictures

_EXTREMES = (0, 1, 2, 127, 128, 255, 256, 32767, 65535, 1 << 24, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, (1 << 63) - 1)
_NUMBERS = ("0", "-1", "nan", "inf", "1e308", "-1e-320", "99999999999999999999", "", "0x10", "1,5", "⁵", "1" * 400)
_MOST_BYTES = 2_000_000  # of a file: 10,000 of them in an hour

Files = Mapping[str, bytes]
"""The files of an upload, by name."""


@dataclass(frozen=True, slots=True)
class Hostile:
    """A hostile upload: its format, how it was made, and its files."""

    format: str
    way: str
    files: Files


def hostile(number: int) -> Hostile:
    """Return the hostile upload of this number."""
    chance = random.Random(number)
    if chance.random() < 0.35:
        name = chance.choice(sorted(_GRAMMARS))
        return Hostile(name, "grammar", _GRAMMARS[name](chance))
    name = chance.choice(sorted(good_files()))
    file, data = good_files()[name]
    way = chance.choice(sorted(_WAYS))
    for _ in range(chance.choice((1, 1, 2, 5))):
        data = _WAYS[way](chance, data)
    return Hostile(name, way, {file: data[:_MOST_BYTES]})


@cache
def good_files() -> Mapping[str, tuple[str, bytes]]:
    """Return a good file of each format: its name and its bytes."""
    xyz, rgb, normals = captures.sphere()
    mesh = captures.hemisphere()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        folder = Path(name)
        captures.save_las(folder / "a.las", xyz, rgb)
        captures.save_las(folder / "a.laz", xyz, rgb)
        captures.save_e57(folder / "a.e57", [captures.e57_scan(xyz, rgb)])
        captures.write_video(folder / "a.mp4", [captures.picture(number) for number in range(4)])
        written = {file.suffix[1:]: (file.name, file.read_bytes()) for file in folder.iterdir()}
        recordings = {
            write.__name__.removeprefix("write_"): ("capture.zip", _zip_of(write(folder / write.__name__)))
            for write in (
                *(captures.write_open3d, captures.write_tum, captures.write_nerfstudio, captures.write_record3d),
                *(captures.write_stray, captures.write_kitti, captures.write_polycam, captures.write_scanner3d),
                *(captures.write_depth16, captures.write_arkitscenes),
            )
        }
    exported = {
        kind: (f"a.{kind}", captures.as_bytes(mesh.export(file_type=kind))) for kind in ("obj", "stl", "off", "glb")
    }
    clouds = {
        f"pcd {form}": ("a.pcd", captures.pcd_bytes(xyz, rgb, normals, form=form)) for form in ("ascii", "binary")
    }
    return {
        **written,
        **recordings,
        **exported,
        **clouds,
        "ply": ("a.ply", captures.ply_bytes(xyz, rgb, normals)),
        "xyz": ("a.xyz", "\n".join(" ".join(map(str, row)) for row in xyz[:200]).encode()),
        "npy": ("a.npy", captures.npy_bytes(xyz)),
        "jpeg": ("a.jpg", private_pictures.jpeg()),
        "progressive jpeg": ("a.jpg", private_pictures.jpeg(progressive=True)),
        "png": ("a.png", private_pictures.png()),
        "heic": ("a.heic", private_pictures.heic()),
        "webp": ("a.webp", private_pictures.webp()),
        "tiff": ("a.tiff", private_pictures.tiff()),
        "exr": ("a.exr", private_pictures.exr()),
        "webm": ("a.webm", private_pictures.webm()),
        "mov": ("a.mov", private_pictures.film()),
    }


def _zip_of(folder: Path) -> bytes:
    root = folder if folder.is_dir() else folder.parent
    return _zipped({path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()})


def _zipped(files: Files) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in sorted(files.items()):
            archive.writestr(name, content)
    return buffer.getvalue()


def _flip(chance: random.Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(chance.choice((1, 3, 20))):
        changed[chance.randrange(len(changed))] = chance.randrange(256)
    return bytes(changed)


def _flip_head(chance: random.Random, data: bytes) -> bytes:
    """In the first bytes, where the lengths are."""
    changed = bytearray(data)
    for _ in range(chance.choice((1, 3, 8))):
        changed[chance.randrange(min(len(changed), 400))] = chance.randrange(256)
    return bytes(changed)


def _cut(chance: random.Random, data: bytes) -> bytes:
    return data[: chance.randrange(1, len(data) + 1)] or data


def _drop(chance: random.Random, data: bytes) -> bytes:
    at = chance.randrange(len(data))
    return data[:at] + data[at + chance.randrange(1, 64) :] or data


def _double(chance: random.Random, data: bytes) -> bytes:
    """A piece again and again: what is counted by length grows."""
    at = chance.randrange(len(data))
    end = at + chance.randrange(1, 4096)
    return data[:end] + data[at:end] * min(chance.choice((1, 10, 1000)), _MOST_BYTES // (end - at)) + data[end:]


def _extreme(chance: random.Random, data: bytes) -> bytes:
    """An integer of 2, 4 or 8 bytes, little or big endian, is an extreme."""
    size, order = chance.choice((2, 4, 8)), chance.choice(("<", ">"))
    value = chance.choice(_EXTREMES) & ((1 << 8 * size) - 1)
    at = chance.randrange(max(1, min(len(data), 2000) - size))
    return data[:at] + struct.pack(order + {2: "H", 4: "I", 8: "Q"}[size], value) + data[at + size :]


def _number(chance: random.Random, data: bytes) -> bytes:
    """A number of a text, or of a text header, is another one."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", data[:100_000]))
    if not found:
        return _extreme(chance, data)
    place = chance.choice(found)
    return data[: place.start()] + chance.choice(_NUMBERS).encode() + data[place.end() :]


def _splice(chance: random.Random, data: bytes) -> bytes:
    _, other = good_files()[chance.choice(sorted(good_files()))]
    at = chance.randrange(len(data))
    return data[:at] + other[chance.randrange(len(other)) :]


_WAYS: dict[str, Callable[[random.Random, bytes], bytes]] = {
    "bytes flipped": _flip,
    "head flipped": _flip_head,
    "cut": _cut,
    "bytes dropped": _drop,
    "a piece repeated": _double,
    "an extreme length": _extreme,
    "a number replaced": _number,
    "spliced with another": _splice,
}


def _png(chance: random.Random) -> Files:
    """Of any size, depth and colour type, with the right checksums and more or fewer pixels than it says."""
    side = chance.choice((1, 7, 100, 3000, 9999, 65_535, 100_000))
    height = chance.choice((1, 50, 3000, 9990))
    head = struct.pack(
        ">IIBBBBB", side, height, chance.choice((1, 2, 4, 8, 16, 3)), chance.choice((0, 2, 3, 4, 6, 9)), 0, 0, 0
    )
    pixels = zlib.compress(bytes(chance.choice((10, 10_000, 50_000_000))), 9)
    chunks = [(b"IHDR", head), (b"PLTE", bytes(chance.choice((3, 768)))), (b"IDAT", pixels), (b"IEND", b"")]
    chunks = [chunks[0], *(each for each in chunks[1:] for _ in range(chance.choice((1, 1, 1, 50))))]
    body = b"".join(struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks)
    return {"a.png": (b"\x89PNG\r\n\x1a\n" + body)[:_MOST_BYTES]}


def _scans(chance: random.Random) -> Files:
    """A progressive JPEG whose last scan comes again and again."""
    side = chance.choice((64, 1000, 4000))
    buffer = io.BytesIO()
    Image.new("RGB", (side, chance.choice((64, side))), (9, 99, 199)).save(buffer, "JPEG", progressive=True)
    whole = buffer.getvalue()
    last = whole.rindex(b"\xff\xda")
    return {"a.jpg": whole[:last] + whole[last:-2] * chance.choice((2, 50, 95, 700)) + whole[-2:]}


def _ply(chance: random.Random) -> Files:
    """Any elements and properties; faces of many corners; counts that do not fit."""
    kinds = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double", "float16", "list")
    vertices, faces = chance.choice((0, 3, 5000, 10**9)), chance.choice((0, 1, 100, 10**7))
    extra = [f"property {chance.choice(kinds)} p{number}" for number in range(chance.choice((0, 1, 40)))]
    corners = chance.choice((3, 70_000, 400_000))
    head = [
        *("ply", f"format {chance.choice(('ascii', 'binary_little_endian', 'binary_big_endian'))} 1.0"),
        *(f"element vertex {vertices}", "property float x", "property float y", "property float z", *extra),
        *(f"element face {faces}", f"property list {chance.choice(kinds)} {chance.choice(kinds)} vertex_indices"),
        "end_header",
    ]
    body = np.random.default_rng(chance.randrange(1000)).random((min(vertices, 5000), 3), np.float32).tobytes()
    polygon = struct.pack("<I", corners) + (np.arange(corners, dtype="<u4") % max(1, min(vertices, 5000))).tobytes()
    return {"a.ply": "\n".join(head).encode() + b"\n" + body + polygon}


def _obj(chance: random.Random) -> Files:
    """Groups, objects and materials without end, faces of any corners, indices that lead out."""
    lines = [f"v {chance.random()} {chance.random()} {chance.random()}" for _ in range(100)]
    for number in range(chance.choice((1, 1000, 20_000))):
        lines.append(f"{chance.choice('go')} part{number}")
        indices = [chance.choice((1, 2, 3, 100, 101, -1, -200, 0)) for _ in range(chance.choice((3, 3, 4, 50)))]
        lines.append("f " + " ".join(map(str, indices)))
    return {"a.obj": "\n".join(lines).encode()}


def _text_cloud(chance: random.Random) -> Files:
    """Lines of any length."""
    if chance.random() < 0.3:
        return {"a.xyz": b"1 2 3\n" + b"0.1 " * chance.choice((1000, 400_000))}
    rows = [
        " ".join(chance.choice(("1", "2.5", "-3e3", *_NUMBERS)) for _ in range(chance.choice((3, 6, 7))))
        for _ in range(200)
    ]
    return {chance.choice(("a.xyz", "a.pts", "a.txt", "a.csv")): "\n".join(rows).encode()}


def _glb(chance: random.Random) -> Files:
    """The document of a good GLB, changed; its lengths are right again."""
    _, data = good_files()["glb"]
    size = struct.unpack_from("<I", data, 12)[0]
    document = _changed(chance, json.loads(data[20 : 20 + size]))
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return {"a.glb": head + struct.pack("<I4s", len(text), b"JSON") + text + rest}


def _side_files(chance: random.Random) -> Files:
    """A recording whose JSON and text files are changed, in a zip that is right."""
    _, data = good_files()[chance.choice(("nerfstudio", "record3d", "stray", "polycam", "scanner3d", "open3d", "tum"))]
    files = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for name in archive.namelist():
            content = archive.read(name)
            if chance.random() < 0.5:
                try:
                    content = json.dumps(_changed(chance, json.loads(content))).encode()
                except ValueError:
                    content = _number(chance, content) if content else b""
            if chance.random() > 0.03:
                files[name] = content
    return {"capture.zip": _zipped(files)}


def _archive(chance: random.Random) -> Files:
    """Bombs, nested archives, odd names, many entries."""
    names = (
        "a.ply",
        "../a.ply",
        "/etc/passwd",
        "a/../../b",
        "a" * 300,
        "con",
        "a\0b",
        "ä/ö.xyz",
        ".",
        "__MACOSX/x",
        "C:\\x",
    )
    content = chance.choice((b"ply\n", bytes(5_000_000), good_files()["ply"][1], good_files()["jpeg"][1]))
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")  # of names that come twice: that is meant
        for number in range(chance.choice((1, 3, 6000))):
            archive.writestr(
                f"{number % 7}{chance.choice(names)}" if chance.random() < 0.5 else f"{number}.xyz",
                content[:50] if number > 20 else content,
            )
    data = buffer.getvalue()
    return {"capture.zip": chance.choice((data, _extreme(chance, data), _cut(chance, data), _zipped({"in.zip": data})))}


def _changed(chance: random.Random, value: Any) -> Any:
    """JSON with one part replaced by something else."""
    if isinstance(value, dict) and value and chance.random() < 0.9:
        name = chance.choice(sorted(value))
        return {**value, name: _changed(chance, value[name])}
    if isinstance(value, list) and value and chance.random() < 0.9:
        at = chance.randrange(len(value))
        return [*value[:at], _changed(chance, value[at]), *value[at + 1 :]]
    return chance.choice(
        (None, -1, 0, 1e308, 2**70, "", "x" * 1000, [], {}, [[]] * 1000, True, float("nan"), "../../etc")
    )


def _costly(chance: random.Random) -> Files:
    """Many small parts, or few that are used again and again, as tests/support/costly.py has them."""
    if chance.random() < 0.5:
        make, _ = costly.REFUSED[chance.choice(sorted(costly.REFUSED))]
        return _sent(make())
    repeat, count = costly.LINEAR[chance.choice(sorted(costly.LINEAR))]
    return _sent(repeat(count * chance.choice((1, 10, 50))))


def _sent(files: Files) -> Files:
    return files if len(files) == 1 else {"capture.zip": _zipped(files)}


_GRAMMARS: dict[str, Callable[[random.Random], Files]] = {
    "png": _png,
    "progressive jpeg": _scans,
    "ply": _ply,
    "obj": _obj,
    "text cloud": _text_cloud,
    "glb": _glb,
    "side files": _side_files,
    "zip": _archive,
    "costly": _costly,
}
