"""Gaussian splats as programs pack them, written here by their descriptions: their centres and colours are known."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

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
    harmonic = (RGB / 255 - 0.5) / HARMONIC
    colours = np.rint((harmonic * 0.15 + 0.5) * 255).clip(0, 255).astype(np.uint8).tobytes()
    others = {2: 3 + 3, 3: 3 + 4}[version] + 3 * (0, 3, 8, 15)[degree]
    head = struct.pack("<IIIBBBB", 0x5053474E, version, COUNT, degree, bits, 0, 0)
    return head + places + OPACITY.astype(np.uint8).tobytes() + colours + bytes(others * COUNT)


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


@pytest.mark.parametrize(("version", "degree"), [(2, 0), (2, 3), (3, 0), (3, 1), (3, 2)])
def test_an_spz_is_behind_gzip(tmp_path: Path, version: int, degree: int) -> None:
    assert_centres(read(tmp_path / "garden.spz", gzip.compress(spz(version, degree))), "spz", 2**-12, 2.5)


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
