"""Gaussian splats as programs pack them, written here by their descriptions: their centres and colours are known."""

from __future__ import annotations

import gzip
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.splats.spz import to_spz
from capture2vr.edge.splats.surface_splats import Splats
from tests.support.clouds import sphere_points

COUNT = 600
XYZ = sphere_points(COUNT) * [1.0, 2.0, 3.0] + [5.0, -4.0, 0.5]
RGB = np.random.default_rng(1).integers(0, 256, (COUNT, 3))
OPACITY = np.where(np.arange(COUNT) % 4, 200, 10)  # of 255: every fourth is haze
SEEN = OPACITY > 100
HARMONIC = 0.28209479177387814


def read(path: Path, data: bytes) -> Capture:
    path.write_bytes(data)
    return read_capture(path)


def assert_centres(capture: Capture, kind: str, off: float, tint: float = 1.5) -> None:
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    assert (capture.format, capture.scale_confidence) == (kind, "unknown")
    assert np.abs(capture.cloud.xyz - XYZ[SEEN]).max() < off
    assert np.abs(capture.cloud.rgb.astype(float) - RGB[SEEN]).max() <= tint
    (warning,) = capture.warnings
    assert "Gaussian splats" in warning


def splat() -> bytes:
    rows = (
        struct.pack("<6f8B", *place, 0.1, 0.2, 0.3, *colour, opacity, 255, 128, 128, 128)
        for place, colour, opacity in zip(XYZ, RGB, OPACITY, strict=True)
    )
    return b"".join(rows)


def spz(version: int, degree: int = 0, bits: int = 12) -> bytes:
    places = b"".join(round(float(v) * 2**bits).to_bytes(3, "little", signed=True) for v in XYZ.reshape(-1))
    places = XYZ.astype("<f2").tobytes() if version == 1 else places
    harmonic = (RGB / 255 - 0.5) / HARMONIC
    colours = np.rint((harmonic * 0.15 + 0.5) * 255).clip(0, 255).astype(np.uint8).tobytes()
    others = {1: 3 + 3, 2: 3 + 3, 3: 3 + 4}[version] + 3 * (0, 3, 8, 15, 24)[degree]
    head = struct.pack("<IIIBBBB", 0x5053474E, version, COUNT, degree, bits, 0, 0)
    return head + places + OPACITY.astype(np.uint8).tobytes() + colours + bytes(others * COUNT)


def spz4(*, extension: bytes = b"") -> bytes:
    """Of version 4: a list of sizes, behind records of other programs, and streams that Zstandard has packed."""
    plain = spz(3)[16:]
    ends = np.cumsum([9 * COUNT, COUNT, 3 * COUNT, 3 * COUNT, 4 * COUNT]).tolist()
    streams = [plain[start:end] for start, end in zip([0, *ends], ends, strict=False)]
    packed = [zstd(stream) for stream in streams]
    head = struct.pack("<IIIBBBBI", 0x5053474E, 4, COUNT, 0, 12, 2 * bool(extension), len(streams), 32 + len(extension))
    sizes = b"".join(struct.pack("<QQ", len(few), len(many)) for few, many in zip(packed, streams, strict=True))
    return head + bytes(12) + extension + sizes + b"".join(packed)


def zstd(data: bytes) -> bytes:
    """A frame of Zstandard (RFC 8878) with one block, which is stored as it is."""
    return struct.pack("<IBI", 0xFD2FB528, 0b1010_0000, len(data)) + (len(data) << 3 | 1).to_bytes(3, "little") + data


