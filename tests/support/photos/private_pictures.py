"""Pictures and films with everything in them that must not be kept."""

from __future__ import annotations

import io
import struct
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pillow_heif
from PIL import Image
from PIL.PngImagePlugin import PngInfo

PLACE = b"48.137154"  # stands in every block of metadata; must be nowhere afterwards
SERIAL = b"SN-0123456789"
OWNER = b"Jane Roe"

ORIENTATION, FOCAL_LENGTH, FOCAL_35MM, EXIF_IFD, GPS_IFD = 0x0112, 0x920A, 0xA405, 0x8769, 0x8825
XMP = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><exif:GPSLatitude>' + PLACE + b"</exif:GPSLatitude></x:xmpmeta>"


def picture(width: int = 64, height: int = 48, mode: str = "RGB") -> Image.Image:
    """A gradient with some texture, so that encoders have something to do."""
    image = Image.new("RGB", (width, height))
    image.putdata([(x * 4 % 256, y * 5 % 256, (x * y) % 256) for y in range(height) for x in range(width)])
    return image.convert(mode)


def telling_exif() -> Image.Exif:
    """What a phone writes, and more."""
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[ORIENTATION], exif[0x0131] = "Phone Maker", "Phone 9", 6, "OS 9.1"
    exif[0x013B] = OWNER.decode()
    camera = exif.get_ifd(EXIF_IFD)
    camera[FOCAL_LENGTH], camera[FOCAL_35MM], camera[0x829D] = 5.7, 26, 1.8
    camera[0x927C] = b"MAKER" + SERIAL + PLACE
    camera[0xA430], camera[0xA431], camera[0xA435] = OWNER.decode(), SERIAL.decode(), SERIAL.decode()
    place = exif.get_ifd(GPS_IFD)
    place[1], place[2], place[3], place[4] = "N", (48.0, 8.0, 13.75), "E", (11.0, 34.0, 34.5)
    place[27] = PLACE
    return exif


def jpeg(image: Image.Image | None = None, **options: Any) -> bytes:
    """With Exif, XMP, Photoshop and a comment, and a film behind the picture."""
    buffer = io.BytesIO()
    (image or picture()).save(buffer, "JPEG", exif=telling_exif(), comment=PLACE, quality=90, **options)
    data = buffer.getvalue()
    extra = segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + XMP) + segment(0xED, b"Photoshop 3.0\0" + PLACE)
    return data[:2] + extra + data[2:] + b"\0\0\0\x18ftypmp42" + PLACE


def segment(marker: int, content: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(content) + 2) + content


def png(image: Image.Image | None = None) -> bytes:
    text = PngInfo()
    text.add_text("GPS", PLACE.decode())
    text.add_text("Author", OWNER.decode(), zip=True)
    text.add_itxt("XML:com.adobe.xmp", XMP.decode())
    buffer = io.BytesIO()
    (image or picture()).save(buffer, "PNG", pnginfo=text, exif=telling_exif())
    return buffer.getvalue() + PLACE


def heic(image: Image.Image | None = None) -> bytes:
    pillow_heif.register_heif_opener()
    buffer = io.BytesIO()
    (image or picture()).save(buffer, "HEIF", exif=telling_exif().tobytes(), xmp=XMP)
    return buffer.getvalue()


def add_to_heic_index(data: bytes, path: tuple[bytes, ...], added: bytes) -> bytes:
    """A HEIC of `heic` with one more box at the end of the index, or of the box at a path in it."""
    index = bytearray(data)
    parents, start, end = [], 0, len(index)
    for kind in (b"meta", *path):
        while index[start + 4 : start + 8] != kind:
            start += int.from_bytes(index[start : start + 4], "big")
        parents.append(start)
        end = start + int.from_bytes(index[start : start + 4], "big")
        start += 12 if kind == b"meta" else 8
    index[end:end] = added
    for at in parents:
        struct.pack_into(">I", index, at, int.from_bytes(index[at : at + 4], "big") + len(added))
    at = index.index(b"iloc") + 12
    (items,) = struct.unpack_from(">H", index, at - 2)
    for item in range(at, at + 18 * items, 18):  # number, file, place; pieces, offset and length of the one piece
        (place,) = struct.unpack_from(">I", index, item + 4)
        struct.pack_into(">I", index, item + 4, place + len(added))
    return bytes(index)


def webp(image: Image.Image | None = None) -> bytes:
    buffer = io.BytesIO()
    (image or picture()).save(buffer, "WEBP", exif=telling_exif(), xmp=XMP, lossless=True)
    return buffer.getvalue()


def tiff(image: Image.Image | None = None) -> bytes:
    buffer = io.BytesIO()
    (image or picture()).save(buffer, "TIFF", exif=telling_exif(), tiffinfo={0x02BC: XMP, 0x010E: PLACE.decode()})
    return buffer.getvalue()


def box(kind: bytes, *content: bytes) -> bytes:
    """A box of the ISO base media file format."""
    body = b"".join(content)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def handler(kind: bytes) -> bytes:
    return box(b"mdia", box(b"hdlr", bytes(8), kind, bytes(12)))


