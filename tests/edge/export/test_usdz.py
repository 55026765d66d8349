"""What an iPhone opens: read back by the library that defines the format, and packed as it demands."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.export.colour_atlas import MOST_FACES, face_picture
from capture2vr.edge.export.shading import shaded
from capture2vr.edge.export.usdz import to_usdz
from capture2vr.edge.mesh.normals import split_flips, vertex_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.srgb import to_linear, to_srgb
from tests.referees.usd.reader import Reading, UsdCore
from tests.referees.usd.reader import usd_core as usd_core
from tests.support import surfaces
from tests.support.photos.painted import quarters

TRIANGLE = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
SHEET = surfaces.patch(lambda u, v: [u, v, 0.2 * np.sin(5 * u) * np.cos(4 * v)], 24, 24)
HALF_STEP_M = 0.51e-4


def twisted() -> Mesh:
    """A coarse Möbius strip whose ends share vertices: somewhere two faces wind against each other."""
    turn, across = np.repeat(np.linspace(0, 2 * np.pi, 24, endpoint=False), 2), np.tile([-0.4, 0.4], 24)
    radius = 1 + across * np.cos(turn / 2)
    vertices = np.stack([radius * np.cos(turn), radius * np.sin(turn), across * np.sin(turn / 2)], axis=1)
    low = np.arange(0, 48, 2)
    near, far = np.stack([low, low + 1], axis=1), np.stack([low + 2, low + 3], axis=1)
    far[-1] = 1, 0
    faces = np.concatenate([np.column_stack([near, far[:, 0]]), np.column_stack([near[:, 1], far[:, ::-1]])])
    return Mesh(vertices, faces)


def coloured(mesh: Mesh, seed: int = 0) -> Mesh:
    """Random colours of vertices."""
    return replace(mesh, rgb=np.random.default_rng(seed).integers(0, 256, (len(mesh.vertices), 3)).astype(np.uint8))


def wallpaper(mesh: Mesh) -> TexturedMesh:
    """The mesh with the quarters projected along Z, cut down the middle as an unwrapping would: two charts."""
    left = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] < 0
    faces = np.where(left[:, None], mesh.faces, mesh.faces + len(mesh.vertices))
    used, corners = np.unique(faces, return_inverse=True)
    vertices = np.concatenate([mesh.vertices] * 2)[used]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    across = (vertices - low)[:, :2] / (high - low)[:2]
    uv = np.stack([across[:, 0], 1 - across[:, 1]], axis=1)
    return TexturedMesh(Mesh(vertices, corners.reshape(-1, 3)), uv, quarters(), 64)


def read(usd_core: UsdCore, folder: Path, *subjects: Mesh | TexturedMesh) -> list[Reading]:
    files = [folder / f"{number}.usdz" for number in range(len(subjects))]
    for file, subject in zip(files, subjects, strict=True):
        file.write_bytes(to_usdz(subject))
    return usd_core(*files)


def entries(package: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(package)) as opened:
        return {entry.filename: opened.read(entry) for entry in opened.infolist()}


@pytest.mark.slow
def test_usd_core_finds_no_fault_and_the_same_surface(usd_core: UsdCore, tmp_path: Path) -> None:
    subjects = [SHEET, coloured(SHEET), twisted(), wallpaper(SHEET), TRIANGLE]
    for subject, found in zip(subjects, read(usd_core, tmp_path, *subjects), strict=True):
        given_mesh = subject.mesh if isinstance(subject, TexturedMesh) else subject
        drawn = given_mesh.faces[doubled_area(given_mesh) > 0]
        assert found.faults == []
        assert np.abs(found.points[found.corners] - given_mesh.vertices[drawn]).max() < HALF_STEP_M
        assert found.other["counts"] == [3] * len(drawn)
        assert np.allclose(found.other["extent"], [found.points.min(axis=0), found.points.max(axis=0)], atol=1e-6)
        assert np.allclose(np.linalg.norm(found.normals, axis=1), 1, atol=2e-3)
        assert len(found.normals) == len(found.points)


def doubled_area(mesh: Mesh) -> Floats:
    """(F,) of the faces as they are written, to a tenth of a millimetre."""
    a, b, c = np.moveaxis(np.round(mesh.vertices, 4)[mesh.faces], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def test_the_stage_says_metres_y_up_and_both_sides(usd_core: UsdCore, tmp_path: Path) -> None:
    (found,) = read(usd_core, tmp_path, TRIANGLE)
    told = found.other
    assert (told["root"], told["metres"], told["up"]) == ("Asset", 1.0, "Y")
    assert (told["double_sided"], told["subdivided"], told["normals_of"]) == (True, "none", "vertex")
    assert found.picture == b""
    assert told["grey"][0] == pytest.approx([0.6] * 3)


def test_normals_are_smooth_and_go_on_over_the_seams_of_a_picture(usd_core: UsdCore, tmp_path: Path) -> None:
    cut = wallpaper(SHEET)
    assert len(cut.mesh.vertices) > len(SHEET.vertices)
    wanted = {tuple(np.round(v, 4)): n for v, n in zip(SHEET.vertices, vertex_normals(SHEET), strict=True)}
    for found in read(usd_core, tmp_path, SHEET, cut):
        there = np.array([wanted[tuple(np.round(place, 4))] for place in found.points])
        assert np.abs(found.normals - there).max() < 2e-3


def test_a_mobius_strip_keeps_its_normals_across_the_seam() -> None:
    strip = twisted()
    assert len(split_flips(strip).vertices) > len(strip.vertices)
    assert np.allclose(shaded(strip).normals, vertex_normals(split_flips(strip)))
    as_textured = shaded(TexturedMesh(strip, np.zeros((len(strip.vertices), 2)), b"", 1))
    assert np.array_equal(as_textured.mesh.vertices[as_textured.mesh.faces], strip.vertices[strip.faces])
    assert as_textured.uv is not None
    assert len(as_textured.uv) == len(as_textured.normals) == len(as_textured.mesh.vertices)


def test_a_picture_goes_along_and_the_right_way_up(usd_core: UsdCore, tmp_path: Path) -> None:
    paper = wallpaper(SHEET)
    (found,) = read(usd_core, tmp_path, paper)
    assert found.picture == paper.jpeg
    assert found.other["st_of"] == "vertex"
    low, high = found.points.min(axis=0)[:2], found.points.max(axis=0)[:2]
    assert np.abs(found.st - (found.points[:, :2] - low) / (high - low)).max() < 2e-4  # v runs up, as y does


def test_colours_of_vertices_become_a_picture(usd_core: UsdCore, tmp_path: Path) -> None:
    sheet = coloured(SHEET)
    (found,) = read(usd_core, tmp_path, sheet)
    drawn = sheet.faces[doubled_area(sheet) > 0]
    assert found.other["st_of"] == "faceVarying"
    assert sheet.rgb is not None
    picture = np.asarray(Image.open(io.BytesIO(found.picture)))
    middle = found.st.reshape(-1, 3, 2).mean(axis=1) * [1, -1] + [0, 1]
    wanted = to_srgb(to_linear(sheet.rgb[drawn]).mean(axis=1))
    assert np.abs(looked_up(picture, middle) - wanted).mean() < 8


def looked_up(picture: Bytes, uv: Floats) -> Floats:
    """(N,3) as a graphics chip reads it: linear light of the four texels around, mixed; in sRGB codes."""
    side = len(picture)
    place = np.clip(uv * side - 0.5, 0, side - 1.001)
    whole = place.astype(int)
    (x, y), (right, down) = whole.T, (place - whole).T[:, :, None]
    light = to_linear(picture)
    upper = light[y, x] * (1 - right) + light[y, x + 1] * right
    lower = light[y + 1, x] * (1 - right) + light[y + 1, x + 1] * right
    return to_srgb(upper * (1 - down) + lower * down).astype(np.float64)


@given(count=st.integers(1, 70), seed=st.integers(0, 1000))
@settings(max_examples=30)
def test_every_place_of_a_face_finds_the_blend_of_its_corners(count: int, seed: int) -> None:
    """Smooth colours, as those of a surface are: a step of 255 between neighbours would test JPEG, not the layout."""
    rng = np.random.default_rng(seed)
    rgb = (rng.integers(30, 226, 3) + rng.integers(-25, 26, (3 * count, 3))).astype(np.uint8)
    mesh = Mesh(rng.normal(size=(3 * count, 3)), np.arange(3 * count).reshape(-1, 3), rgb)
    painted = face_picture(mesh)
    picture = np.asarray(Image.open(io.BytesIO(painted.jpeg)))
    # Many places of each face: of one alone, JPEG may err by more.
    face = np.repeat(np.arange(count), 50)
    bary = rng.dirichlet((0.7, 0.7, 0.7), size=len(face))
    uv = np.einsum("fc,fcx->fx", bary, painted.uv[face])
    wanted = to_srgb(np.einsum("fc,fcx->fx", bary, to_linear(rgb[mesh.faces[face]]))).astype(float)
    assert np.abs(looked_up(picture, uv) - wanted).mean() < 4
    assert ((painted.uv > 0) & (painted.uv < 1)).all()
    blocks = np.floor(painted.uv.reshape(count, -1) * len(picture) / 8).reshape(count, 3, 2)
    assert (blocks == blocks[:, :1]).all(), "a face lies in one block"
    assert len(np.unique(blocks[:, 0], axis=0)) == (count + 1) // 2, "two faces share one"


@pytest.mark.parametrize("subject", [TRIANGLE, coloured(SHEET), wallpaper(SHEET)])
def test_files_lie_uncompressed_on_multiples_of_64_bytes(subject: Mesh | TexturedMesh) -> None:
    package = to_usdz(subject)
    assert package == to_usdz(subject)
    with zipfile.ZipFile(io.BytesIO(package)) as opened:
        assert opened.testzip() is None
        infos = opened.infolist()
    assert infos[0].filename.endswith(".usda")
    for info in infos:
        name, extra = (int.from_bytes(package[info.header_offset + at :][:2], "little") for at in (26, 28))
        begins = info.header_offset + 30 + name + extra
        assert info.compress_type == zipfile.ZIP_STORED
        assert begins % 64 == 0
        assert package[begins : begins + info.file_size] == entries(package)[info.filename]


def test_the_judges_do_find_faults(usd_core: UsdCore, tmp_path: Path) -> None:
    files = entries(to_usdz(coloured(TRIANGLE)))
    scene = files["asset.usda"].decode()
    wrong = {
        "unaligned": files,
        "without its picture": {"asset.usda": files["asset.usda"]},
        "without its unit": files | {"asset.usda": scene.replace("metersPerUnit = 1", "").encode()},
    }
    for name, content in wrong.items():
        with zipfile.ZipFile(tmp_path / f"{name}.usdz", "w") as broken:
            for entry, data in content.items():
                broken.writestr(entry, data)
    told = [reading.faults for reading in usd_core(*(tmp_path / f"{name}.usdz" for name in wrong))]
    for said, fault in zip(told, ("Misalign", "Unresolvable", "metersPerUnit"), strict=True):
        assert any(fault in line for line in said), said


@pytest.mark.parametrize("size", [1e-9, 1e-3, 30.0, 1e12, 1e37])
def test_any_size_keeps_its_shape(usd_core: UsdCore, tmp_path: Path, size: float) -> None:
    sheet = surfaces.patch(lambda u, v: [u, v, u * v], 6, 6)
    (found,) = read(usd_core, tmp_path, replace(sheet, vertices=sheet.vertices * size))
    assert found.faults == []
    assert np.allclose(found.points / size, sheet.vertices, atol=1e-4)


def test_faces_without_an_area_and_vertices_without_a_face_are_left_out(usd_core: UsdCore, tmp_path: Path) -> None:
    sliver = Mesh(
        np.array([[9.0, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1e-6, 0]]), np.array([[1, 2, 3], [1, 2, 4]])
    )
    (found,) = read(usd_core, tmp_path, coloured(sliver))
    assert found.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert len(found.corners) == 1
    assert len(found.st) == 3


@pytest.mark.parametrize(
    ("vertices", "reason"),
    [
        (np.zeros((3, 3)), "none of the 1 triangles has an area"),
        (np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), "not a 32-bit float"),
        (np.array([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]]), "not a 32-bit float"),
        (np.array([[0, 0, 0], [1, 0, 0], [0, 4e38, 0]]), "not a 32-bit float"),
    ],
)
def test_what_cannot_be_shown_is_refused(vertices: Floats, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        to_usdz(Mesh(vertices, TRIANGLE.faces))


def test_no_faces_and_too_many_for_a_picture_are_refused() -> None:
    with pytest.raises(ValueError, match="none of the 0 triangles"):
        to_usdz(Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64)))
    many = Mesh(TRIANGLE.vertices, np.tile(TRIANGLE.faces, (MOST_FACES + 1, 1)))
    with pytest.raises(ValueError, match="use a coarser level"):
        face_picture(coloured(many))
    with pytest.raises(ValueError, match="without colours"):
        face_picture(TRIANGLE)
