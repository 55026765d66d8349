"""Pictures for meshes: the right colour at the right place, nothing across seams, and only where they show more."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from capture2vr.edge.errors import Cancelled
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.mesh.simplify import simplify
from capture2vr.edge.render.rays import RaycastingScene
from capture2vr.edge.srgb import to_linear
from capture2vr.edge.texture import texture_mesh
from capture2vr.edge.texture import unwrap as unwrapping
from capture2vr.edge.texture.bake import bake, find_texels, jpeg_of
from capture2vr.edge.texture.nearest_colour import ColouredPoints
from capture2vr.edge.texture.texture_mesh import Palette, needs_texture, texture_levels, texture_side, unwrap_and_bake
from capture2vr.edge.texture.unwrap import UnwrapError, unwrap
from tests.support import surfaces

SHEET = surfaces.patch(lambda u, v: [u, v, 0.2 * u * v], 10, 10)
BOWL = surfaces.patch(lambda u, v: [np.cos(3 * u), np.sin(3 * u), v], 16, 8)
RED, BLUE = (200, 30, 30), (30, 40, 210)


def checked(xyz: np.ndarray, cells: int = 8) -> np.ndarray:
    """(N,3) uint8 of a checkerboard in x and y."""
    odd = np.floor(xyz[:, :2] * cells).astype(int).sum(axis=1) % 2 == 1
    return np.where(odd[:, None], RED, BLUE).astype(np.uint8)


def cloud(mesh: Mesh, count: int) -> np.ndarray:
    """(count,3) places on a mesh."""
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(made, count, seed=0)[0])


def palette(mesh: Mesh, count: int = 40_000) -> Palette:
    xyz = cloud(mesh, count)
    return Palette(ColouredPoints.of(xyz, checked(xyz)))


def coloured(mesh: Mesh) -> Mesh:
    return replace(mesh, rgb=checked(mesh.vertices))


def shown(glb: bytes, places: np.ndarray) -> np.ndarray:
    """(N,3) sRGB that another program's reader finds at places on the sheet."""
    read = trimesh.load(io.BytesIO(glb), file_type="glb", force="mesh", process=False)
    above = places + np.array([0, 0, 1])
    hits = RaycastingScene(Mesh(np.asarray(read.vertices), np.asarray(read.faces))).cast(
        above, np.array([[0, 0, -1.0]] * len(above))
    )
    uv = np.einsum("nc,ncx->nx", hits.bary, read.visual.uv[read.faces[hits.face]])
    picture = np.asarray(read.visual.material.baseColorTexture)
    # trimesh turns glTF's v over: its (0,0) is the lower left corner.
    at = np.floor(np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1) * len(picture)).astype(int).clip(0, len(picture) - 1)
    return picture[at[:, 1], at[:, 0]].astype(int)


def test_a_checkerboard_on_a_coarse_mesh_comes_back_where_it_was() -> None:
    glb = to_glb(unwrap_and_bake(coloured(SHEET), palette(SHEET), side=256))
    places = cloud(SHEET, 2_000)
    inner = (np.abs((places[:, :2] * 8 + 0.5) % 1 - 0.5) > 0.15).all(axis=1)  # off the lines of the board
    off = np.abs(shown(glb, places[inner]) - checked(places[inner])).max(axis=1)
    assert (off < 40).mean() > 0.99
    assert len(SHEET.vertices) == 121  # the board has 64 cells: vertices could not hold it


def test_a_texel_lies_where_its_centre_does() -> None:
    """Two triangles over the whole square: place, face and weights follow from row and column."""
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    found = find_texels(np.array([[0, 1, 2], [0, 2, 3]]), uv, 8)
    assert np.array_equal(found.place, np.arange(64))
    row, column = np.divmod(np.arange(64), 8)
    off = row != column  # the diagonal is both triangles'
    assert np.array_equal(found.face[off], (row > column)[off].astype(int))
    centre = np.einsum("tc,tcx->tx", found.bary, uv[np.array([[0, 1, 2], [0, 2, 3]])[found.face]])
    assert np.allclose(centre, np.stack([column + 0.5, row + 0.5], axis=1) / 8, atol=1e-5)


def test_seams_do_not_bleed_even_in_mips() -> None:
    """A surface of one colour has a picture of one colour: gaps between charts bring in no other."""
    found = unwrap(BOWL, side=128)
    grey = to_linear(np.full((1, 3), 90, np.uint8))
    picture, covered = bake(found.mesh, found.uv, lambda at, _n, _t: np.repeat(grey, len(at), axis=0), side=128)
    assert 0 < covered < 128 * 128
    assert (picture == 90).all()