def ksplat(packing: int, degree: int = 0, *, sections: int = 2) -> bytes:
    """As GaussianSplats3D packs it: buckets of 256 splats, and behind them one that is not full."""
    heads, bodies = [], []
    for rows in np.array_split(np.arange(COUNT), sections):
        xyz, full = XYZ[rows], len(rows) // 256
        buckets = [xyz[start : start + 256] for start in range(0, len(rows), 256)] if packing else []
        middles = np.array([(bucket.min(axis=0) + bucket.max(axis=0)) / 2 for bucket in buckets], "<f4").reshape(-1, 3)
        body = struct.pack("<I", len(rows) % 256) + middles.tobytes() if packing else b""
        for number, (place, rgb, opacity) in enumerate(zip(xyz, RGB[rows], OPACITY[rows], strict=True)):
            steps = np.rint((place - middles[number // 256]) / 4 * 32_767) + 32_767 if packing else place
            body += steps.astype("<u2" if packing else "<f4").tobytes() + bytes(14 if packing else 28)
            body += bytes([*rgb.tolist(), opacity]) + bytes((4, 2, 1)[packing] * (0, 9, 24)[degree])
        numbers = (256, len(buckets), 8.0, 12, 32_767) if packing else (0, 0, 0.0, 0, 0)
        head = struct.pack("<IIIIfHxxI", len(rows), len(rows), *numbers)
        heads.append((head + struct.pack("<IIIH", len(body), full, int(packing > 0), degree)).ljust(1024, b"\0"))
        bodies.append(body)
    head = struct.pack("<BBxxIIIIH", 0, 1, sections, sections, COUNT, COUNT, packing).ljust(4096, b"\0")
    return b"".join([head, *heads, *bodies])


def changed(data: bytes, at: int, number: int) -> bytes:
    """With another number of 32 bits."""
    return data[:at] + struct.pack("<I", number) + data[at + 4 :]


def logit(share: np.ndarray | float) -> np.ndarray:
    return np.log(np.asarray(share) / (1 - np.asarray(share)))


def write_sog(folder: Path, version: int = 2, **changes: object) -> None:
    """PlayCanvas' pictures of splats, 40 wide."""

    def picture(name: str, channels: np.ndarray) -> str:
        pixels = np.rint(channels).astype(np.uint8).reshape(-1, 40, channels.shape[1])
        Image.fromarray(pixels).save(folder / name, lossless=True, exact=True)
        return name

    logs = np.sign(XYZ) * np.log1p(np.abs(XYZ))
    low, high = logs.min(axis=0), logs.max(axis=0)
    steps = np.rint((logs - low) / (high - low) * 65_535)
    first, last = (float(logit(share)) for share in (0.01, 0.99))
    if version == 1:
        tints = {"mins": [*(-0.5 / HARMONIC,) * 3, first], "maxs": [*(0.5 / HARMONIC,) * 3, last]}
        opacity = (logit(OPACITY / 255) - first) / (last - first) * 255
    else:
        tints, opacity = {"codebook": ((np.arange(256) / 255 - 0.5) / HARMONIC).tolist()}, OPACITY
    means = {"mins": low.tolist(), "maxs": high.tolist(), "shape": [COUNT, 3]}
    places = [picture("means_l.webp", steps % 256), picture("means_u.webp", steps // 256)]
    colours = [picture("sh0.webp", np.c_[RGB, opacity])]
    meta = {"means": {**means, "files": places}, "sh0": {**tints, "files": colours}}
    head = {"version": 2, "count": COUNT} if version == 2 else {}
    (folder / "meta.json").write_text(json.dumps({**head, **meta, **changes}))


def packed_ply(*, tinted: bool, count: int = COUNT) -> bytes:
    """A PLY as SuperSplat packs it: boxes of 256 splats; from its second version on also of their colours."""
    boxes, rows = [], []
    for start in range(0, COUNT, 256):
        some, tints = XYZ[start : start + 256], RGB[start : start + 256] / 255
        low, high, dark, light = some.min(0), some.max(0), tints.min(0), tints.max(0)
        boxes.append([*low, *high, *(-5.0,) * 3, *(1.0,) * 3, *((*dark, *light) if tinted else ())])
        for place, tint, opacity in zip(some, tints, OPACITY[start : start + 256], strict=True):
            x, y, z = (int(v) for v in np.rint((place - low) / (high - low) * [2047, 1023, 2047]))
            r, g, b = (int(v) for v in np.rint(((tint - dark) / (light - dark) if tinted else tint) * 255))
            rows.append((x << 21 | y << 11 | z, 0, 0, r << 24 | g << 16 | b << 8 | int(opacity)))
    names = [f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"] if tinted else []
    header = ["ply", "format binary_little_endian 1.0", f"element chunk {len(boxes)}"]
    header += [f"property float {name}" for name in names] + [f"element vertex {count}"]
    header += [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")] + ["end_header\n"]
    return "\n".join(header).encode() + np.array(boxes, "<f4").tobytes() + np.array(rows, "<u4").tobytes()


def test_a_splat_has_a_record_of_32_bytes_for_each(tmp_path: Path) -> None:
    assert_centres(read(tmp_path / "garden.splat", splat()), "splat", 1e-6, 0)


@pytest.mark.parametrize(("version", "degree"), [(1, 0), (2, 0), (2, 3), (3, 0), (3, 1), (3, 2), (3, 4)])
def test_an_spz_is_behind_gzip(tmp_path: Path, version: int, degree: int) -> None:
    off = 2**-9 if version == 1 else 2**-12  # halves below 8 have steps of 2^-8
    assert_centres(read(tmp_path / "garden.spz", gzip.compress(spz(version, degree))), "spz", off, 2.5)


@pytest.mark.parametrize("extension", [b"", struct.pack("<II", 0xADBE0002, 4) + bytes(4)])
def test_an_spz_of_version_4_has_packed_streams(tmp_path: Path, extension: bytes) -> None:
    assert_centres(read(tmp_path / "garden.spz", spz4(extension=extension)), "spz", 2**-12, 2.5)


@pytest.mark.parametrize(("packing", "degree"), [(0, 0), (0, 1), (1, 0), (1, 2), (2, 1)])
@pytest.mark.parametrize("sections", [1, 2])
def test_a_ksplat_has_sections_of_buckets(tmp_path: Path, packing: int, degree: int, sections: int) -> None:
    capture = read(tmp_path / "garden.ksplat", ksplat(packing, degree, sections=sections))
    assert_centres(capture, "ksplat", 4 / 32_767 if packing else 1e-6, 0)


@pytest.mark.parametrize("version", [1, 2])
def test_a_sog_has_pictures_of_splats(tmp_path: Path, version: int) -> None:
    write_sog(tmp_path, version)
    assert_centres(read_capture(tmp_path), "sog", 1e-3, 1)


@pytest.mark.parametrize(
    ("changes", "code", "file"),
    [
        ({"count": COUNT + 1}, "CAPTURE_UNREADABLE", "means_l.webp"),
        ({"count": 10**12}, "CAPTURE_TOO_LARGE", "meta.json"),
        ({"count": "many"}, "CAPTURE_UNREADABLE", "meta.json"),
        ({"sh0": {"codebook": [0.0], "files": ["sh0.webp"]}}, "CAPTURE_UNREADABLE", "meta.json"),
        ({"sh0": {"codebook": [[0.0, 1.0]] * 256, "files": ["sh0.webp"]}}, "CAPTURE_UNREADABLE", "meta.json"),
        ({"sh0": {"codebook": [0.0], "files": ["../sh0.webp"]}}, "CAPTURE_UNREADABLE", "meta.json"),
    ],
)
def test_a_broken_sog_is_refused(changes: dict[str, object], code: str, file: str, tmp_path: Path) -> None:
    write_sog(tmp_path, **changes)
    with pytest.raises(CaptureError) as caught:
        read_capture(tmp_path)
    assert (caught.value.code, caught.value.file) == (code, file)


def test_splats_in_levels_are_refused_by_name(tmp_path: Path) -> None:
    write_sog(tmp_path)
    (tmp_path / "lod-meta.json").write_text("{}")
    with pytest.raises(CaptureError, match="levels of detail"):
        read_capture(tmp_path)


def test_an_spz_is_read_once_its_gzip_is_undone(tmp_path: Path) -> None:
    assert_centres(read(tmp_path / "garden.spz", spz(3)), "spz", 2**-12, 2.5)


def test_an_spz_of_ours_comes_back(tmp_path: Path) -> None:
    turns, widths = np.tile(np.float32([0, 0, 0, 1]), (COUNT, 1)), np.full((COUNT, 3), 0.01, np.float32)
    ours = Splats(XYZ.astype(np.float32), turns, widths, (OPACITY / 255).astype(np.float32), RGB.astype(np.uint8))
    assert_centres(read(tmp_path / "ours.spz", to_spz(ours)), "spz", 1e-4, 2.5)


@pytest.mark.parametrize("tinted", [False, True])
def test_supersplats_ply_has_boxes_of_256(tmp_path: Path, tinted: bool) -> None:
    # A box is up to 6 wide, of which 11 bits tell a 2047th, and 10 a 1023rd.
    assert_centres(read(tmp_path / "garden.ply", packed_ply(tinted=tinted)), "ply", 6 / 2047)


def test_supersplats_ply_is_read_behind_gzip_too(tmp_path: Path) -> None:
    assert_centres(read(tmp_path / "garden.ply.gz", gzip.compress(packed_ply(tinted=True))), "ply", 6 / 2047)


BROKEN = {
    "a .splat cut off": ("a.splat", splat()[:-5], "CAPTURE_TRUNCATED"),
    "a .splat of noise": ("a.splat", b"\x01\xc0\x7f\xff" * 800, "CAPTURE_UNREADABLE"),
    "an .spz cut off": ("a.spz", gzip.compress(spz(3)[:-5]), "CAPTURE_TRUNCATED"),
    "an .spz whose gzip is cut off": ("a.spz", gzip.compress(spz(3))[:-50], "ARCHIVE_BROKEN"),
    "an .spz cut off in its header": ("a.spz", spz(3)[:10], "CAPTURE_TRUNCATED"),
    "an .spz of version 9": ("a.spz", b"NGSP" + struct.pack("<I", 9) + spz(3)[8:], "CAPTURE_UNREADABLE"),
    "an .spz of 4 billion": ("a.spz", spz(3)[:8] + b"\xff" * 4 + spz(3)[12:], "CAPTURE_TOO_LARGE"),
    "an .spz of 10 million": ("a.spz", spz(3)[:8] + struct.pack("<I", 10**7) + spz(3)[12:], "CAPTURE_TRUNCATED"),
    "an .spz of version 4 cut off": ("a.spz", spz4()[:-5], "CAPTURE_TRUNCATED"),
    "an .spz of version 4 cut off in its list": ("a.spz", spz4()[:50], "CAPTURE_UNREADABLE"),
    "an .spz of version 4 of 10 million": ("a.spz", changed(spz4(), 8, 10**7), "CAPTURE_TRUNCATED"),
    "an .spz of version 4 of other sizes": ("a.spz", changed(spz4(), 8, COUNT - 1), "CAPTURE_UNREADABLE"),
    "an .spz of version 4 of noise": ("a.spz", spz4()[:120] + bytes(len(spz4()) - 120), "CAPTURE_UNREADABLE"),
    "a .ksplat cut off": ("a.ksplat", ksplat(1)[:-5], "CAPTURE_TRUNCATED"),
    "a .ksplat cut off in its header": ("a.ksplat", ksplat(1)[:99], "CAPTURE_TRUNCATED"),
    "a .ksplat without sections": ("a.ksplat", ksplat(1)[:4096], "CAPTURE_TRUNCATED"),
    "a .ksplat of another version": ("a.ksplat", changed(ksplat(1), 0, 1), "CAPTURE_UNREADABLE"),
    "a .ksplat of 4 billion": ("a.ksplat", changed(ksplat(1), 4100, 2**32 - 1), "CAPTURE_TOO_LARGE"),
    "a .ksplat of many buckets": ("a.ksplat", changed(ksplat(1), 4108, 2**32 - 1), "CAPTURE_TRUNCATED"),
    "a .ksplat of many full buckets": ("a.ksplat", changed(ksplat(1), 4128, 2**32 - 1), "CAPTURE_TRUNCATED"),
    "a .ksplat of small buckets": ("a.ksplat", changed(ksplat(1), 4104, 1), "CAPTURE_TRUNCATED"),
    "a packed PLY cut off": ("a.ply", packed_ply(tinted=True)[:-5], "CAPTURE_TRUNCATED"),
    "a packed PLY of 10 million": ("a.ply", packed_ply(tinted=True, count=10**7), "CAPTURE_TRUNCATED"),
    "a packed PLY of fewer boxes": (
        "a.ply",
        packed_ply(tinted=False).replace(b"chunk 3", b"chunk 1"),
        "CAPTURE_TRUNCATED",
    ),
    "a packed PLY without colours": (
        "a.ply",
        packed_ply(tinted=True).replace(b"packed_color", b"packed_other"),
        "CAPTURE_UNREADABLE",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_splats_are_refused_by_name(tmp_path: Path, case: str) -> None:
    name, data, code = BROKEN[case]
    with pytest.raises(CaptureError) as caught:
        read(tmp_path / name, data)
    assert (caught.value.code, caught.value.file) == (code, name)
    assert caught.value.hints
