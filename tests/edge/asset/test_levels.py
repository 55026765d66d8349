"""Levels with the colours of their capture: of points and pictures, in the asset frame, as the target wants them."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.asset.levels import add_textures, pack_glb, preview_images
from capture2vr.edge.asset.manifest import AssetSubject
from capture2vr.edge.asset.target import TARGETS, Target, measure_cost, target_of
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.points.nouns import Points, TextureView
from capture2vr.edge.texture import texture_mesh
from capture2vr.edge.texture.unwrap import UnwrapError
from tests.referees.glb_reader import Glb
from tests.support import surfaces

SIDE = 400  # pixels of the picture


def print_of(xyz: np.ndarray) -> np.ndarray:
    """(N,3) sRGB of stripes in the capture frame, where the sheet is z = 0 from (0, 0) to (2, 2)."""
    return np.where(np.sin(12 * xyz[:, :1]) > 0, [[230, 60, 40]], [[40, 60, 200]]).astype(np.uint8)


def sheet() -> Mesh:
    made = surfaces.patch(lambda u, v: [u, v, 0 * u], 8, 8)
    return Mesh(2 * made.vertices + np.array([1, 1, 0]), made.faces)


def bumpy_sheet() -> Mesh:
    """The sheet with ripples, as full a mesh as an extraction's."""
    made = surfaces.patch(lambda u, v: [u, v, 0 * u], 150, 150)
    x, y, z = 2 * made.vertices.T
    return Mesh(np.stack([x + 1, y + 1, z + 0.008 * np.sin(40 * x)], axis=1), made.faces)


def points(count: int, *, coloured: bool = True, views: tuple[TextureView, ...] = ()) -> Points:
    xyz = np.random.default_rng(0).uniform(0, 2, (count, 3)) * [1, 1, 0]
    return Points(
        xyz, print_of(xyz) if coloured else None, np.ones(count, np.float32), 0.5, "metric", None, texture_views=views
    )


def shot() -> TextureView:
    """From 2.4 units above the sheet's middle, looking down: its picture covers it, and 0.2 around it."""
    at = (np.arange(SIDE) + 0.5) / SIDE * 2.4 - 0.2
    x, y = np.meshgrid(at, 2 - at)
    rgb = print_of(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(SIDE, SIDE, 3)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = 1, 1, 2.4
    camera = Intrinsics(SIDE, SIDE, SIDE / 2 - 0.5, SIDE / 2 - 0.5, SIDE, SIDE)
    return TextureView(camera.scaled_to(100, 100), pose, lambda: rgb, lambda: np.full((100, 100), 2.4, np.float32))


def to_asset() -> np.ndarray:
    """(4,4) half a metre per unit, the capture's Z up, somewhere else."""
    placed = np.eye(4)
    placed[:3, :3] = 0.5 * np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    placed[:3, 3] = -0.3, 0.1, 0.7
    return placed


def asset_of(
    known: Points, target: Target = TARGETS["quest3"], full: Mesh | None = None
) -> tuple[Mesh | TexturedMesh, tuple[str, ...]]:
    """The only level, of a full mesh that is the sheet itself where none is given, and what is said of it."""
    unasked: Any = None
    subject = AssetSubject(unasked, unasked, "", "", target, "none", known, known, unasked, known.xyz, unasked)
    mesh, placed = sheet(), to_asset()
    level = Mesh(mesh.vertices @ placed[:3, :3].T + placed[:3, 3], mesh.faces, print_of(mesh.vertices))
    (asset,), warnings = add_textures([level], full or mesh, placed, subject, None, no_tick)
    return asset, warnings


@pytest.mark.slow
def test_a_level_of_much_fewer_triangles_gets_a_normal_map() -> None:
    """Where the target asks for it; a full mesh of as many triangles has nothing to add."""
    for target, full, expected in (
        (target_of("quest3-normals"), bumpy_sheet(), True),
        (target_of("quest3-normals"), sheet(), False),
        (TARGETS["quest3"], bumpy_sheet(), False),
    ):
        asset, _ = asset_of(points(20_000), target, full)
        assert isinstance(asset, TexturedMesh)
        assert (asset.normals is not None) == expected
        assert (measure_cost(pack_glb(asset, target)).texture_bytes > 4 * asset.side**2 * 1.4) == expected


@pytest.mark.slow
def test_a_normal_map_that_makes_the_last_level_too_large_is_left_out() -> None:
    plain, _ = asset_of(points(20_000), TARGETS["quest3"])
    limit = len(pack_glb(plain, TARGETS["quest3"])) + 100
    asset, _ = asset_of(points(20_000), replace(target_of("quest3-normals"), last_bytes=limit), bumpy_sheet())
    assert isinstance(asset, TexturedMesh)
    assert asset.normals is None


def share_right(asset: Mesh | TexturedMesh) -> float:
    """Of the texels at the vertices, off the lines of the print."""
    assert isinstance(asset, TexturedMesh)
    picture = np.asarray(Image.open(io.BytesIO(asset.jpeg))).astype(int)
    at = np.floor(asset.uv * asset.side).astype(int).clip(0, asset.side - 1)
    capture = np.linalg.inv(to_asset())
    xyz = asset.mesh.vertices @ capture[:3, :3].T + capture[:3, 3]
    clear = np.abs(np.sin(12 * xyz[:, 0])) > 0.3
    off = np.abs(picture[at[:, 1], at[:, 0]] - print_of(xyz)).max(axis=1)
    return float((off[clear] < 60).mean())


def test_points_colour_a_texture_in_the_asset_frame() -> None:
    asset, warnings = asset_of(points(20_000))
    assert share_right(asset) == 1
    assert warnings == ()


@pytest.mark.slow
def test_pictures_colour_it_where_the_points_are_few() -> None:
    known = points(150, views=(shot(),))  # for 81 vertices
    asset, _ = asset_of(known)
    assert share_right(asset) == 1
    assert isinstance(asset, TexturedMesh)
    assert asset.side == 1024  # 111,000 pixels lie on it
    assert isinstance(asset_of(replace(known, texture_views=()))[0], Mesh)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("quest2", 1024), ("web", 1024)])
