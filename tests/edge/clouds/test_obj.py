"""OBJ files as programs write them: polygons, relative indices, options and foreign paths of textures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.files import open_folder
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.clouds.obj import ObjFile, read_obj
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.srgb import to_linear
from tests.support.photos.exr_files import exr

HEAD = "mtllib a.mtl\nusemtl paint\n"
CORNERS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
TEXELS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
SQUARES = {
    "triangles": HEAD + CORNERS + TEXELS + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n",
    "a quad": HEAD + CORNERS + TEXELS + "f 1/1 2/2 3/3 4/4\n",
    "a quad with normals": HEAD + CORNERS + TEXELS + "vn 0 0 1\nf 1/1/1 2/2/1 3/3/1 4/4/1\n",
    "a triangle and a polygon": HEAD
    + CORNERS
    + "v .5 .5 0\n"
    + TEXELS
    + "vt .5 .5\nf 1/1 2/2 5/5\nf 5/5 2/2 3/3 4/4 1/1\n",
    "relative indices": HEAD + CORNERS + TEXELS + "f -4/-4 -3/-3 -2/-2 -1/-1\n",
    "an object in halves": HEAD
    + "o left\nv 0 0 0\nv .5 0 0\nv .5 1 0\nv 0 1 0\nvt 0 0\nvt .5 0\nvt .5 1\nvt 0 1\nf -4/-4 -3/-3 -2/-2 -1/-1\n"
    + "o right\nv .5 0 0\nv 1 0 0\nv 1 1 0\nv .5 1 0\nvt .5 0\nvt 1 0\nvt 1 1\nvt .5 1\nf 5/5 6/6 7/7 8/8\n",
    "tabs, margins and comments": ("# made by hand\n" + HEAD + CORNERS + TEXELS + "f 1/1 2/2 3/3 4/4 # all of it\n")
    .replace(" ", "\t")
    .replace("\nv", "\n  v"),
    "a line that goes on": HEAD + CORNERS + TEXELS + "f 1/1 2/2 \\\n3/3 4/4\n",
    "lines of Windows": (HEAD + CORNERS + TEXELS + "f 1/1 2/2 \\\n3/3 4/4\n").replace("\n", "\r\n"),
    "lines of an old Mac": (HEAD + CORNERS + TEXELS + "f 1/1 2/2 \\\n3/3 4/4\n").replace("\n", "\r"),
    "lines and points beside it": HEAD + CORNERS + TEXELS + "p 1\nl 1 2\nf 1/1 2/2 3/3 4/4\n",
    "homogeneous coordinates": HEAD
    + CORNERS.replace(" 0\n", " 0 1.0\n")
    + TEXELS.replace("\n", " 0\n")
    + "f 1/1 2/2 3/3 4/4\n",
}
RED, BLUE = (255, 0, 0), (0, 0, 255)


def paint(path: Path) -> None:
    """Write a picture that is red on the left and blue on the right."""
    pixels = np.zeros((8, 64, 3), np.uint8)
    pixels[:, :32, 0], pixels[:, 32:, 2] = 255, 255
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def read(folder: Path, text: str, materials: str = "newmtl paint\nKd 0 1 0\nmap_Kd paint.png\n") -> Capture:
    (folder / "a.obj").write_bytes(text.encode())
    (folder / "a.mtl").write_text(materials)
    return read_capture(folder)


def points(capture: Capture) -> tuple[Floats, Bytes]:
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    return capture.cloud.xyz, capture.cloud.rgb


def parse(folder: Path, text: str) -> ObjFile:
    (folder / "a.obj").write_text(text)
    return read_obj(open_folder(folder), "a.obj")


def corners_of(obj: ObjFile) -> Floats:
    assert obj.surface is not None
    return np.asarray(obj.surface.vertices[obj.surface.faces])


@pytest.mark.parametrize("text", SQUARES.values(), ids=list(SQUARES))
def test_a_textured_square_is_read_however_it_is_written(text: str, tmp_path: Path) -> None:
    paint(tmp_path / "paint.png")
    xyz, rgb = points(read(tmp_path, text))
    np.testing.assert_allclose(xyz.min(axis=0), [0, 0, 0], atol=0.01)
    np.testing.assert_allclose(xyz.max(axis=0), [1, 1, 0], atol=0.01)
    inner = np.abs(xyz[:, 0] - 0.5) > 0.02
    np.testing.assert_array_equal(rgb[inner], np.where(xyz[inner, :1] < 0.5, RED, BLUE))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("written", "file"),
    [
        ("-s 1 1 1 -o 0 0 0 paint.png", "paint.png"),
        ("-clamp on -bm 0.5 paint.png", "paint.png"),
        ("-mm 0 1 2.png", "2.png"),
        ("my paint.png", "my paint.png"),
        ('"paint.png"', "paint.png"),
        (r"C:\Users\me\Desktop\paint.png", "paint.png"),
        ("/home/me/paint.png", "textures/paint.png"),
        (r"textures\paint.png", "textures/paint.png"),
        ("textures/paint.png", "paint.png"),
        ("../paint.png", "paint.png"),
        ("Paint.PNG", "paint.png"),
    ],
)
def test_a_texture_is_found_by_its_name(written: str, file: str, tmp_path: Path) -> None:
    paint(tmp_path / file)
    capture = read(tmp_path, SQUARES["a quad"], f"newmtl paint\nmap_Kd {written}\n")
    assert {tuple(colour) for colour in points(capture)[1].tolist()} == {RED, BLUE}
    assert capture.warnings == ()


def test_a_texture_is_repeated_and_moved_as_its_options_say(tmp_path: Path) -> None:
    paint(tmp_path / "paint.png")
    capture = read(tmp_path, SQUARES["a quad"], "newmtl paint\nmap_Kd -s 2 1 -o 0.5 paint.png\n")
    xyz, rgb = points(capture)
    phase = (2 * xyz[:, 0] + 0.5) % 1
    inner = (np.abs(phase - 0.5) > 0.04) & (np.abs(phase - 0.5) < 0.46)
    np.testing.assert_array_equal(rgb[inner], np.where(phase[inner, None] < 0.5, RED, BLUE))


def test_a_texture_that_is_not_there_is_named(tmp_path: Path) -> None:
    capture = read(tmp_path, SQUARES["a quad"])
    assert (points(capture)[1] == (0, 255, 0)).all(), "the material's colour"
    (warning,) = capture.warnings
    assert warning.startswith("a.obj: its textures are not in the capture, so their colours are missing (paint.png)")


def test_a_texture_of_linear_light_is_read(tmp_path: Path) -> None:
    light = np.zeros((8, 64), np.float32)
    light[:, :32] = to_linear(np.uint8(180))
    dark = 0 * light
    (tmp_path / "paint.exr").write_bytes(exr({"R": light, "G": dark, "B": dark}))
    capture = read(tmp_path, SQUARES["a quad"], "newmtl paint\nmap_Kd paint.exr\n")
    assert {tuple(colour) for colour in points(capture)[1].tolist()} == {(180, 0, 0), (0, 0, 0)}
    assert capture.warnings == ()


def test_a_texture_of_a_kind_that_is_not_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "paint.exr").write_bytes(exr({"Y": np.ones((8, 8), np.float32)}, 4))
    with pytest.raises(CaptureError, match=r"paint\.exr: is an OpenEXR picture of a kind that is not read \(PIZ\)"):
        read(tmp_path, SQUARES["a quad"], "newmtl paint\nmap_Kd paint.exr\n")


def test_a_picture_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "paint.png").write_bytes(b"no picture")
    with pytest.raises(CaptureError, match=r"paint\.png: is not a readable picture") as caught:
        read(tmp_path, SQUARES["a quad"])
    assert caught.value.code == "CAPTURE_UNREADABLE"


@pytest.mark.slow
@pytest.mark.parametrize("library", ["a.mtl", r"D:\scans\a.mtl", "renamed.mtl", "./a.mtl", "missing.mtl a.mtl"])
def test_the_materials_are_found(library: str, tmp_path: Path) -> None:
    paint(tmp_path / "paint.png")
    capture = read(tmp_path, SQUARES["a quad"].replace("a.mtl", library))
    assert {tuple(colour) for colour in points(capture)[1].tolist()} == {RED, BLUE}


def test_each_part_has_its_own_material(tmp_path: Path) -> None:
    """A texture, a colour, a name that no library has."""
    paint(tmp_path / "paint.png")
    strips = [f"v {x} 0 0\nv {x + 1} 0 0\nv {x + 1} 1 0\nv {x} 1 0\n{TEXELS}" for x in range(3)]
    faces = "f -4/-4 -3/-3 -2/-2 -1/-1\n"
    used = "".join(
        f"{strip}usemtl {name}\n{faces}" for strip, name in zip(strips, ("paint", "plain", "gone"), strict=True)
    )
    materials = "newmtl paint\nmap_Kd paint.png\nnewmtl plain\nKd 0 .5 1\n"
    xyz, rgb = points(read(tmp_path, "mtllib a.mtl\n" + used, materials))
    x = xyz[:, 0]
    assert {tuple(colour) for colour in rgb[x < 0.99].tolist()} == {RED, BLUE}
    assert (rgb[(x > 1.01) & (x < 1.99)] == (0, 128, 255)).all()
    assert (rgb[x > 2.01] == 255).all()


@given(st.lists(st.sets(st.integers(0, 5), min_size=3), min_size=1, max_size=8), st.integers(1, 4))
def test_relative_indices_are_those_before_the_face(chosen: list[set[int]], blocks: int) -> None:
    """The same faces with absolute and with relative indices, in blocks of six vertices with their faces behind."""
    import tempfile

    polygons = [sorted(each) for each in chosen]  # on a parabola: they are convex
    absolute, relative, triangles = [], [], []
    for block in range(blocks):
        rows = [f"v {block} {corner} {corner * corner}" for corner in range(6)]
        absolute += rows
        relative += rows
        for polygon in polygons:
            absolute.append("f " + " ".join(str(6 * block + corner + 1) for corner in polygon))
            relative.append("f " + " ".join(str(corner - 6) for corner in polygon))
            fan = [(polygon[0], polygon[at], polygon[at + 1]) for at in range(1, len(polygon) - 1)]
            triangles += [[(block, corner, corner * corner) for corner in corners] for corners in fan]
    with tempfile.TemporaryDirectory() as folder:
        for lines in (absolute, relative):
            np.testing.assert_array_equal(corners_of(parse(Path(folder), "\n".join(lines))), triangles)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-8-sig"])
def test_a_text_of_any_encoding_is_read(encoding: str, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(("# Würfel\n" + CORNERS + "f 1 2 3\n").encode(encoding))
    found = read_obj(open_folder(tmp_path), "a.obj")
    assert len(found.vertices.xyz) == CORNERS.count("v ")


@pytest.mark.parametrize("coloured", [[True] * 3, [True, False, True], [False, True, True], [False] * 3])
def test_some_vertices_may_have_colours(coloured: list[bool], tmp_path: Path) -> None:
    """The others take the mean of these."""
    colours = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.2, 0.8)]
    rows = [
        f"v {number} {number % 2} 0" + (f" {r} {g} {b}" if there else "")
        for number, ((r, g, b), there) in enumerate(zip(colours, coloured, strict=True))
    ]
    found = parse(tmp_path, "\n".join([*rows, "f 1 2 3"])).vertices
    np.testing.assert_array_equal(found.xyz, [[0, 0, 0], [1, 1, 0], [2, 0, 0]])
    if not any(coloured):
        assert found.rgb is None
        return
    known = np.array([colour for colour, there in zip(colours, coloured, strict=True) if there])
    truth = [colour if there else known.mean(axis=0) for colour, there in zip(colours, coloured, strict=True)]
    assert found.rgb is not None
    np.testing.assert_allclose(found.rgb / 255, truth, atol=0.005)


def test_what_stands_for_no_number_is_one_that_is_not_finite(tmp_path: Path) -> None:
    found = parse(tmp_path, "v 1.#IND -1.#INF nan # none\n" + CORNERS + "f 2 3 4\n")
    assert np.isnan(found.vertices.xyz[0]).all()
    assert np.isfinite(corners_of(found)).all()


@pytest.mark.parametrize(
    ("text", "code", "reason"),
    [
        (CORNERS + "f 1 2 9\n", "CAPTURE_UNREADABLE", "vertices that do not exist"),
        (CORNERS + "f 1 2 -9\n", "CAPTURE_UNREADABLE", "vertices that do not exist"),
        (CORNERS + "f 1 2 0\n", "CAPTURE_UNREADABLE", "vertices that do not exist"),
        (CORNERS + "f 1 2 x\n", "CAPTURE_UNREADABLE", "not a readable OBJ"),
        (CORNERS + "v 1 x 0\nf 1 2 3\n", "CAPTURE_UNREADABLE", "not a readable OBJ"),
        (CORNERS + "v 1 2\nf 1 2 3\n", "CAPTURE_UNREADABLE", "a vertex has 2 numbers, not 3"),
        (CORNERS + "f" + 300_000 * " 1 2" + "\n", "CAPTURE_UNREADABLE", "a line of 1,200,002 bytes"),
        (CORNERS + "f" + 8 * (50_000 * " 1 2" + "\nf"), "CAPTURE_TOO_LARGE", "has 799,984 triangles; at most 100,000"),
        ("f 1 2 3\n", "CAPTURE_UNREADABLE", "vertices that do not exist"),
    ],
    ids=lambda value: value[-20:] if " " in value else value,
)
def test_what_cannot_be_is_named(
    text: str, code: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture2vr.edge.clouds.obj.MAX_FACES", 100_000)
    monkeypatch.setattr("capture2vr.edge.clouds.sample_surface.MAX_FACES", 100_000)
    with pytest.raises(CaptureError, match=reason) as caught:
        parse(tmp_path, text)
    assert caught.value.code == code


@pytest.mark.parametrize("name", ["paint", "Material #25", "paint#2"])
def test_a_remark_is_no_part_of_a_name(name: str, tmp_path: Path) -> None:
    text = f"mtllib a.mtl # of it\n{CORNERS}usemtl {name} # all of it\nf 1 2 3 4\n"
    _, rgb = points(read(tmp_path, text, f"newmtl {name} #\nKd 1 0 0 # red\n"))
    assert (rgb == RED).all()


def test_texture_coordinates_that_are_not_there_leave_the_face_white(tmp_path: Path) -> None:
    paint(tmp_path / "paint.png")
    _, rgb = points(read(tmp_path, HEAD + CORNERS + TEXELS + "f 1/1 2/2 3/9 4/4\n"))
    assert (rgb == 255).any(axis=0).all()
