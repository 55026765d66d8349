"""What was measured, proposed and filled is marked alike in every file: PLY, LAZ, GLB."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO

import laspy
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.asset.capture_files import capture_files
from capture2vr.edge.asset.origin_picture import pictures_of_origin
from capture2vr.edge.convert.capture_points import CapturePoints
from capture2vr.edge.convert.read_glb import read_glb
from capture2vr.edge.export.glb import Packing, to_glb
from capture2vr.edge.export.ply import ply_bytes, stored_origin
from capture2vr.edge.mesh.fill_gaps import FilledMesh, fill_gaps
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.mesh.topology import compact
from capture2vr.edge.origin import COLOURS, FILLED, MEASURED, PICTURE, PROPOSED, counts, nearest_origin, shares
from capture2vr.edge.points.downsample import downsample_points
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.texture.bake import jpeg_of
from capture2vr.order.download_formats import POINTS
from tests.referees.glb_reader import Glb


def patched_ball() -> tuple[FilledMesh, Floats]:
    """A ball with a patch over a hole at its top, whose lower half was proposed; and the ball before it was filled."""
    ball = trimesh.creation.icosphere(3)
    mesh = Mesh(np.asarray(ball.vertices), np.asarray(ball.faces, np.int64))
    kept = compact(mesh, np.flatnonzero(ball.triangles_center[:, 2] < 0.9))
    filled = fill_gaps(kept, "unseen", lambda places, normals: np.zeros(len(places), np.int64))
    origin = np.where(kept.vertices[:, 2] < 0, PROPOSED, MEASURED).astype(np.uint8)
    return filled.with_origin_of(kept.vertices, origin), kept.vertices


FILLED_BALL, KEPT = patched_ball()
ORIGIN = FILLED_BALL.vertex_origin
assert ORIGIN is not None
BALL = replace(FILLED_BALL.mesh, origin=ORIGIN)


def test_exactly_the_vertices_of_the_patch_are_filled() -> None:
    assert ORIGIN is not None
    assert np.array_equal(ORIGIN == FILLED, np.arange(len(BALL.vertices)) >= len(KEPT))
    assert (ORIGIN == FILLED).sum() > 10
    assert (BALL.vertices[ORIGIN == PROPOSED][:, 2] < 0.05).all()
    assert (BALL.vertices[ORIGIN == MEASURED][:, 2] > -0.15).all(), "the surest of its faces tells a vertex's"


def test_shares_of_the_surface_add_to_one() -> None:
    found = FILLED_BALL.shares
    assert sum(found.values()) == pytest.approx(1)
    assert found["proposed"] == pytest.approx(0.5, abs=0.05)
    assert found["filled"] == pytest.approx(0.05, abs=0.02), "a cap of a tenth of the height"


@given(arrays(np.uint8, 9, elements=st.integers(0, 2)), arrays(np.float64, 9, elements=st.floats(0, 1e6)))
def test_any_shares_add_to_one_and_counts_to_all(origin: Bytes, weight: Floats) -> None:
    assert sum(shares(origin, weight).values()) == pytest.approx(1)
    assert sum(counts(origin, 9).values()) == 9
    assert counts(None, 9) == {"measured": 9, "proposed": 0, "filled": 0}


def test_a_ply_has_the_origin_of_every_vertex_or_none_where_all_are_measured() -> None:
    read = trimesh.load(BytesIO(ply_bytes(BALL)), file_type="ply", process=False)
    assert list(read.metadata["_ply_raw"]["vertex"]["properties"]) == ["x", "y", "z", "origin"]
    np.testing.assert_array_equal(read.metadata["_ply_raw"]["vertex"]["data"]["origin"], ORIGIN)
    np.testing.assert_array_equal(stored_origin(read), ORIGIN)
    plain = trimesh.load(BytesIO(ply_bytes(replace(BALL, origin=None))), file_type="ply", process=False)
    assert stored_origin(plain) is None


@pytest.mark.parametrize("packing", ["float", "meshopt"])
@pytest.mark.parametrize("pictured", [False, True])
def test_a_glb_has_the_origin_at_every_vertex(packing: Packing, pictured: bool) -> None:
    """Packing changes the vertices' order, and a texture's seams double some: places tell which is which."""
    uv, jpeg = BALL.vertices[:, :2] * 0.4 + 0.5, jpeg_of(np.zeros((8, 8, 3), np.uint8), 80)
    data = to_glb(TexturedMesh(BALL, uv, jpeg, 8) if pictured else BALL, packing)
    glb = Glb.of(data)
    assert ORIGIN is not None
    np.testing.assert_array_equal(nearest_origin(BALL.vertices, ORIGIN, glb.positions), glb.attribute("_ORIGIN"))
    level = read_glb(data).mesh
    read = level.mesh if isinstance(level, TexturedMesh) else level
    np.testing.assert_array_equal(read.origin, glb.attribute("_ORIGIN"))


def test_a_glb_of_what_was_measured_has_no_origin() -> None:
    glb = Glb.of(to_glb(replace(BALL, origin=None), "meshopt"))
    assert "_ORIGIN" not in glb.primitive["attributes"]


def points(origin: Bytes | None) -> Points:
    sure = np.ones(len(BALL.vertices), np.float32)
    return Points(BALL.vertices, None, sure, 1.0, "metric", None, origin=origin)


def test_a_laz_has_the_origin_as_user_data_and_other_formats_keep_it() -> None:
    laz = capture_files(points(ORIGIN), np.eye(4))[POINTS]
    np.testing.assert_array_equal(laspy.read(BytesIO(laz)).user_data, ORIGIN)
    found = CapturePoints.read(laz)
    read = trimesh.load(BytesIO(found.at_most(100).ply()), file_type="ply", process=False)
    assert ORIGIN is not None
    step = -(-len(ORIGIN) // 100)
    np.testing.assert_array_equal(read.metadata["_ply_raw"]["vertex"]["data"]["origin"], ORIGIN[::step])
    assert CapturePoints.read(capture_files(points(None), np.eye(4))[POINTS]).origin is None


def test_fewer_points_have_the_origin_of_those_they_stand_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.edge.asset.capture_files.MOST_POINTS", 300)
    thinned = CapturePoints.read(capture_files(points(ORIGIN), np.eye(4))[POINTS])
    assert thinned.origin is not None
    assert len(thinned.origin) <= 300
    assert (thinned.origin[thinned.xyz[:, 1] > 0.3] == PROPOSED).all(), "with Z up, -z is y"
    fewer = downsample_points(points(ORIGIN), 300)
    assert fewer.origin is not None
    assert (fewer.origin[fewer.xyz[:, 2] < -0.3] == PROPOSED).all()


def test_what_a_surface_is_judged_by_is_measured_and_of_a_guess_all_of_it() -> None:
    mixed = points(ORIGIN)
    assert mixed.inferred is not None
    np.testing.assert_array_equal(mixed.given, ORIGIN == MEASURED)
    np.testing.assert_array_equal(mixed.inferred, ORIGIN != MEASURED)
    guess = points(np.full(len(BALL.vertices), PROPOSED, np.uint8))
    assert guess.given.all()
    assert guess.inferred is None
    assert points(None).given.all()


@pytest.mark.slow
def test_the_picture_shows_the_three_in_their_colours() -> None:
    (name,), (png,) = zip(*pictures_of_origin(BALL).items(), strict=True)
    assert name == PICTURE
    shown = np.asarray(Image.open(BytesIO(png)).convert("RGB"), int).reshape(-1, 3)
    hue = shown / np.maximum(shown.sum(axis=1, keepdims=True), 1)
    strong = np.ptp(hue, axis=1) > 0.1
    for colour in COLOURS:
        near = np.abs(hue - np.array(colour) / sum(colour)).max(axis=1) < 0.06
        assert (near & strong).sum() > 50, colour
    assert pictures_of_origin(replace(BALL, origin=None)) == {}
