"""Point clouds and meshes: what was written is what is read, whatever the file is called."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import tempfile
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from capture2vr.edge.capture.files import open_folder
from capture2vr.edge.clouds.meshes import read_mesh
from capture2vr.edge.clouds.pcd import lzf_decompress
from capture2vr.edge.clouds.sample_surface import SAMPLES, SampledSurface
from capture2vr.edge.clouds.tables import MAX_PARTED_POINTS
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.export.obj import to_obj_zip
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.read_capture import read_capture
from tests.support import captures, surfaces
from tests.support.patience import CANCEL_S

XYZ, RGB, NORMALS = captures.sphere()
BYTES = np.random.default_rng(1).integers(0, 256, (len(XYZ), 1))
FRACTIONS = np.random.default_rng(2).uniform(0, 20, (len(XYZ), 1))
SHADES = np.random.default_rng(3).integers(0, 200, (len(XYZ), 1)) + RGB // 8  # as in pictures: light, then colour
ORANGE = np.tile([[200, 100, 50]], (len(XYZ), 1))
UPWARD = np.tile([[0.0, 0.0, 1.0]], (len(XYZ), 1))


def rows(*columns: np.ndarray, separator: str = " ", head: str = "") -> bytes:
    table = np.hstack(columns).tolist()
    return (head + "\n".join(separator.join(f"{value:.9g}" for value in row) for row in table) + "\n").encode()


def stl_or_off(kind: str, data: bytes) -> SampledSurface:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / f"a.{kind}").write_bytes(data)
        (surface,) = read_mesh(open_folder(Path(folder)), f"a.{kind}", kind).surfaces
    return surface


CLOUDS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "PLY, ASCII": ("ply", lambda: captures.ply_bytes(XYZ, RGB, NORMALS, form="ascii")),
    "PLY, little endian": ("ply", lambda: captures.ply_bytes(XYZ, RGB, NORMALS)),
    "PLY, big endian": ("ply", lambda: captures.ply_bytes(XYZ, RGB, NORMALS, form="big")),
    "PCD, ASCII": ("pcd", lambda: captures.pcd_bytes(XYZ, RGB, NORMALS, form="ascii")),
    "PCD, binary": ("pcd", lambda: captures.pcd_bytes(XYZ, RGB, NORMALS)),
    "PCD, LZF": ("pcd", lambda: captures.pcd_bytes(XYZ, RGB, NORMALS, form="binary_compressed")),
    "text": ("xyz", lambda: rows(XYZ, RGB, NORMALS)),
    "text, normals first": ("xyz", lambda: rows(XYZ, NORMALS, RGB)),
    "CSV with names": ("xyz", lambda: rows(XYZ, RGB, NORMALS, separator=",", head="X,Y,Z,R,G,B,nx,ny,nz\n")),
    "semicolons": ("xyz", lambda: rows(XYZ, RGB, NORMALS, separator=";").replace(b".", b",")),
    "CloudCompare": ("xyz", lambda: rows(XYZ, RGB, NORMALS, head="//X Y Z R G B Nx Ny Nz\n")),
    "text, intensity between": ("xyz", lambda: rows(XYZ, RGB, FRACTIONS, NORMALS)),
    "text, intensity first": ("xyz", lambda: rows(XYZ, FRACTIONS, RGB, NORMALS)),
    "text, intensity last": ("xyz", lambda: rows(XYZ, NORMALS, RGB, FRACTIONS)),
    "text, a floor's normals": ("xyz", lambda: rows(XYZ, UPWARD, RGB)),
    "NumPy": ("npy", lambda: captures.npy_bytes(np.hstack([XYZ, RGB, NORMALS]))),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_points_colours_and_normals_come_back(name: str, tmp_path: Path) -> None:
    """Under a name that says nothing: the content decides."""
    kind, make = CLOUDS[name]
    (tmp_path / "upload.txt").write_bytes(make())
    capture = read_capture(tmp_path)
    assert (capture.kind, capture.format, capture.scale_confidence, capture.up) == ("points", kind, "unknown", None)
    cloud = capture.cloud
    assert cloud is not None
    assert cloud.rgb is not None
    assert cloud.normals is not None
    assert (cloud.xyz.dtype, cloud.rgb.dtype, cloud.normals.dtype) == (np.float64, np.uint8, np.float32)
    np.testing.assert_allclose(cloud.xyz, XYZ, atol=1e-6)
    np.testing.assert_array_equal(cloud.rgb, RGB)
    np.testing.assert_allclose(cloud.normals, UPWARD if "floor" in name else NORMALS, atol=1e-5)


TABLES: dict[str, tuple[np.ndarray, bytes]] = {
    "x y z r g b i": (RGB, rows(XYZ, RGB, FRACTIONS)),
    "x y z i r g b": (RGB, rows(XYZ, FRACTIONS, RGB)),
    "intensities of a laser scanner": (RGB, rows(XYZ, 16 * BYTES - 2048, RGB)),
    "one colour": (ORANGE, rows(XYZ, ORANGE, FRACTIONS)),
    "whole intensities last": (SHADES, rows(XYZ, SHADES, BYTES)),
    "whole intensities first": (SHADES, rows(XYZ, BYTES, SHADES)),
    "no intensities": (SHADES, rows(XYZ, 0 * BYTES, SHADES)),
    "nothing tells": (RGB, rows(XYZ, RGB, BYTES)),
    "nothing tells, .pts": (RGB, rows(XYZ, BYTES, RGB, head="500\n")),
    "whole intensities last, .pts": (SHADES, rows(XYZ, SHADES, BYTES, head="500\n")),
    "two more columns": (RGB, rows(XYZ, RGB, BYTES, FRACTIONS)),
    "two more columns, .pts": (ORANGE, rows(XYZ, ORANGE, BYTES, BYTES, head="500\n")),
    "five more columns": (RGB, rows(XYZ, RGB, *[FRACTIONS] * 5)),
    "colours that are not known": (np.where(RGB == 255, 0, RGB), rows(XYZ, np.where(RGB == 255, np.nan, RGB), BYTES)),
    "CloudCompare": (RGB, rows(XYZ, RGB, 4 * BYTES, head="//X Y Z R G B Intensity\n")),
    "CloudCompare, with the count": (RGB, rows(XYZ, RGB, BYTES, head="//X Y Z R G B Intensity\n500\n")),
    "CloudCompare, blanks in names": (RGB, rows(XYZ, BYTES, RGB, separator=";", head="//X;Y;Z;Scalar field;R;G;B\n")),
    "CloudCompare, fractions": (RGB, rows(XYZ, RGB / 255, FRACTIONS, head="//X Y Z Rf Gf Bf Intensity\n")),
    "NumPy's header": (RGB, rows(XYZ, BYTES, RGB, head="# a scan\n#\n# x, y, z, i, r, g, b\n")),
    "a sentence": (RGB, rows(XYZ, RGB, FRACTIONS, head="# x y z are in metres, r g b are bytes\n")),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_tables_colours_are_told_from_its_intensities(name: str, tmp_path: Path) -> None:
    expected, data = TABLES[name]
    (tmp_path / "scan.txt").write_bytes(data)
    cloud = read_capture(tmp_path / "scan.txt").cloud
    assert cloud is not None
    np.testing.assert_allclose(cloud.xyz, XYZ, atol=1e-6)
    np.testing.assert_array_equal(cloud.rgb, expected)


@pytest.mark.slow
@given(
    names=st.permutations(["x", "y", "z", "r", "g", "b", "Intensity", "GpsTime"]),
    mark=st.sampled_from(["//", "# ", "#", ""]),
    separator=st.sampled_from([" ", ",", ";", "\t", ", "]),
)
def test_a_header_names_the_columns_in_any_order(names: list[str], mark: str, separator: str) -> None:
    columns = {**dict(zip("xyz", XYZ.T, strict=True)), **dict(zip("rgb", RGB.T, strict=True))}
    table = np.stack([columns.get(name, BYTES[:, 0]) for name in names], axis=1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.txt"
        path.write_bytes(rows(table, separator=separator, head=f"{mark}{separator.join(names)}\n"))
        cloud = read_capture(path).cloud
    assert cloud is not None
    np.testing.assert_allclose(cloud.xyz, XYZ, atol=1e-6)
    np.testing.assert_array_equal(cloud.rgb, RGB)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_is_z_up_and_keeps_its_colours(suffix: str, tmp_path: Path) -> None:
    captures.save_las(tmp_path / f"scan{suffix}", XYZ, RGB)
    capture = read_capture(tmp_path / f"scan{suffix}")
    assert capture.cloud is not None
    assert capture.format == "las"
    np.testing.assert_array_equal(capture.up, [0, 0, 1])
    np.testing.assert_allclose(capture.cloud.xyz, XYZ, atol=1e-4)
    np.testing.assert_array_equal(capture.cloud.rgb, RGB)


def test_a_cancel_is_heard_while_a_laz_is_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    captures.save_las(tmp_path / "scan.laz", XYZ, RGB)
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))

    def cancel(_: float) -> None:
        raise Cancelled

    began = time.monotonic()
    with pytest.raises(Cancelled):
        read_capture(tmp_path / "scan.laz", tick=cancel)
    assert time.monotonic() - began < CANCEL_S
    assert list((tmp_path / "scratch").iterdir()) == []


def test_georeferenced_las_is_moved_near_the_origin(tmp_path: Path) -> None:
    far = np.array([691_000.0, 5_336_000.0, 500.0])
    captures.save_las(tmp_path / "utm.las", XYZ + far, RGB)
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert np.abs(capture.cloud.xyz).max() < 10
    assert "georeferenced" in capture.warnings[0]
    np.testing.assert_allclose(np.ptp(capture.cloud.xyz, axis=0), np.ptp(XYZ, axis=0), atol=3e-4)


def _obj(xyz: np.ndarray, faces: np.ndarray) -> bytes:
    corners = (" ".join(f"{value:.4f}" for value in row) for row in xyz.tolist())
    triangles = (" ".join(map(str, row)) for row in (faces + 1).tolist())
    return "".join([*(f"v {row}\n" for row in corners), *(f"f {row}\n" for row in triangles)]).encode()


def _npy(xyz: np.ndarray) -> bytes:
    np.save(made := io.BytesIO(), xyz)
    return made.getvalue()


FAR: dict[str, Callable[[np.ndarray, np.ndarray], bytes]] = {
    "scan.xyz": lambda xyz, faces: rows(xyz),
    "scan.npy": lambda xyz, faces: _npy(xyz),
    "points.obj": lambda xyz, faces: _obj(xyz, faces[:0]),
    "mesh.obj": _obj,
}


@pytest.mark.parametrize("far", [(530_123.0, 180_456.0, 20.0), (691_000.0, 5_336_000.0, 500.0), (-2e4, 0.0, 0.0)])
@pytest.mark.parametrize("name", FAR)
def test_georeferenced_coordinates_of_any_format_are_moved_near_the_origin(
    name: str, far: tuple[float, float, float], tmp_path: Path
) -> None:
    sheet = surfaces.patch(lambda u, v: [u, v, 0.2 * np.sin(4 * u)], 40, 30)
    (tmp_path / name).write_bytes(FAR[name](sheet.vertices + np.array(far), sheet.faces))
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert np.abs(capture.cloud.xyz).max() < 10
    assert "georeferenced" in capture.warnings[0]
    np.testing.assert_allclose(np.ptp(capture.cloud.xyz, axis=0), np.ptp(sheet.vertices, axis=0), atol=0.02)


def test_stray_points_and_large_things_in_millimetres_are_not_georeferenced(tmp_path: Path) -> None:
    house = XYZ * 20_000.0 / np.ptp(XYZ, axis=0).max()
    for xyz in (house, np.vstack([XYZ, [[4e5, 0, 0], [0, -9e5, 0]]])):
        np.savetxt(tmp_path / "scan.xyz", xyz, fmt="%.5f")
        capture = read_capture(tmp_path)
        assert capture.cloud is not None
        np.testing.assert_allclose(capture.cloud.xyz, xyz, atol=1e-4)
        assert not any("georeferenced" in warning for warning in capture.warnings)


def test_empty_pixels_of_an_organised_pcd_are_no_fault(tmp_path: Path) -> None:
    holes = XYZ.copy()
    holes[::2] = np.nan
    (tmp_path / "kinect.pcd").write_bytes(captures.pcd_bytes(holes, RGB, NORMALS, height=20))
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert len(capture.cloud.xyz) == len(XYZ) // 2
    np.testing.assert_array_equal(capture.cloud.rgb, RGB[1::2])


def test_a_few_bad_points_are_dropped_with_a_warning(tmp_path: Path) -> None:
    bad = XYZ.copy()
    bad[:10, 1], bad[10:20, 2] = np.nan, 1e30
    (tmp_path / "scan.ply").write_bytes(captures.ply_bytes(bad, RGB))
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert len(capture.cloud.xyz) == len(XYZ) - 20
    np.testing.assert_array_equal(capture.cloud.rgb, RGB[20:])
    assert "20 of 500" in capture.warnings[0]


@given(data=st.binary(max_size=600) | st.lists(st.sampled_from([b"abc", b"abcabcabc", b"\0" * 300])).map(b"".join))
def test_lzf_round_trip(data: bytes) -> None:
    assert lzf_decompress(captures.lzf_compress(data), len(data)) == data


def test_several_clouds_read_the_largest_and_say_so(tmp_path: Path) -> None:
    (tmp_path / "small.ply").write_bytes(captures.ply_bytes(XYZ[:200]))
    (tmp_path / "large.ply").write_bytes(captures.ply_bytes(XYZ))
    (tmp_path / "LICENCE-LICENSE").write_text("Permission is hereby granted\n")
    (tmp_path / "SOURCE.json").write_text('{"repo": "nowhere"}')
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert len(capture.cloud.xyz) == len(XYZ)
    assert "small.ply" in capture.warnings[0]


@pytest.mark.parametrize("kind", ["obj", "off", "stl", "glb", "ply"])
def test_a_mesh_is_sampled_evenly_on_its_surface(kind: str, tmp_path: Path) -> None:
    (tmp_path / "upload.bin").write_bytes(captures.as_bytes(captures.hemisphere().export(file_type=kind)))
    capture = read_capture(tmp_path)
    cloud = capture.cloud
    assert cloud is not None
    assert capture.format == kind
    assert cloud.xyz.shape == (SAMPLES, 3)
    lengths = np.linalg.norm(cloud.xyz, axis=1)
    assert lengths.max() <= 1 + 1e-6
    assert lengths.min() > 0.98  # the flat triangles lie that far inside the sphere
    assert cloud.xyz[:, 1].mean() == pytest.approx(0.5, abs=0.02)  # Archimedes: height is uniform on a sphere
    assert cloud.normals is not None
    assert np.abs((cloud.normals * cloud.xyz / lengths[:, None]).sum(1)).min() > 0.98
    metric = ("metric", [0, 1, 0]) if kind == "glb" else ("unknown", None)
    assert (capture.scale_confidence, None if capture.up is None else capture.up.tolist()) == metric


@pytest.mark.parametrize("spelt", [str.lower, str.upper, str.title])
@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("name", ["", "vertex 1 2 3", "facet normal", "endsolid"])
def test_an_stl_of_text_may_be_spelt_in_any_way(spelt: Callable[[str], str], ends: str, name: str) -> None:
    """And its solids, of which it may have several, may be called anything."""
    text = "".join(
        f"solid {name}\nfacet normal 0 0 1\n outer loop\n  vertex {at} 0 0\n\tvertex 1e0 {at}  2.5\n"
        f"  vertex 0 1 -1.5E+1\n endloop\nendfacet\nendsolid {name}\n"
        for at in (1, 3)
    )
    found = stl_or_off("stl", spelt(text).replace("\n", ends).encode())
    expected = [[(at, 0, 0), (1, at, 2.5), (0, 1, -15)] for at in (1, 3)]
    np.testing.assert_array_equal(found.vertices[found.faces], expected)


@pytest.mark.parametrize("head", [b"solid", b"solid facet normal", b"made by hand", b""])
@pytest.mark.parametrize("tail", [0, 2, 37])
def test_a_binary_stl_is_one_whatever_its_head_says(head: bytes, tail: int, tmp_path: Path) -> None:
    facets = np.asarray(captures.hemisphere().triangles, "<f4")
    records = b"".join(bytes(12) + facet.tobytes() + b"\0\0" for facet in facets)
    (tmp_path / "a.stl").write_bytes(head.ljust(80) + struct.pack("<I", len(facets)) + records + b" " * tail)
    capture = read_capture(tmp_path)
    assert (capture.format, capture.cloud is not None) == ("stl", True)


OFFS = {
    "counts below": "OFF\n{counts}\n{rows}",
    "counts beside": "OFF {counts}\n{rows}",
    "remarks": "OFF # a mesh\n\n# of\n{counts} # and edges\n{rows}",
}


@pytest.mark.parametrize("way", OFFS)
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
@pytest.mark.parametrize("colours", ["none", "faces", "fractions", "vertices"])
def test_polygons_of_an_off_are_cut_as_they_lie(way: str, ends: str, colours: str) -> None:
    """An L, whose notch is no part of it, and a triangle beside it."""
    tints = ["10 20 30 255", "40 50 60 255"]
    corners = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (5, 0), (6, 0), (5, 1)]
    behind = {"faces": tints, "fractions": ["0.5 0.25 1.0", "0.1 0.2 0.3"]}.get(colours, ["", ""])
    rows = [f"{x} {y} 0.5 {tints[x >= 5] if colours == 'vertices' else ''}" for x, y in corners]
    rows += [f"6 0 1 2 3 4 5 {behind[0]}", f"3 6 7 8 {behind[1]}"]
    text = OFFS[way].format(counts="9 2 0", rows="\n".join(rows)) + "\n"
    found = stl_or_off("off", ("C" * (colours == "vertices") + text).replace("\n", ends).encode())
    triangles = found.vertices[found.faces]
    areas = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])[:, 2] / 2
    assert areas.min() >= 0
    assert areas.sum() == pytest.approx(3.5)
    middles = triangles.mean(axis=1)
    assert not ((middles[:, 0] > 1) & (middles[:, 1] > 1)).any()
    assert (found.colour_at is None) == (colours == "none")
    if found.colour_at is not None:
        shown = found.colour_at(np.arange(len(triangles)), np.full((len(triangles), 3), 1 / 3))
        first, second = ((128, 64, 255), (26, 51, 76)) if colours == "fractions" else ((10, 20, 30), (40, 50, 60))
        np.testing.assert_allclose(shown, np.where(middles[:, :1] < 3, first, second), atol=1)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n", "cut off"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", "vertices that do not exist"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "vertices that do not exist"),
        ("OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "not a readable OFF"),
        ("OFF\n3 1 0\n0.0000 0.0000 0.000000000\n", "3 'OFF' lines, but only 1"),
        ("OFF\n-3 9 0\n" + 30 * "0 0 0\n", "not a readable OFF"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 " + 2**19 * "0 ", "has a line of"),
        ("OFF BINARY\n3 1 0\n0 0 0\n", "not a readable OFF"),
    ],
)
def test_a_damaged_off_is_named(text: str, says: str) -> None:
    with pytest.raises(CaptureError, match=says):
        stl_or_off("off", text.encode())


def test_lines_behind_those_of_an_off_take_no_memory() -> None:
    data = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n" + 1_000_000 * b"7 7\n"
    tracemalloc.start()
    assert len(stl_or_off("off", data).faces) == 1
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 3 * len(data)


def test_sampling_is_repeatable(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(captures.as_bytes(captures.hemisphere().export(file_type="glb")))
    first, second = read_capture(tmp_path).cloud, read_capture(tmp_path).cloud
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.xyz, second.xyz)


def test_quads_and_triangles_mix_in_one_ply(tmp_path: Path) -> None:
    """Two quads and a triangle of areas 1, 1 and 1/2; a fifth of the points lies on the triangle."""
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 7\nproperty double x\nproperty double y\n"
        "property double z\nelement face 3\nproperty list uchar int vertex_indices\nend_header\n"
    )
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [3, 0, 0]], np.float64)
    faces = b"".join(
        bytes([len(face)]) + np.array(face, "<i4").tobytes() for face in ([0, 1, 2, 3], [1, 4, 5, 2], [4, 6, 5])
    )
    (tmp_path / "mixed.ply").write_bytes(head.encode() + corners.tobytes() + faces)
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    assert np.mean(cloud.xyz[:, 0] > 2) == pytest.approx(0.2, abs=0.01)
    assert np.mean(cloud.xyz[:, 0] < 1) == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize("strips", [2, 0])
def test_lists_between_vertices_and_faces_are_skipped(tmp_path: Path, strips: int) -> None:
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty double x\nproperty double y\n"
        f"property double z\nelement tristrips {strips}\nproperty list int int vertex_indices\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float64)
    between = b"".join(np.array([length, *range(length)], "<i4").tobytes() for length in (3, 2)[:strips])
    face = b"\3" + np.array([0, 1, 2], "<i4").tobytes()
    (tmp_path / "strips.ply").write_bytes(head.encode() + corners.tobytes() + between + face)
    cloud = read_capture(tmp_path / "strips.ply").cloud
    assert cloud is not None
    assert len(cloud.xyz) > 1_000, "points on the triangle, not its three corners"
    assert (cloud.xyz[:, :2].sum(axis=1) <= 1 + 1e-9).all()


def test_a_texture_colours_the_points_of_its_surface(tmp_path: Path) -> None:
    """A unit square whose picture is red on the left, blue on the right, green along the upper edge."""
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:, :32, 0], pixels[:, 32:, 2] = 255, 255
    pixels[:8] = [0, 255, 0]
    Image.fromarray(pixels).save(tmp_path / "paint.png")
    (tmp_path / "square.mtl").write_text("newmtl paint\nKd 1 1 1\nmap_Kd paint.png\n")
    (tmp_path / "square.obj").write_text(
        "mtllib square.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl paint\n"
        "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    for name in ("square.obj", "square.glb"):
        scene = trimesh.load(tmp_path / "square.obj", process=False)
        if name.endswith(".glb"):
            (tmp_path / name).write_bytes(captures.as_bytes(scene.export(file_type="glb")))
        cloud = read_capture(tmp_path / name).cloud
        assert cloud is not None
        assert cloud.rgb is not None
        x, y = cloud.xyz[:, 0], cloud.xyz[:, 1]
        inner = (np.abs(x - 0.5) > 0.03) & (np.abs(y - 0.875) > 0.03)
        expected = np.where(x[:, None] < 0.5, [255, 0, 0], [0, 0, 255])
        expected[y > 0.875] = [0, 255, 0]
        np.testing.assert_array_equal(cloud.rgb[inner], expected[inner])


def test_vertex_colours_are_interpolated(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    mesh.visual.vertex_colors = [[0, 0, 0, 255], [255, 0, 0, 255], [0, 255, 0, 255]]
    (tmp_path / "t.ply").write_bytes(captures.as_bytes(mesh.export(file_type="ply")))
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    assert cloud.rgb is not None
    np.testing.assert_allclose(cloud.rgb[:, :2], 255 * cloud.xyz[:, :2], atol=1)


def test_a_cloud_with_a_stray_face_stays_a_cloud(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(XYZ, [[0, 1, 2]], process=False)
    (tmp_path / "t.ply").write_bytes(captures.as_bytes(mesh.export(file_type="ply")))
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    np.testing.assert_allclose(cloud.xyz, XYZ, atol=1e-6)


def test_nothing_heavy_is_imported_before_it_is_needed() -> None:
    code = "import sys, capture2vr.edge.capture; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"cv2", "av", "trimesh", "laspy", "scipy", "lzfse", "PIL"} & set(loaded)


def test_an_obj_without_faces_is_a_cloud(tmp_path: Path) -> None:
    (tmp_path / "points.obj").write_text("\n".join(f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in XYZ))
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    np.testing.assert_allclose(cloud.xyz, XYZ, atol=1e-6)


@pytest.mark.parametrize("scale", [1, 255])
def test_an_obj_without_faces_has_the_colours_of_its_points(scale: int, tmp_path: Path) -> None:
    """As fractions, and as bytes."""
    (tmp_path / "points.obj").write_bytes(
        b"v " + rows(XYZ, RGB / (255 / scale)).strip().replace(b"\n", b"\nv ") + b"\n"
    )
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    np.testing.assert_array_equal(cloud.rgb, RGB)


def test_a_vertex_coloured_obj_download_reads_back(tmp_path: Path) -> None:
    """Beside its material, whose colour is white."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    rgb = np.tile(np.array([200, 128, 64], np.uint8), (len(ball.vertices), 1))
    with zipfile.ZipFile(io.BytesIO(to_obj_zip(Mesh(ball.vertices, ball.faces, rgb), "scan"))) as archive:
        archive.extractall(tmp_path)
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    assert cloud.rgb is not None
    assert (cloud.rgb == rgb[0]).all()