def test_what_lies_beside_a_chart_has_the_colour_of_its_rim() -> None:
    found = unwrap(BOWL, side=128)
    light = lambda at, _n, _t: at - at.min(axis=0)  # noqa: E731 - a colour for every place
    picture, _ = bake(found.mesh, found.uv, light, side=128)
    texels = find_texels(found.mesh.faces, found.uv, 128)
    known = np.zeros(128 * 128, bool)
    known[texels.place] = True
    known = known.reshape(128, 128)
    beside = ~known[1:] & known[:-1]
    near = np.abs(picture[1:].astype(int) - picture[:-1])[beside].max(axis=1)
    assert np.percentile(near, 90) < 30  # black, which the gaps began with, is 100 to 255 away


def test_it_can_be_stopped_in_the_middle() -> None:
    def stop(fraction: float) -> None:
        if fraction > 0.6:
            raise Cancelled

    with pytest.raises(Cancelled):
        unwrap_and_bake(coloured(SHEET), palette(SHEET), side=256, tick=stop)


def test_progress_goes_from_none_to_all() -> None:
    heard: list[float] = []
    unwrap_and_bake(coloured(SHEET), palette(SHEET), side=128, tick=heard.append)
    assert heard[0] < 0.1
    assert heard[-1] == 1
    assert heard == sorted(heard)


def test_the_size_follows_from_how_much_is_known() -> None:
    sides = [texture_side(SHEET, palette(SHEET, count), 2048) for count in (2_000, 40_000, 200_000)]
    assert sides == [128, 512, 1024]
    assert texture_side(SHEET, palette(SHEET, 200_000), 256) == 256
    fine = replace(palette(SHEET, 2_000), pixel=1e-3)  # a million pixels of photos on a square metre
    assert texture_side(SHEET, fine, 2048) == 2048


@pytest.mark.parametrize(
    ("mesh", "count", "worth"),
    [
        (coloured(SHEET), 40_000, True),
        (coloured(SHEET), 200, False),  # vertices know as much
        (SHEET, 40_000, False),  # no colours
        (replace(SHEET, rgb=np.full_like(checked(SHEET.vertices), 90)), 40_000, True),
    ],
)
def test_a_picture_is_made_where_it_shows_more(mesh: Mesh, count: int, worth: bool) -> None:
    assert needs_texture(mesh, palette(SHEET, count)) == worth


def test_one_colour_needs_no_picture() -> None:
    xyz = cloud(SHEET, 40_000)
    plain = Palette(ColouredPoints.of(xyz, np.full((len(xyz), 3), 90, np.uint8)))
    assert not needs_texture(replace(SHEET, rgb=np.full((121, 3), 90, np.uint8)), plain)


def test_points_closer_together_than_texels_are_averaged() -> None:
    """Half of them black, half white: a coarse picture is grey, not speckled."""
    xyz = cloud(SHEET, 60_000)
    rgb = np.where(np.random.default_rng(1).random((len(xyz), 1)) < 0.5, 0, 255).astype(np.uint8).repeat(3, axis=1)
    made = unwrap_and_bake(coloured(SHEET), Palette(ColouredPoints.of(xyz, rgb)), side=64)
    picture = np.asarray(Image.open(io.BytesIO(made.jpeg)))
    assert 150 < np.median(picture) < 220  # half of the light is 188
    assert picture.std() < 50  # 120 of the nearest alone


def test_points_off_the_surface_are_not_averaged_into_its_rim() -> None:
    """What stood around the thing and was cut away still is among the points."""
    xyz = cloud(SHEET, 60_000)
    beside = xyz + np.array([1.2, 0, 0])
    rgb = np.repeat(np.array([[200], [0]], np.uint8), len(xyz), axis=0).repeat(3, axis=1)
    known = Palette(ColouredPoints.of(np.concatenate([xyz, beside]), rgb))
    picture = np.asarray(Image.open(io.BytesIO(unwrap_and_bake(coloured(SHEET), known, side=64).jpeg)))
    assert picture.min() > 180


def test_what_photos_do_not_show_comes_from_the_points_beside_it_alone() -> None:
    """However few of the texels that are: points elsewhere are not theirs."""
    xyz = cloud(SHEET, 60_000)
    hidden = (np.abs(xyz[:, :2] - 0.3) < 0.06).all(axis=1)
    points = ColouredPoints.of(xyz, np.where(hidden[:, None], 200, 0).repeat(3, axis=1).astype(np.uint8))

    def photos(places: np.ndarray, *_: object) -> tuple[np.ndarray, np.ndarray]:
        return np.ones((len(places), 3), np.float32), (np.abs(places[:, :2] - 0.3) > 0.05).any(axis=1).astype(
            np.float32
        )

    places = cloud(SHEET, 2_000)
    shown = Palette(points, photos, 0.01).light_at(places, places, 0.02)
    inner = (np.abs(places[:, :2] - 0.3) < 0.04).all(axis=1)
    assert inner.sum() > 5
    assert np.allclose(shown[inner], to_linear(np.uint8(200)), atol=0.05)
    assert np.allclose(shown[(np.abs(places[:, :2] - 0.3) > 0.06).any(axis=1)], 1)


