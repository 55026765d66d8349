"""Colours of clouds as writers store them: of any range, with single values beyond it, never filled, or intensities."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from capture2vr.edge.clouds.colours import read_colours, rgb8
from capture2vr.edge.read_capture import read_capture
from tests.edge.clouds.test_tables import RGB, XYZ
from tests.support import captures
from tests.support.odd.tables import OddTable


@pytest.mark.parametrize(("factor", "kind"), [(1 / 255, float), (1, np.float32), (257, np.uint16), (1, np.uint16)])
def test_a_single_value_beyond_the_range_does_not_decide_it(factor: float, kind: type) -> None:
    stored = (RGB * factor).astype(kind)
    beyond = stored.copy()
    beyond[17] = beyond[17] * 1.2 + 1e-3 if stored.max() <= 1 else np.minimum(1.5 * stored.max(), 65_535)
    others = np.arange(len(RGB)) != 17
    np.testing.assert_array_equal(rgb8(beyond)[others], RGB[others])


def test_colours_that_were_never_filled_are_none() -> None:
    for kind in (np.uint8, np.uint16, np.float64):
        rgb, notes = read_colours(np.zeros((500, 3), kind))
        assert rgb is None
        assert "never filled" in notes[0]
    nearly = np.zeros((500, 3), np.uint8)
    nearly[499, 1] = 1
    assert read_colours(nearly)[0] is not None


@pytest.mark.parametrize("point_format", [3, 1])
def test_a_las_without_colours_has_its_intensities_as_grey(point_format: int, tmp_path: Path) -> None:
    las = laspy.create(point_format=point_format, file_version="1.2")
    las.x, las.y, las.z = XYZ.T
    las.intensity = 40 * RGB[:, 0]  # a range of the scanner's own
    las.write(tmp_path / "scan.las")
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    expected = np.clip(RGB[:, :1] * (255 / np.quantile(RGB[:, 0], 0.98)), 0, 255)
    np.testing.assert_allclose(capture.cloud.rgb, np.repeat(expected, 3, axis=1), atol=1)
    assert "intensities, as shades of grey" in " ".join(capture.warnings)


def test_a_named_intensity_is_grey_where_there_are_no_colours(tmp_path: Path) -> None:
    text = OddTable(header=("x", "y", "z", "Intensity"), separator=";", coloured=False, nothing="1;1;1")
    rows = text.written(np.column_stack([XYZ, RGB[:, 0]]), RGB)
    (tmp_path / "a.csv").write_bytes(rows)
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    assert "intensities" in " ".join(capture.warnings)
    (tmp_path / "a.csv").write_bytes(
        OddTable(header=("i", "x", "y", "z"), coloured=False, nothing="1 1 1", separator=";").written(
            np.column_stack([np.arange(400), XYZ]), RGB
        )
    )
    counted = read_capture(tmp_path).cloud
    assert counted is not None
    assert counted.rgb is None
    (tmp_path / "a.csv").unlink()
    (tmp_path / "a.ply").write_bytes(captures.ply_bytes(XYZ, np.zeros_like(RGB, np.uint8)))
    never = read_capture(tmp_path)
    assert never.cloud is not None
    assert never.cloud.rgb is None
    assert "never filled" in " ".join(never.warnings)
