"""Colours of E57 scans have the range that the file names, of bytes, of more bits, or of floats; where a scan is."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.clouds.e57 import e57_metadata
from capture2vr.edge.read_capture import read_capture
from tests.support.captures import e57_scan, save_e57
from tests.support.odd.clouds import colours_up_to

pytest.importorskip("pye57")
XYZ = np.random.default_rng(0).normal(size=(400, 3))


@pytest.mark.parametrize("top", [255, 1023, 65_535, 1.0])
def test_colours_have_the_range_that_the_file_names(top: float, tmp_path: Path) -> None:
    """A dark scan of 16 bits uses a part of them, and stays dark."""
    shares = np.tile([0.4, 0.2, 0.1], (len(XYZ), 1))
    stored = shares * top if isinstance(top, float) else np.rint(shares * top).astype(np.uint16)
    with colours_up_to(top):
        save_e57(tmp_path / "a.e57", [e57_scan(XYZ, stored)])
    cloud = read_capture(tmp_path / "a.e57").cloud
    assert cloud is not None
    assert cloud.rgb is not None
    np.testing.assert_allclose(cloud.rgb.mean(axis=0), [102, 51, 25.5], atol=1)


@pytest.mark.parametrize("coloured", [False, True])
def test_intensities_are_grey_where_no_scan_has_colours(coloured: bool, tmp_path: Path) -> None:
    scans = [e57_scan(XYZ), e57_scan(XYZ + 1, np.full((len(XYZ), 3), 9, np.uint8) if coloured else None)]
    for scan in scans:
        scan["intensity"] = np.linspace(-2048, 2047, len(XYZ))
    save_e57(tmp_path / "a.e57", scans)
    capture = read_capture(tmp_path / "a.e57")
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    first, second = np.split(capture.cloud.rgb, 2)
    assert ("as shades of grey" in " ".join(capture.warnings)) != coloured
    if coloured:
        assert (first == 128).all()
        assert (second == 9).all()
    else:
        np.testing.assert_allclose(first, np.linspace([0] * 3, [260] * 3, len(XYZ)).clip(0, 255), atol=2)
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    "written",
    ['<![CDATA[PROJCS["a]b",UNIT["m",1]]]]>', " PROJCS[&quot;a]b&quot;,UNIT[&quot;m&quot;,1]]", "", "<![CDATA[]]>"],
)
def test_the_coordinate_system_of_an_e57(written: str, tmp_path: Path) -> None:
    xml = f'<e57Root><coordinateMetadata type="String">{written}</coordinateMetadata></e57Root>'.encode()
    xml = xml.replace(b"<e57Root>", b"<e57Root>" + b" " * 900)  # over the end of a page
    payload = struct.pack("<8s2I4Q", b"ASTM-E57", 1, 0, 2048, 48, len(xml), 1024) + xml
    pages = [payload[at : at + 1020].ljust(1020) + b"\0\0\0\0" for at in (0, 1020)]
    (tmp_path / "scan.e57").write_bytes(b"".join(pages))
    found = e57_metadata(tmp_path / "scan.e57", "scan.e57")
    assert found == ('PROJCS["a]b",UNIT["m",1]]' if "PROJCS" in written else "")
