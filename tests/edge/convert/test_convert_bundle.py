"""Every format tells the same surface, where its readers expect it: read back by trimesh and by our own reader."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from capture2vr.edge.arrays import Floats
from capture2vr.edge.convert.convert_bundle import convert
from capture2vr.edge.convert.read_glb import read_glb
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.export.ply import ply_bytes
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.splats.spz import from_spz, to_spz
from capture2vr.edge.splats.surface_splats import MOST_SPLATS, cover_with_splats
from tests.referees.glb_reader import Glb
from tests.support.downloadable import SHEET, coloured, downloadable, in_capture_frame, textured, written
from tests.support.photos.painted import quarters
from tests.support.tilesets import CELLS, hill_bundle, hill_tile, hills

GRID_M = 1e-4  # of compressed positions
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def loaded(data: bytes, kind: str) -> trimesh.Trimesh:
    found = trimesh.load(io.BytesIO(data), file_type=kind, process=False)
    if isinstance(found, trimesh.Scene):
        (found,) = found.geometry.values()
    assert isinstance(found, trimesh.Trimesh)
    return found


def bounds(vertices: Floats) -> Floats:
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


@pytest.mark.parametrize("packing", ["float", "meshopt"])
@pytest.mark.parametrize("subject", [SHEET, coloured(), textured()], ids=["plain", "coloured", "textured"])
def test_a_level_is_read_back_as_it_was_written(subject: Mesh | TexturedMesh, packing: str) -> None:
    level = read_glb(to_glb(subject, packing, unlit=True))
    assert (level.unlit, level.is_packed, level.ktx2) == (True, packing == "meshopt", False)
    assert type(level.mesh) is type(subject)
    if isinstance(subject, TexturedMesh):
        assert (level.mesh.jpeg, level.mesh.side) == (subject.jpeg, 64)
        assert level.mesh.uv.min() == pytest.approx(0, abs=1e-4)
        assert level.mesh.uv.max() == pytest.approx(1, abs=1e-4)
    mesh = level.mesh.mesh if isinstance(level.mesh, TexturedMesh) else level.mesh
    assert len(mesh.faces) == len(SHEET.faces)
    np.testing.assert_allclose(bounds(mesh.vertices), bounds(SHEET.vertices), atol=GRID_M)
    if isinstance(subject, Mesh) and subject.rgb is not None:
        assert {tuple(each) for each in mesh.rgb} == {tuple(each) for each in subject.rgb}


def test_a_scene_in_tiles_is_zipped_with_all_of_them(tmp_path: Path) -> None:
    bundle, root = hill_bundle(levels=3)
    folder = written(bundle, tmp_path)
    (tmp_path / "tile-9-9-9.glb").write_bytes(b"of another run")
    with zipfile.ZipFile(io.BytesIO(convert(folder, "3d-tiles", "hills"))) as package:
        assert sorted(package.namelist()) == sorted(["tileset.json", *(each.name for each in root)])
        for name in package.namelist():
            assert package.read(name) == bundle.files[name]
    (tmp_path / root.name).unlink()
    with pytest.raises(FileNotFoundError):
        convert(folder, "3d-tiles", "hills")
    for document in (b"", b"[]", b"{}", b'{"root": 3}', b'{"root": {"content": {"uri": "../../x.glb"}}}'):
        (tmp_path / "tileset.json").write_bytes(document)
        with pytest.raises(ValueError, match=r"tileset\.json"):
            convert(folder, "3d-tiles", "hills")


@pytest.mark.parametrize("dress", [lambda mesh: mesh, textured], ids=["coloured", "textured"])
def test_ply_and_stl_of_a_scene_in_tiles_are_its_finest_tiles_in_one_piece(
    dress: Callable[[Mesh], Mesh | TexturedMesh], tmp_path: Path
) -> None:
    bundle, _ = hill_bundle(levels=3, dress=dress)
    folder = written(bundle, tmp_path)
    found = loaded(convert(folder, "ply", "hills"), "ply")
    tileset = bundle.manifest["tileset"]
    assert len(found.faces) == tileset["triangles"]
    along = CELLS * 2 ** (tileset["levels"] - 1) + 1
    assert len(found.vertices) == along**2  # each once, also on the borders of tiles
    x, z, height = found.vertices[:, 0], -found.vertices[:, 1], found.vertices[:, 2]
    np.testing.assert_allclose(height, hills(x, z), atol=10 * GRID_M)  # the floor slopes, and x and z are rounded, too
    if dress is not textured:
        np.testing.assert_allclose(found.visual.vertex_colors[:, 0], np.clip(255 * height / 1.2, 0, 255), atol=2)
    else:
        assert np.ptp(found.visual.vertex_colors[:, :3], axis=0).min() > 100  # the picture's quarters
    printed = loaded(convert(folder, "stl", "hills"), "stl")
    assert len(printed.faces) == len(found.faces)
    np.testing.assert_allclose(bounds(printed.vertices), bounds(found.vertices) * 1000, atol=1e-2)


def test_tiles_whose_texture_only_graphics_cards_read_get_the_coarse_wholes_colours(tmp_path: Path) -> None:
    def dress(mesh: Mesh) -> TexturedMesh:
        subject = textured(mesh)
        return TexturedMesh(subject.mesh, subject.uv, subject.jpeg, 64, ktx2=b"\xabKTX 20\xbb and so on")

    bundle, _ = hill_bundle(levels=2, dress=dress)
    folder = written(bundle, tmp_path)
    (tmp_path / "mesh.ply").write_bytes(ply_bytes(hill_tile(np.full(2, -6.0), 12.0, 48)))
    found = loaded(convert(folder, "ply", "hills"), "ply")
    shade = np.clip(255 * found.vertices[:, 2] / 1.2, 0, 255)
    assert np.abs(found.visual.vertex_colors[:, 0] - shade).mean() < 5
    (tmp_path / "tileset.json").write_bytes(b'{"root": {}}')
    with pytest.raises(ValueError, match="no tiles"):
        convert(folder, "ply", "hills")


def test_what_is_no_level_of_ours_is_told() -> None:
    whole = to_glb(SHEET)
    for data in (b"", b"glTF", whole[:100], whole.replace(b"POSITION", b"MISPLACE"), b"x" * 1000):
        with pytest.raises(ValueError):
            read_glb(data)


def test_glb_needs_no_extension_and_keeps_the_texture(tmp_path: Path) -> None:
    bundle = written(downloadable(), tmp_path)
    glb = Glb.of(convert(bundle, "glb", "sheet"))
    assert "extensionsRequired" not in glb.document
    assert glb.image == quarters()
    assert glb.document["materials"][0]["doubleSided"] is True
    np.testing.assert_allclose(bounds(glb.positions), bounds(SHEET.vertices), atol=GRID_M)
    assert convert(bundle, "glb-meshopt", "sheet") == bundle.read("lod0.glb")
    plain = written(downloadable(packing="float"), tmp_path / "archive")
    assert "EXT_meshopt_compression" in Glb.of(convert(plain, "glb-meshopt", "sheet")).document["extensionsRequired"]


def test_obj_has_its_texture_beside_it(tmp_path: Path) -> None:
    data = convert(written(downloadable(), tmp_path), "obj", "sheet")
    assert data == convert(written(downloadable(), tmp_path), "obj", "sheet")
    with zipfile.ZipFile(io.BytesIO(data)) as package:
        assert package.namelist() == ["sheet.obj", "sheet.mtl", "sheet.jpg"]
        assert package.read("sheet.jpg") == quarters()
        package.extractall(tmp_path / "obj")
    found = trimesh.load(tmp_path / "obj" / "sheet.obj", process=False)
    assert len(found.faces) == len(SHEET.faces)
    np.testing.assert_allclose(bounds(found.vertices), bounds(SHEET.vertices), atol=GRID_M)
    assert np.array(found.visual.material.image).shape == (64, 64, 3)
    # v runs up: the highest point has the largest v, in a picture that was projected from the front.
    assert found.visual.uv[found.vertices[:, 1].argmax(), 1] == pytest.approx(1, abs=1e-4)
    assert (np.linalg.norm(found.vertex_normals, axis=1) > 0.99).all()


def test_obj_without_a_texture_has_colours_at_its_vertices(tmp_path: Path) -> None:
    data = convert(written(downloadable(coloured()), tmp_path), "obj", "sheet")
    with zipfile.ZipFile(io.BytesIO(data)) as package:
        assert package.namelist() == ["sheet.obj", "sheet.mtl"]
        found = loaded(package.read("sheet.obj"), "obj")
    left = found.visual.vertex_colors[found.vertices[:, 0].argmin()]
    assert left[0] > left[2]


def test_ply_is_the_full_mesh_upright_in_metres(tmp_path: Path) -> None:
    found = loaded(convert(written(downloadable(), tmp_path), "ply", "sheet"), "ply")
    np.testing.assert_allclose(bounds(found.vertices), bounds(SHEET.vertices @ Z_UP.T), atol=1e-5)
    left = found.visual.vertex_colors[found.vertices[:, 0].argmin()]
    assert left[0] > left[2]


def test_the_full_mesh_of_a_survey_comes_back_from_where_its_file_has_it(tmp_path: Path) -> None:
    near, offset = downloadable(), np.array([345_678.25, 5_432_100.5, 321.0])
    far = {**near.files, "mesh.ply": ply_bytes(in_capture_frame(coloured()), offset=offset)}
    moved = replace(near, files=far, manifest={**near.manifest, "capture_offset": offset.tolist()})
    found = loaded(convert(written(moved, tmp_path), "ply", "sheet"), "ply")
    np.testing.assert_allclose(bounds(found.vertices), bounds(SHEET.vertices @ Z_UP.T), atol=1e-5)


@pytest.mark.parametrize("name", ["glb", "glb-meshopt"])
def test_a_glb_of_a_survey_says_where_it_stands(name: str, tmp_path: Path) -> None:
    near, offset = downloadable(), [345_678.25, 5_432_100.5, 321.0]
    placed = {"capture_offset": offset, "capture_crs": "EPSG:25832"}
    moved = replace(near, manifest={**near.manifest, **placed})
    data = convert(written(moved, tmp_path / "far"), name, "sheet")
    (length,) = struct.unpack_from("<I", data, 12)
    extras = json.loads(data[20 : 20 + length])["asset"]["extras"]
    assert extras == {**placed, "capture_to_asset": near.manifest["capture_to_asset"]}
    plain, found = read_glb(convert(written(near, tmp_path / "near"), name, "sheet")).mesh, read_glb(data).mesh
    assert isinstance(plain, TexturedMesh)
    assert isinstance(found, TexturedMesh)
    assert np.array_equal(found.mesh.vertices, plain.mesh.vertices)
    assert found.jpeg == plain.jpeg
    assert b"extras" not in convert(written(near, tmp_path / "again"), name, "sheet")[: 20 + length]


def test_stl_is_the_full_mesh_upright_in_millimetres(tmp_path: Path) -> None:
    found = loaded(convert(written(downloadable(), tmp_path), "stl", "sheet"), "stl")
    assert len(found.faces) == len(SHEET.faces)
    np.testing.assert_allclose(bounds(found.vertices), bounds(SHEET.vertices @ Z_UP.T) * 1000, atol=1e-2)


def test_a_texture_that_only_graphics_cards_read_gives_way_to_the_full_meshs_colours(tmp_path: Path) -> None:
    subject = textured()
    ktx2 = TexturedMesh(subject.mesh, subject.uv, subject.jpeg, 64, ktx2=b"\xabKTX 20\xbb and so on")
    bundle = written(downloadable(ktx2), tmp_path)
    found = read_glb(convert(bundle, "glb", "sheet")).mesh
    assert isinstance(found, Mesh)
    assert found.rgb is not None
    left = found.rgb[found.vertices[:, 0].argmin()]
    assert left[0] > left[2]


def test_splats_are_the_bundles_own_where_it_has_trained_ones(tmp_path: Path) -> None:
    own = cover_with_splats(coloured(), 50)
    trained = written(downloadable(splats_spz=to_spz(own)), tmp_path / "trained")
    assert convert(trained, "splats-spz", "sheet") == to_spz(own)
    assert len(Glb.of(convert(trained, "splats-glb", "sheet")).positions) == 50
    plain = written(downloadable(), tmp_path / "plain")
    covering = from_spz(convert(plain, "splats-spz", "sheet"))
    assert len(covering) == len(Glb.of(convert(plain, "splats-glb", "sheet")).positions) == MOST_SPLATS


def test_usdz_is_the_bundles_own_where_it_has_one(tmp_path: Path) -> None:
    assert convert(written(downloadable(asset_usdz=b"own"), tmp_path / "own"), "usdz", "sheet") == b"own"
    made = convert(written(downloadable(), tmp_path / "none"), "usdz", "sheet")
    with zipfile.ZipFile(io.BytesIO(made)) as package:
        assert package.namelist() == ["asset.usda", "colour.jpg"]


def test_usdz_of_a_level_too_large_for_a_colour_atlas_has_fewer_triangles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A preview made for the target `archive` has all triangles in its finest level, and no file for phones yet."""
    monkeypatch.setattr("capture2vr.edge.export.usdz.MOST_FACES", 100)
    monkeypatch.setattr("capture2vr.edge.export.colour_atlas.MOST_FACES", 100)
    made = convert(written(downloadable(coloured(), "float"), tmp_path), "usdz", "sheet")
    with zipfile.ZipFile(io.BytesIO(made)) as package:
        assert package.namelist() == ["asset.usda", "colour.jpg"]
