"""PLY files of every order of properties: lists anywhere, of one length or of many, scalars between, faces first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.clouds.ply import PlyFile, read_ply
from capture2vr.edge.errors import CaptureError
from tests.support.odd.ply_bytes import ply

VERTICES = [(0.0, 0.0, 0.5), (2.0, 0.25, 0.5), (2.0, 1.5, 0.5), (0.0, 1.0, 0.5), (0.5, -2.0, 0.5)]
RGB = [(10, 20, 30), (40, 50, 60), (70, 80, 90), (100, 110, 120), (130, 140, 150)]
POLYGONS = [(0, 1, 2, 3), (0, 4, 1), (1, 2, 3)]
TRIANGLES = [(0, 1, 2), (0, 2, 3), (0, 4, 1), (1, 2, 3)]


def read(data: bytes, folder: Path) -> PlyFile:
    (folder / "a.ply").write_bytes(data)
    return read_ply(folder / "a.ply", "a.ply")


@given(data=st.data())
def test_the_declared_order_is_read(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    draw = data.draw
    form = draw(st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]))
    case = draw(st.sampled_from([str.lower, str.upper]))
    lengths = st.lists(st.integers(0, 3), min_size=5, max_size=5) | st.just([2] * 5)
    views, flags = draw(lengths), draw(lengths)
    scalars = [("float", "x"), ("double", "y"), ("float", "z")]
    scalars += [("uchar", each) for each in ("red", "green", "blue")]
    vertex = [*scalars, ("uchar uint", "view_indices"), ("int float", "view_weights")]
    columns = {
        **{name: [row[at] for row in VERTICES] for at, name in enumerate("xyz")},
        **{name: [row[at] for row in RGB] for at, name in enumerate(("red", "green", "blue"))},
        "view_indices": [list(range(count)) for count in views],
        "view_weights": [[0.5] * count for count in flags],
    }
    face = [("uchar int", "vertex_indices"), ("uchar", "flags"), ("uchar float", "texcoord"), ("int", "number")]
    of_faces = {
        "vertex_indices": POLYGONS,
        "flags": [7, 8, 9],
        "texcoord": [[0.5] * (2 * len(each)) for each in POLYGONS],
        "number": [1, 2, 3],
    }
    if draw(st.booleans()):  # a cloud by a program for meshes
        of_faces = {name: [] for name in of_faces}
    other = ("edge", [("int", "a"), ("uchar int", "b")], draw(st.sampled_from([[(1, [2, 3]), (4, [])], []])))
    made = []
    for name, properties, known in (("vertex", vertex, columns), ("face", face, of_faces)):
        chosen = draw(st.permutations(properties))
        rows = list(zip(*(known[each] for _, each in chosen), strict=True))
        made.append((case(name), [(kind, case(each)) for kind, each in chosen], rows))
    elements = draw(st.permutations([*made, other]))
    found = read(ply(form, elements), tmp_path_factory.mktemp("ply"))
    np.testing.assert_allclose(found.cloud.xyz, VERTICES)
    np.testing.assert_array_equal(found.cloud.rgb, RGB)
    assert sorted(map(tuple, found.faces.tolist())) == (sorted(TRIANGLES) if of_faces["flags"] else [])


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_faces_have_colours_where_vertices_have_none(form: str, tmp_path: Path) -> None:
    faces = [(polygon, *RGB[number]) for number, polygon in enumerate(POLYGONS)]
    colours = [("uchar", each) for each in ("red", "green", "blue")]
    elements = [
        ("vertex", [("float", each) for each in "xyz"], VERTICES),
        ("face", [("uchar int", "vertex_indices"), *colours], faces),
    ]
    found = read(ply(form, elements), tmp_path)
    assert found.face_rgb is not None
    of = {tuple(face): tuple(rgb) for face, rgb in zip(found.faces.tolist(), found.face_rgb.tolist(), strict=True)}
    assert of == dict(zip(TRIANGLES, (RGB[0], RGB[0], RGB[1], RGB[2]), strict=True))


def test_what_stands_for_no_number_is_one_that_is_not_finite(tmp_path: Path) -> None:
    data = ply("ascii", [("vertex", [("float", each) for each in "xyz"], VERTICES)])
    found = read(data.replace(b"0 1 0.5", b"nan -1.#IND 1.#QNAN"), tmp_path).cloud.xyz
    np.testing.assert_array_equal(found[3], np.full(3, np.nan))
    np.testing.assert_array_equal(found[[0, 1, 2, 4]], np.array(VERTICES)[[0, 1, 2, 4]])


@pytest.mark.parametrize("remark", [b"the end_header is below", b"\xc3\x85 element face 9", b"element vertex 7"])
@pytest.mark.parametrize("ends", [b"\n", b"\r\n"])
def test_a_remark_is_no_header(remark: bytes, ends: bytes, tmp_path: Path) -> None:
    """Whatever its words are, and its bytes: in Latin-1 the second of an "\xc5" in UTF-8 ends a line."""
    data = ply("binary_little_endian", [("vertex", [("float", each) for each in "xyz"], VERTICES)])
    head, _, body = data.partition(b"end_header\n")
    head = head.replace(b" 1.0\n", b" 1.0\ncomment " + remark + b"\n") + b"end_header\n"
    np.testing.assert_allclose(read(head.replace(b"\n", ends) + body, tmp_path).cloud.xyz, VERTICES)


@pytest.mark.parametrize("cut", [1, 9, 30])
def test_lists_that_are_cut_off_are_an_error(cut: int, tmp_path: Path) -> None:
    rows = [(*point, [1] * (number + 1)) for number, point in enumerate(VERTICES)]
    data = ply("binary_little_endian", [("vertex", [*(("float", each) for each in "xyz"), ("int int", "seen")], rows)])
    with pytest.raises(CaptureError) as caught:
        read(data[:-cut], tmp_path)
    assert caught.value.code == "CAPTURE_TRUNCATED"
