"""Colours of E57 scans have the range that the file names, of bytes, of more bits, or of floats."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.read_capture import read_capture
from tests.support.captures import e57_scan, save_e57

e57 = pytest.importorskip("pye57").e57
CHANNELS = ("colorRed", "colorGreen", "colorBlue")
XYZ = np.random.default_rng(0).normal(size=(400, 3))


def writing(monkeypatch: pytest.MonkeyPatch, top: float) -> None:
    """Make pye57, which writes bytes alone, write colours of 0 to `top`."""
    real = e57.libe57

    def number(image: Any, *values: Any) -> Any:
        if values not in ((255,), (0, 0, 255)):
            return real.IntegerNode(image, *values)
        if isinstance(top, int):
            return real.IntegerNode(image, *(top if each == 255 else each for each in values))
        single = (0.0, real.E57_SINGLE, 0.0, top)
        return real.FloatNode(image, *(single if len(values) == 3 else (top,)))

    names = {name: getattr(real, name) for name in dir(real)}
    monkeypatch.setattr(e57, "libe57", SimpleNamespace(**{**names, "IntegerNode": number}))
    kind = "H" if isinstance(top, int) else "f"
    monkeypatch.setattr(e57, "SUPPORTED_POINT_FIELDS", {**e57.SUPPORTED_POINT_FIELDS, **dict.fromkeys(CHANNELS, kind)})


@pytest.mark.parametrize("top", [255, 1023, 65_535, 1.0])
def test_colours_have_the_range_that_the_file_names(
    top: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dark scan of 16 bits uses a part of them, and stays dark."""
    shares = np.tile([0.4, 0.2, 0.1], (len(XYZ), 1))
    stored = shares * top if isinstance(top, float) else np.rint(shares * top).astype(np.uint16)
    with monkeypatch.context() as patched:
        writing(patched, top)
        save_e57(tmp_path / "a.e57", [e57_scan(XYZ, stored)])
    cloud = read_capture(tmp_path / "a.e57").cloud
    assert cloud is not None
    assert cloud.rgb is not None
    np.testing.assert_allclose(cloud.rgb.mean(axis=0), [102, 51, 25.5], atol=1)