def test_a_material_colours_an_obj_whose_vertices_are_white(tmp_path: Path) -> None:
    (tmp_path / "scan.mtl").write_text("newmtl paint\nKd 1 0 0\n")
    corners = "v 0 0 0 1 1 1\nv 1 0 0 1 1 1\nv 0 1 0 1 1 1\n"
    (tmp_path / "scan.obj").write_text(f"mtllib scan.mtl\n{corners}usemtl paint\nf 1 2 3\n")
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    assert cloud.rgb is not None
    assert (cloud.rgb == (255, 0, 0)).all()


@pytest.mark.parametrize("form", ["ascii", "little"])
def test_splats_that_can_be_seen_are_points_of_their_colour(form: str, tmp_path: Path) -> None:
    opacity = np.where(np.arange(len(XYZ)) % 3 == 0, 0.09, 0.11)
    (tmp_path / "scan.ply").write_bytes(captures.splat_ply_bytes(XYZ, RGB, opacity, form=form))
    capture = read_capture(tmp_path)
    cloud = capture.cloud
    assert cloud is not None
    np.testing.assert_array_equal(cloud.xyz, XYZ[opacity > 0.1])
    np.testing.assert_array_equal(cloud.rgb, RGB[opacity > 0.1])
    assert cloud.normals is None, "the file's are zeros"
    (warning,) = capture.warnings
    assert warning.startswith("scan.ply: holds Gaussian splats; the centres")


