"""Small files that cost a reader much: pictures that unpack to gigabytes, and texts that repeat what is read anew."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from functools import cache

import laspy
import numpy as np
from PIL import Image

_SIDE = 8_000  # pixels: 64 million in a picture


def zipped(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip of these files; packed, repeated content costs little."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return buffer.getvalue()


@cache
def plain_png(side: int = _SIDE, channels: int = 3) -> bytes:
    """A PNG of one colour: 64 megapixels in some hundred kilobytes."""
    head = struct.pack(">IIBBBBB", side, side, 8, {1: 0, 3: 2}[channels], 0, 0, 0)
    packer = zlib.compressobj(6)
    row = b"\0" + b"\x80" * side * channels
    packed = b"".join(packer.compress(row) for _ in range(side)) + packer.flush()
    chunks = ((b"IHDR", head), (b"IDAT", packed), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def tiff_of_shared_strips(side: int = 10_000, rows: int = 100) -> bytes:
    """A TIFF of 100 megapixels whose strips are all the same few bytes."""
    strip = zlib.compress(bytes(side * rows))
    count = side // rows
    tags = (
        (256, 4, 1, side),
        (257, 4, 1, side),
        (258, 3, 1, 8),
        (259, 3, 1, 8),  # deflate
        (262, 3, 1, 1),
        (273, 4, count, 8 + len(strip)),
        (277, 3, 1, 1),
        (278, 4, 1, rows),
        (279, 4, count, 8 + len(strip) + 4 * count),
    )
    arrays = struct.pack(f"<{count}I", *[8] * count) + struct.pack(f"<{count}I", *[len(strip)] * count)
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    return struct.pack("<2sHI", b"II", 42, 8 + len(strip) + len(arrays)) + strip + arrays + directory


def obj_of_libraries(size: int = 594_000) -> dict[str, bytes]:
    """An OBJ that names its library again and again, and the library, which has many materials."""
    line = b"mtllib a.mtl\n"
    corners, face = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", b"usemtl m7\nf 1 2 3\n"
    library = b"".join(b"newmtl m%d\nKd 1 0 0\n" % number for number in range(400))
    return {"a.obj": corners + line * (size // len(line)) + face, "a.mtl": library}


def obj_of_materials(count: int) -> bytes:
    """An OBJ with a triangle of each of so many materials."""
    return b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"".join(b"usemtl m%d\nf 1 2 3\n" % number for number in range(count))


def ply_of_one_face(corners: int) -> bytes:
    """A square of vertices, and one polygon of so many corners on it."""
    xyz = np.random.default_rng(0).random((4000, 3), np.float32)
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz)}\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uint int vertex_indices\nend_header\n"
    )
    indices = (np.arange(corners, dtype="<u4") % len(xyz)).astype("<i4")
    return head.encode() + xyz.tobytes() + np.uint32(corners).tobytes() + indices.tobytes()


def jpeg_of_scans(side: int, scans: int) -> bytes:
    """A progressive JPEG whose last scan comes again and again."""
    buffer = io.BytesIO()
    Image.new("RGB", (side, side), (9, 99, 199)).save(buffer, "JPEG", progressive=True)
    whole = buffer.getvalue()
    last = whole.rindex(b"\xff\xda")
    return whole[:last] + whole[last:-2] * scans + whole[-2:]


def deep_png() -> bytes:
    """A PNG that says that it has 100 megapixels of 16 bits and four channels, and has none."""
    whole = bytearray(plain_png(8))
    whole[16:26] = struct.pack(">IIBB", 10_000, 9_990, 16, 6)
    whole[29:33] = struct.pack(">I", zlib.crc32(whole[12:29]))
    return bytes(whole)


def cloud(count: int = 600) -> bytes:
    """An honest PLY of a sphere of so many points, 9 KB."""
    directions = np.random.default_rng(0).normal(size=(count, 3))
    xyz = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype("<f4")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    return f"{head}{axes}end_header\n".encode() + xyz.tobytes()


def obj_of_a_large_library(materials: int = 300_000) -> dict[str, bytes]:
    """An OBJ whose library has so many materials."""
    triangle = b"mtllib a.mtl\nusemtl m0\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    return {"a.obj": triangle, "a.mtl": b"".join(b"newmtl m%d\n" % number for number in range(materials))}


def long_line() -> bytes:
    """A list of points whose second one has four million coordinates."""
    return b"1 2 3\n" + b"0.1 " * 4_000_000


def laz(count: int = 600) -> bytes:
    """An honest LAZ of random points."""
    made = laspy.create(point_format=0)
    made.xyz = np.random.default_rng(0).random((count, 3))
    buffer = io.BytesIO()
    made.write(buffer, do_compress=True)
    return buffer.getvalue()