def test_levels_keep_what_needs_no_picture_and_fit_their_budget() -> None:
    fine = coloured(surfaces.patch(lambda u, v: [u, v, 0.2 * u * v], 60, 60))
    known = palette(SHEET, 6_000)  # 3,721 vertices: no less than a picture would need
    levels, warnings = texture_levels([fine, coloured(SHEET)], known, most_px=1024, fits=lambda made: made.side <= 64)
    assert levels[0] is fine
    assert isinstance(levels[1], TexturedMesh)
    assert levels[1].side == 64
    assert warnings == ()


@pytest.mark.slow
def test_coarser_levels_have_smaller_pictures() -> None:
    known = replace(palette(SHEET), pixel=1e-3)
    levels, _ = texture_levels([coloured(SHEET)] * 3, known, most_px=1024)
    assert [level.side for level in levels if isinstance(level, TexturedMesh)] == [1024, 512, 512]


def test_a_level_that_cannot_be_unwrapped_keeps_its_colours_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise UnwrapError("xatlas took more than 90 s")

    monkeypatch.setattr(texture_mesh, "unwrap", fail)
    levels, warnings = texture_levels([coloured(SHEET)], palette(SHEET), most_px=1024)
    assert isinstance(levels[0], Mesh)
    assert warnings == ("LOD 0 has no texture: xatlas took more than 90 s. It keeps its vertex colours.",)


@pytest.mark.slow
def test_openings_that_forbid_fewer_triangles_cost_a_level_no_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = surfaces.patch(lambda u, v: [u, v, 0.1 * np.sin(9 * u) * np.cos(8 * v)], 80, 80)
    row, column = np.divmod(np.arange(80 * 80), 80)
    lace = coloured(replace(whole, faces=whole.faces[np.tile((row % 3 > 0) | (column % 3 > 0), 2)]))
    monkeypatch.setattr(texture_mesh, "_FACES", 3_000)
    assert len(simplify(lace, 3_000).faces) > 3_000
    (made,), warnings = texture_levels([lace], palette(lace, 100_000), most_px=1024)
    assert isinstance(made, TexturedMesh)
    assert not warnings


def test_a_level_of_too_many_triangles_says_that_it_has_no_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unwrapping, "MOST_FACES", 199)
    level = coloured(SHEET)
    levels, warnings = texture_levels([level], palette(SHEET), most_px=1024)
    assert levels == (level,)
    assert "200 triangles are more than the 199 that can be unwrapped" in warnings[0]


def test_a_triangle_between_texels_shows_its_own_colour_all_the_same() -> None:
    """A large white chart beside a black one too thin for the centre of any texel."""
    uv = np.array(
        [[0.0, 0], [0.5, 0], [0, 1], [0.7, 0.205], [0.95, 0.205], [0.7, 0.215]]
    )  # of 10: centres at .05, .15, ..
    vertices = np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 0], [1, 0, 0], [0, 1, 0]])
    mesh = Mesh(vertices, np.array([[0, 1, 2], [3, 4, 5]]))
    picture, _ = bake(mesh, uv, lambda at, _n, _t: at[:, 2:].repeat(3, axis=1), side=10)
    assert (picture[2, [7, 9]] == 0).all()
    assert (picture[1, 1] == 255).all()


def test_a_picture_that_no_chart_reaches_is_black() -> None:
    tiny = np.array([[0.01, 0.01], [0.02, 0.01], [0.01, 0.02]])  # between the centres of the first texels
    picture, covered = bake(Mesh(np.eye(3), np.array([[0, 1, 2]])), tiny, lambda at, _n, _t: at, side=4)
    assert covered == 0
    assert picture.shape == (4, 4, 3)


def test_a_picture_too_small_for_its_charts_is_refused() -> None:
    scattered = surfaces.joined(*(surfaces.moved(SHEET, (2.0 * i, 0, 0)) for i in range(9)))
    with pytest.raises(UnwrapError, match="charts leave"):
        unwrap_and_bake(coloured(scattered), palette(scattered), side=16)


def test_colours_survive_being_packed() -> None:
    picture = np.zeros((32, 32, 3), np.uint8)
    picture[:, 15:] = RED  # an edge across a block
    back = np.asarray(Image.open(io.BytesIO(jpeg_of(picture, 88)))).astype(int)
    assert np.abs(back - picture).mean() < 4


@pytest.mark.slow
@settings(max_examples=6)
@given(st.integers(0, 2**32 - 1), st.integers(100, 3_000))
def test_a_picture_holds_no_colour_that_no_point_has(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = np.sort(rng.integers(0, 256, (2, 3)), axis=0)
    xyz = rng.uniform(0, 1, (count, 3))
    known = Palette(ColouredPoints.of(xyz, rng.integers(low, high + 1, (count, 3)).astype(np.uint8)))
    found = unwrap(SHEET, side=64)
    picture, _ = bake(found.mesh, found.uv, lambda at, n, t: known.light_at(at, n, 0.0, t), side=64)
    assert (picture >= low).all()
    assert (picture <= high).all()
