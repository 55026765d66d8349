"""GLB files: Khronos finds nothing to say, and every byte means what glTF says it means."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.export.glb import Packing, to_glb
from capture2vr.edge.mesh.normals import split_flips, vertex_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.srgb import to_srgb
from capture2vr.edge.texture.bake import jpeg_of
from tests.referees.glb_reader import Glb
from tests.referees.gltf.validator import Validator, validator  # noqa: F401 - a fixture is used by its name
from tests.support import surfaces


def coloured(mesh: Mesh, seed: int = 0) -> Mesh:
    rng = np.random.default_rng(seed)
    return replace(mesh, rgb=rng.integers(0, 256, (len(mesh.vertices), 3), dtype=np.uint8))


def moebius(cells: int = 60) -> Mesh:
    """A Möbius strip welded along its seam, so that no winding is consistent."""
    u, v = np.meshgrid(np.arange(cells) / cells * 2 * np.pi, np.linspace(-0.4, 0.4, 7), indexing="ij")
    radius = 1 + v * np.cos(u / 2)
    vertices = np.stack([radius * np.cos(u), v * np.sin(u / 2), radius * np.sin(u)], axis=-1).reshape(-1, 3)
    row, column = (part.ravel() for part in np.meshgrid(np.arange(cells), np.arange(6), indexing="ij"))

    def vertex(step: int, across: int) -> Any:
        last = row + step == cells
        return np.where(last, (6 - column - across), (row + step) * 7 + column + across)

    a, b, c, d = vertex(0, 0), vertex(1, 0), vertex(1, 1), vertex(0, 1)
    return Mesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


TRIANGLE = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
KINDS = {
    "one triangle": TRIANGLE,
    "plain": surfaces.hemisphere(),
    "coloured": coloured(surfaces.hemisphere()),
    "more than 65,535 vertices": coloured(surfaces.patch(lambda u, v: [u, v, 0.1 * np.sin(9 * u)], 300, 300)),
    "one-sided": coloured(moebius()),
    "far from the origin": replace(surfaces.disk(), vertices=surfaces.disk().vertices + np.array([1000.0, -500, 2000])),
    "tiny": replace(surfaces.disk(), vertices=surfaces.disk().vertices * 1e-5),
    "with degenerate and unused": Mesh(
        np.concatenate([TRIANGLE.vertices, [[2.0, 0, 0], [9, 9, 9]]]), np.array([[0, 1, 2], [0, 1, 3], [1, 1, 2]])
    ),
}


def textured(mesh: Mesh, seed: int = 0) -> TexturedMesh:
    """With every triangle for itself, anywhere in a picture of noise."""
    rng = np.random.default_rng(seed)
    apart = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3))
    picture = rng.integers(0, 256, (32, 32, 3), dtype=np.uint8)
    return TexturedMesh(apart, rng.random((len(apart.vertices), 2)), jpeg_of(picture, 88), 32)


PICTURED = {kind: textured(KINDS[kind]) for kind in ("one triangle", "one-sided", "tiny", "with degenerate and unused")}
PICTURED["with a normal map"] = replace(PICTURED["one-sided"], normals=textured(TRIANGLE, seed=1).jpeg)
ASSETS: dict[str, Mesh | TexturedMesh] = {**KINDS, **{f"{kind}, pictured": PICTURED[kind] for kind in PICTURED}}
PACKINGS: tuple[Packing, ...] = ("float", "meshopt")
# The validator does not know the extension, and what only the extension reads is to it unused.
BEYOND_KHRONOS = ("UNSUPPORTED_EXTENSION /extensionsUsed/1", "UNUSED_OBJECT /buffers/0")


@pytest.mark.slow
def test_khronos_finds_no_fault_with_any_kind(validator: Validator, tmp_path: Path) -> None:  # noqa: F811
    cases = [(kind, packing, unlit) for kind in ASSETS for packing in PACKINGS for unlit in (False, True)]
    files = [tmp_path / f"{number}.glb" for number in range(len(cases))]
    for file, (kind, packing, unlit) in zip(files, cases, strict=True):
        file.write_bytes(to_glb(ASSETS[kind], packing, unlit=unlit))
    for case, verdict in zip(cases, validator(*files), strict=True):
        said = [each for each in verdict.messages if not (case[1] == "meshopt" and each.startswith(BEYOND_KHRONOS))]
        assert (verdict.errors, verdict.warnings, said) == (0, 0, []), case


@pytest.mark.slow
def test_khronos_finds_no_fault_with_what_a_compressed_file_holds(validator: Validator, tmp_path: Path) -> None:  # noqa: F811
    files = [tmp_path / f"{number}.glb" for number in range(len(ASSETS))]
    for file, asset in zip(files, ASSETS.values(), strict=True):
        file.write_bytes(Glb.of(to_glb(asset, "meshopt")).decompressed())
    for kind, verdict in zip(ASSETS, validator(*files), strict=True):
        assert (verdict.errors, verdict.warnings, verdict.messages) == (0, 0, ()), kind


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_compressed_file_holds_the_same_mesh_within_its_grid(kind: str) -> None:
    full, small = Glb.of(to_glb(KINDS[kind])), Glb.of(to_glb(KINDS[kind], "meshopt"))
    assert len(small.faces) == len(full.faces)
    (node,) = small.document["nodes"]
    side = np.ptp(full.positions, axis=0).max()
    assert node["scale"][0] <= max(1e-4, side / 65000)
    order = _matching(full, small)
    mine = np.take_along_axis(small.faces[order[0]], order[1], axis=1)
    off = np.abs(full.positions[full.faces] - small.positions[mine]).max()
    assert off <= 0.51 * node["scale"][0] + 1e-7 * np.abs(full.positions).max()
    cosine = np.sort(np.einsum("fcx,fcx->fc", full.normals[full.faces], small.normals[mine]), axis=None)
    assert np.degrees(np.arccos(np.clip(cosine[len(cosine) // 50 :], -1, 1))).max() < 3
    if KINDS[kind].rgb is not None:
        light = [glb.attribute("COLOR_0")[index] for glb, index in ((full, full.faces), (small, mine))]
        full_rgb, small_rgb = (to_srgb(each[..., :3] / 65535) for each in light)
        assert np.array_equal(full_rgb, small_rgb)


def _matching(full: Glb, small: Glb) -> tuple[np.ndarray, np.ndarray]:
    """(F,) the faces of the one that are those of the other, and (F,3) their corners in the same order."""
    corners = [glb.positions[glb.faces].reshape(-1, 9) for glb in (full, small)]
    turned = np.concatenate([np.roll(corners[1].reshape(-1, 3, 3), step, axis=1).reshape(-1, 9) for step in range(3)])
    _, found = cKDTree(turned).query(corners[0])
    count = len(small.faces)
    assert len(np.unique(found % count)) == count
    return found % count, (np.arange(3) - found[:, None] // count) % 3


@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("kind", PICTURED)
def test_every_corner_keeps_its_place_in_the_picture(kind: str, packing: Packing) -> None:
    asset = PICTURED[kind]
    glb = Glb.of(to_glb(asset, packing))
    corners = [np.c_[xyz, uv][faces] for xyz, uv, faces in ((glb.positions, glb.uv, glb.faces), _own(asset))]
    assert len(corners[0]) == len(corners[1])
    turned = np.concatenate([np.roll(corners[0], step, axis=1) for step in range(3)])
    distance, _ = cKDTree(turned.reshape(-1, 15)).query(corners[1].reshape(-1, 15))
    assert distance.max() <= 1e-4 * np.ptp(asset.mesh.vertices, axis=0).max() + 1e-4


def _own(asset: TexturedMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    corners = asset.mesh.vertices[asset.mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return asset.mesh.vertices, asset.uv, asset.mesh.faces[area > 0]


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_picture_goes_in_as_it_is_and_is_shown_with_mips(packing: Packing) -> None:
    asset = PICTURED["one-sided"]
    glb = Glb.of(to_glb(asset, packing))
    assert glb.image == asset.jpeg
    (material,), (sampler,) = glb.document["materials"], glb.document["samplers"]
    assert material["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}
    assert material["pbrMetallicRoughness"]["baseColorFactor"] == [1, 1, 1, 1]
    assert material["doubleSided"] is True
    assert (sampler["minFilter"], sampler["magFilter"]) == (9987, 9729)  # linear between mips, and within
    assert set(glb.primitive["attributes"]) == {"POSITION", "NORMAL", "TEXCOORD_0"}


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_normal_map_goes_in_beside_the_picture(packing: Packing) -> None:
    asset = PICTURED["with a normal map"]
    glb = Glb.of(to_glb(asset, packing))
    (material,) = glb.document["materials"]
    colour, bumps = (
        glb.document["textures"][texture["index"]]["source"]
        for texture in (material["pbrMetallicRoughness"]["baseColorTexture"], material["normalTexture"])
    )
    assert glb.image_file(colour) == asset.jpeg
    assert glb.image_file(bumps) == asset.normals
    assert "normalTexture" not in Glb.of(to_glb(PICTURED["one-sided"], packing)).document["materials"][0]


def test_normals_of_a_pictured_strip_with_one_side_never_point_through_it() -> None:
    loose = surfaces.mobius()
    vertices, own = np.unique(loose.vertices.round(9), axis=0, return_inverse=True)
    strip = Mesh(vertices, own.ravel()[loose.faces])
    uv = np.random.default_rng(0).random((len(strip.vertices), 2))
    glb = Glb.of(to_glb(TexturedMesh(strip, uv, PICTURED["one triangle"].jpeg, 32)))
    corners = glb.positions[glb.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    assert np.einsum("fx,fcx->fc", across, glb.normals[glb.faces]).min() > 0.5


def test_light_knows_no_seam_of_the_picture() -> None:
    """A vertex that the unwrapping doubled has one normal, that of the whole surface."""
    ball = surfaces.sphere()
    glb = Glb.of(to_glb(textured(ball)))
    outward = glb.positions / np.linalg.norm(glb.positions, axis=1, keepdims=True)
    assert np.abs(np.einsum("vx,vx->v", outward, glb.normals)).min() > 0.99


def test_unlit_is_said_by_an_extension_that_nobody_must_know() -> None:
    lit, unlit = (Glb.of(to_glb(PICTURED["one triangle"], unlit=each)).document for each in (False, True))
    assert "extensionsUsed" not in lit
    assert unlit["extensionsUsed"] == ["KHR_materials_unlit"]
    assert "extensionsRequired" not in unlit
    assert unlit["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}


def test_a_scan_like_mesh_takes_a_quarter_of_its_bytes() -> None:
    rng = np.random.default_rng(0)
    rough = coloured(surfaces.patch(lambda u, v: [u, v, 0.1 * np.sin(9 * u)], 200, 200))
    rough = replace(rough, vertices=rough.vertices + rng.normal(0, 3e-4, rough.vertices.shape))
    smooth = (127 + 120 * np.sin(5 * rough.vertices)).astype(np.uint8)
    assert len(to_glb(replace(rough, rgb=smooth), "meshopt")) <= len(to_glb(rough)) / 4


@settings(deadline=None, max_examples=60)
@given(
    side_m=st.floats(0.1, 300),
    border_m=st.floats(-500, 500),
    seed=st.integers(0, 99),
)
def test_neighbouring_tiles_still_meet_at_their_border(side_m: float, border_m: float, seed: int) -> None:
    heights = np.random.default_rng(seed).uniform(0, side_m, (3, 20))
    rows = border_m + side_m * np.array([-1, 0, 1])
    columns = border_m / 3 + np.linspace(0, side_m, 20)

    def strip(first: int) -> Mesh:
        xyz = [[[rows[row], heights[row, i], columns[i]] for i in range(20)] for row in (first, first + 1)]
        a, b = np.arange(19), np.arange(20, 39)
        return Mesh(
            np.reshape(xyz, (-1, 3)), np.concatenate([np.stack([a, a + 1, b], 1), np.stack([b, a + 1, b + 1], 1)])
        )

    left, right = (Glb.of(to_glb(strip(first), "meshopt", common_step_m=1e-4)) for first in (0, 1))

    one, other = (float(glb.document["nodes"][0]["scale"][0]) for glb in (left, right))
    gap, _ = cKDTree(left.positions).query(right.positions)
    allowed = 1e-7 * abs(border_m) + (0 if one == other else 0.9 * max(one, other))
    assert (gap <= allowed + 1e-9).sum() >= 20  # the vertices of the border
    assert one <= max(1e-4, 2 * side_m / 65_000)
    assert side_m > 6 or one == other == 1e-4


def test_what_rounding_makes_flat_is_left_out() -> None:
    thin = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1e-7, 0]]), np.array([[0, 1, 2], [0, 1, 3]]))
    assert len(Glb.of(to_glb(thin)).faces) == 2
    assert len(Glb.of(to_glb(thin, "meshopt")).faces) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_one_draw_call_with_one_double_sided_material(kind: str) -> None:
    glb = Glb.of(to_glb(KINDS[kind]))
    (material,) = glb.document["materials"]
    assert material["doubleSided"] is True
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert glb.primitive["material"] == 0
    assert glb.document["asset"]["generator"].startswith("capture2vr ")


@pytest.mark.parametrize("kind", KINDS)
def test_normals_have_length_one_and_bounds_are_those_of_the_positions(kind: str) -> None:
    glb = Glb.of(to_glb(KINDS[kind]))
    assert np.allclose(np.linalg.norm(glb.attribute("NORMAL"), axis=1), 1, atol=1e-6)
    accessor = glb.document["accessors"][glb.primitive["attributes"]["POSITION"]]
    positions = glb.attribute("POSITION")
    assert np.array_equal(np.float32(accessor["min"]), positions.min(axis=0))
    assert np.array_equal(np.float32(accessor["max"]), positions.max(axis=0))


def test_positions_and_faces_come_back_as_they_went_in() -> None:
    mesh = surfaces.grid_with_holes()
    glb = Glb.of(to_glb(mesh))
    before, after = mesh.vertices[mesh.faces].astype(np.float32), glb.attribute("POSITION")[glb.faces]
    assert np.array_equal(before, after)


def test_colours_are_linear_light_in_sixteen_bits() -> None:
    rgb = np.array([[0, 188, 255], [55, 13, 1], [128, 128, 128]], dtype=np.uint8)
    glb = Glb.of(to_glb(replace(TRIANGLE, rgb=rgb)))
    accessor = glb.document["accessors"][glb.primitive["attributes"]["COLOR_0"]]
    assert accessor["normalized"] is True
    light = glb.attribute("COLOR_0") / 65535
    expected = [[0, 0.5028865, 1], [0.0382043, 0.0040247, 0.0003035], [0.2158605] * 3]  # IEC 61966-2-1
    assert np.allclose(light[:, :3], expected, atol=1e-5)
    assert (light[:, 3] == 1).all()


def test_base_colour_is_white_under_colours_and_grey_without() -> None:
    def base(mesh: Mesh) -> list[float]:
        return list(Glb.of(to_glb(mesh)).document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"])

    assert base(coloured(TRIANGLE)) == [1, 1, 1, 1]
    assert base(TRIANGLE)[0] < 1
    assert "COLOR_0" not in Glb.of(to_glb(TRIANGLE)).primitive["attributes"]


@pytest.mark.parametrize(("kind", "component"), [("plain", 5123), ("more than 65,535 vertices", 5125)])
def test_indices_are_as_short_as_they_can_be(kind: str, component: int) -> None:
    glb = Glb.of(to_glb(KINDS[kind]))
    assert glb.document["accessors"][glb.primitive["indices"]]["componentType"] == component


def test_degenerate_triangles_and_unused_vertices_are_left_out() -> None:
    glb = Glb.of(to_glb(KINDS["with degenerate and unused"]))
    assert len(glb.faces) == 1
    assert len(glb.attribute("POSITION")) == 3


def test_a_mesh_without_area_is_refused() -> None:
    with pytest.raises(ValueError, match="none of the 1 triangles"):
        to_glb(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))


def test_the_same_mesh_gives_the_same_bytes() -> None:
    assert to_glb(KINDS["one-sided"]) == to_glb(KINDS["one-sided"])


def test_normals_of_a_sphere_point_from_its_centre() -> None:
    mesh = surfaces.hemisphere()
    low, high = mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()
    inner = (mesh.vertices[:, 2] > low + 0.05) & (mesh.vertices[:, 2] < high)  # the pole's spare copies have no face
    outward = mesh.vertices - [0, 0, mesh.vertices[:, 2].min()]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    cosine = np.einsum("vx,vx->v", vertex_normals(mesh), outward)
    assert np.abs(cosine[inner]).min() > 0.999
    assert np.ptp(np.sign(cosine[inner])) == 0


def test_each_corner_of_a_one_sided_strip_agrees_with_its_face() -> None:
    """Otherwise a double-sided shader, which turns normals by the face's winding, shows a black seam."""
    strip = split_flips(moebius())
    assert len(strip.vertices) > len(moebius().vertices)
    corners = strip.vertices[strip.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    agreement = np.einsum(
        "fcx,fx->fc", vertex_normals(strip)[strip.faces], flat / np.linalg.norm(flat, axis=1)[:, None]
    )
    assert agreement.min() > 0.9


def test_splitting_leaves_an_oriented_mesh_alone() -> None:
    mesh = surfaces.grid_with_holes()
    assert split_flips(mesh) is mesh


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(3, 12))
def test_any_triangle_soup_has_unit_normals(seed: int, faces: int, vertices: int) -> None:
    rng = np.random.default_rng(seed)
    soup = Mesh(rng.normal(0, 1, (vertices, 3)).round(1), rng.integers(0, vertices, (faces, 3)))
    for mesh in (soup, split_flips(soup)):
        assert np.allclose(np.linalg.norm(vertex_normals(mesh), axis=1), 1)
    assert np.array_equal(split_flips(soup).vertices[split_flips(soup).faces], soup.vertices[soup.faces])