def film() -> bytes:
    """Boxes of a phone's film: a picture track, a track of places, user data and QuickTime metadata."""
    frames, places = b"FRAMES" * 10, (PLACE + b",") * 4
    start = box(b"ftyp", b"qt  ", bytes(4))
    first = len(start) + 8
    size = len(PLACE) + 1
    table = box(
        b"stbl",
        box(b"stsc", bytes(4), struct.pack(">I3I3I", 2, 1, 1, 1, 2, 3, 1)),  # one sample in the first chunk, then three
        box(b"stsz", bytes(4), struct.pack(">II", size, 4)),
        box(b"stco", bytes(4), struct.pack(">I2I", 2, first + len(frames), first + len(frames) + size)),
    )
    place_track = box(
        b"trak", box(b"tkhd", bytes(20)), box(b"mdia", box(b"hdlr", bytes(8), b"meta", bytes(12)), box(b"minf", table))
    )
    keys = box(b"keys", bytes(4), struct.pack(">I", 1), box(b"mdta", b"com.apple.quicktime.location.ISO6709"))
    moov = box(
        b"moov",
        box(b"mvhd", bytes(100)),
        box(b"trak", box(b"tkhd", b"ROTATION"), handler(b"vide"), box(b"udta", box(b"name", OWNER))),
        place_track,
        box(b"udta", box(b"\xa9xyz", PLACE), box(b"\xa9mod", b"Phone 9")),
        box(b"meta", keys, box(b"ilst", PLACE)),
    )
    return start + box(b"mdat", frames, places) + moov + box(b"uuid", PLACE) + box(b"free", PLACE)


def element(kind: int, *content: bytes, size: bytes = b"") -> bytes:
    """An element of EBML; `size` as it is written, where it is to be another than the content's."""
    body = b"".join(content)
    identity = kind.to_bytes((kind.bit_length() + 7) // 8, "big")
    return identity + (size or (1 << 56 | len(body)).to_bytes(8, "big")) + body


OPEN = b"\x01" + b"\xff" * 7  # the size of an element that was written before its end was known
EBML = element(0x1A45DFA3, element(0x4282, b"webm"))


def webm(open_ended: bool = False) -> bytes:
    """A film in Matroska's boxes: pictures, a track of places as subtitles, tags, and a block of each kind."""
    size = OPEN if open_ended else b""
    info = element(0x1549A966, element(0xBF, b"CRC4"), element(0x2AD7B1, b"\x0f\x42\x40"), element(0x7BA9, OWNER))
    pictures = element(0xAE, element(0xD7, b"\1"), element(0x83, b"\1"), element(0x536E, OWNER))
    places = element(0xAE, element(0xD7, b"\2"), element(0x83, b"\x11"), element(0x536E, b"GPS"))
    cluster = element(
        0x1F43B675,
        element(0xE7, b"\0"),
        element(0xA3, b"\x81\0\0\x80", b"FRAMES" * 10),
        element(0xA3, b"\x82\0\0\x80", PLACE),
        element(0xA0, element(0xA1, b"\x81\0\0\0", b"FRAMES" * 10), element(0x75A1, SERIAL)),
        element(0xA0, element(0xA1, b"\x82\0\0\0", PLACE), element(0x9B, b"\1")),
        size=size,
    )
    tags = element(0x1254C367, element(0x7373, element(0x67C8, element(0x45A3, b"LOCATION"), element(0x4487, PLACE))))
    attached = element(0x1941A469, element(0x61A7, SERIAL))
    tracks = element(0x1654AE6B, pictures, places)
    return EBML + element(
        0x18538067,
        info,
        tracks,
        cluster,
        cluster,
        element(0xEC, PLACE),
        tags,
        attached,
        element(0xA5, OWNER),
        size=size,
    )


def exr(width: int = 4, height: int = 2) -> bytes:
    """The header of an OpenEXR picture."""

    def attribute(name: bytes, kind: bytes, value: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value

    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = attribute(b"dataWindow", b"box2i", window) + attribute(b"owner", b"string", OWNER)
    return b"v/1\x01\x02\0\0\0" + attributes + attribute(b"latitude", b"float", b"\x01\x02\x03\x04") + b"\0" + b"PIXELS"


def huge_png(width: int, height: int) -> bytes:
    """A PNG that claims these sides and has no pixels."""
    import zlib

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@cache  # the standard asks for identifiers, which are drawn at random
def e57() -> bytes:
    """A scan whose name, description, sensor and photo tell everything, as laser scanners write them."""
    import pye57
    from pye57 import libe57

    with TemporaryDirectory() as folder:
        path = Path(folder) / "scan.e57"
        with pye57.E57(str(path), mode="w") as writer:
            xyz = np.random.default_rng(0).normal(size=(300, 3))
            columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), xyz.T, strict=True))
            writer.write_scan_raw(columns, name=f"{OWNER.decode()}, {PLACE.decode()}")
            file, photo = writer.image_file, jpeg()
            writer.data3d[0].set("sensorSerialNumber", libe57.StringNode(file, SERIAL.decode()))
            blob = libe57.BlobNode(file, len(photo))
            picture = libe57.StructureNode(file)
            visual = libe57.StructureNode(file)
            writer.root["images2D"].append(picture)
            picture.set("visualReferenceRepresentation", visual)
            visual.set("jpegImage", blob)
            blob.write(bytearray(photo), 0, len(photo))
        return path.read_bytes()