def test_splats_that_cannot_be_seen_are_no_capture(tmp_path: Path) -> None:
    (tmp_path / "scan.ply").write_bytes(captures.splat_ply_bytes(XYZ, RGB, np.full(len(XYZ), 0.01)))
    with pytest.raises(CaptureError, match="has only 0 points") as caught:
        read_capture(tmp_path)
    assert caught.value.code == "CAPTURE_TOO_FEW_POINTS"


def test_a_texture_of_a_ply_is_named_as_it_is_not_read(tmp_path: Path) -> None:
    """As MeshLab writes it: texture coordinates for the corners of every face."""
    (tmp_path / "scan.ply").write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile my scan.jpg\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0 0 1 0 0 1\n"
    )
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert capture.cloud.rgb is None
    (warning,) = capture.warnings
    assert warning.startswith("scan.ply: its texture 'my scan.jpg' is not read, and the mesh has no colours: export")


def test_the_limit_of_points_is_named(tmp_path: Path) -> None:
    """A sparse file of the right length costs no disk and is refused by its header."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {MAX_PARTED_POINTS + 1}\n"
    head += "property float x\nproperty float y\nproperty float z\nend_header\n"
    with (tmp_path / "huge.ply").open("wb") as stream:
        stream.write(head.encode())
        stream.truncate(len(head) + 12 * (MAX_PARTED_POINTS + 1))
    with pytest.raises(Exception, match="200,000,001 points") as caught:
        read_capture(tmp_path)
    assert caught.value.code == "CAPTURE_TOO_LARGE"  # type: ignore[attr-defined]
