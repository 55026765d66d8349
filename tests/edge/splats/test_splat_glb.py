"""Splats as glTF: what KHR_gaussian_splatting asks for is there, in the units that it asks for."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.splats.splat_glb import to_splat_glb
from capture2vr.edge.splats.surface_splats import cover_with_splats
from tests.referees.glb_reader import Glb
from tests.support.downloadable import coloured

NAME = "KHR_gaussian_splatting"


def test_splats_are_points_with_the_extensions_attributes() -> None:
    splats = cover_with_splats(coloured(), 500)
    glb = Glb.of(to_splat_glb(splats))
    assert glb.document["extensionsUsed"] == [NAME]
    assert "extensionsRequired" not in glb.document, "others show points"
    assert glb.primitive["mode"] == 0
    assert glb.primitive["extensions"] == {NAME: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}}
    np.testing.assert_array_equal(glb.positions, splats.xyz)
    np.testing.assert_array_equal(glb.attribute(f"{NAME}:ROTATION"), splats.rotation)
    np.testing.assert_array_equal(glb.attribute(f"{NAME}:SCALE"), splats.scale)
    np.testing.assert_array_equal(glb.attribute(f"{NAME}:OPACITY"), splats.opacity)
    shown = glb.attribute(f"{NAME}:SH_DEGREE_0_COEF_0") * 0.28209479177387814 + 0.5
    np.testing.assert_allclose(shown * 255, splats.rgb, atol=1e-3)
    low = glb.document["accessors"][glb.primitive["attributes"]["POSITION"]]["min"]
    np.testing.assert_allclose(low, splats.xyz.min(axis=0))