def test_no_texture_is_larger_than_its_target_allows(name: str, most: int) -> None:
    fine = replace(shot(), load_rgb=lambda: np.zeros((4 * SIDE, 4 * SIDE, 3), np.uint8))
    asset, _ = asset_of(points(200, views=(fine,)), replace(TARGETS[name], last_bytes=0))
    assert isinstance(asset, TexturedMesh)
    assert asset.side == most


@pytest.mark.slow
def test_the_last_level_keeps_within_its_bytes() -> None:
    small = replace(TARGETS["quest3"], last_bytes=20_000)
    asset, _ = asset_of(points(200, views=(shot(),)), small)
    assert isinstance(asset, TexturedMesh)
    assert asset.side < 1024
    assert len(pack_glb(asset, small)) <= 20_000


def test_without_colours_or_for_other_programs_there_is_no_texture() -> None:
    assert isinstance(asset_of(points(20_000, coloured=False))[0], Mesh)
    assert isinstance(asset_of(points(20_000), TARGETS["archive"])[0], Mesh)


def test_a_target_may_ask_for_colours_as_they_were_captured() -> None:
    asset, _ = asset_of(points(20_000))
    unlit = Glb.of(pack_glb(asset, replace(TARGETS["quest3"], unlit=True)))
    assert "KHR_materials_unlit" in unlit.document["extensionsUsed"]
    assert "KHR_materials_unlit" not in Glb.of(pack_glb(asset, TARGETS["quest3"])).document["extensionsUsed"]


def test_a_texture_that_cannot_be_made_costs_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise UnwrapError("xatlas ended with status -11")

    monkeypatch.setattr(texture_mesh, "unwrap", fail)
    asset, (warning,) = asset_of(points(20_000))
    assert isinstance(asset, Mesh)
    assert asset.rgb is not None
    assert "LOD 0 has no texture: xatlas ended with status -11" in warning


@pytest.mark.slow
def test_a_preset_of_large_levels_still_gets_a_file_for_phones(monkeypatch: pytest.MonkeyPatch) -> None:
    """A colour atlas has room for 131,072 faces: an operator's preset may ask for more."""
    monkeypatch.setattr("capture2vr.edge.export.usdz.MOST_FACES", 1_000)
    monkeypatch.setattr("capture2vr.edge.export.colour_atlas.MOST_FACES", 1_000)
    level = bumpy_sheet()
    coloured = replace(level, rgb=print_of(level.vertices))
    assert "asset.usdz" in preview_images([coloured], last=True, tick=no_tick)


def test_a_brief_bundle_has_a_contact_sheet_of_half_the_side() -> None:
    level = surfaces.patch(lambda u, v: [u, v, 0 * u], 10, 10)
    sides = {}
    for brief in (True, False):
        sheet = preview_images([level], last=False, brief=brief, tick=no_tick)["preview.png"]
        sides[brief] = Image.open(io.BytesIO(sheet)).size
    assert sides == {True: (512, 512), False: (1024, 1024)}
