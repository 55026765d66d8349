"""Siblings of the inputs that were once misread: each of a kind, described in a word, with what is right."""

from __future__ import annotations

import gzip
import io
import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from PIL import Image, ImageCms

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.srgb import to_linear
from tests.bench.data_files import data_folder
from tests.support.captures import npy_bytes, ply_bytes
from tests.support.gltf_files import GltfWriter
from tests.support.odd.clouds import FEET, colours_up_to, pcd_of, scan
from tests.support.odd.meshes import picture
from tests.support.odd.misread import MISREAD, all_of, chart, files_of, split_views, surveyed
from tests.support.odd.odd_files import ZIPS, Files, verdict, zipped
from tests.support.odd.ply_bytes import ply
from tests.support.odd.tables import OddTable
from tests.support.odd.truth import Judge, Truth, judge_of

XYZ, RGB = scan(Random(7), 400, survey=False)
SURVEY = np.array([345_678.0, 5_432_100.0, 321.0])
KEPT = np.arange(len(XYZ)) % 20 != 7
POINTS = "its points, with its colours"
BARE = "its points, without colours"


@dataclass(frozen=True, slots=True)
class Sibling:
    """A file: the input that it is a sibling of, what it is, what is right, and what tells whether a reading is."""

    kind: str
    what: str
    right: str
    files: Files
    judge: Judge | str
    """The code of the refusal that is right, where that is."""


def siblings() -> Iterator[Sibling]:
    """Yield all of them."""
    yield from _tables()
    yield from _texts()
    yield from _plys()
    yield from _scans()
    yield from _las()
    yield from _meshes()
    yield from _gltfs()
    yield from _zips()
    yield from _photos()


def sibling_lines() -> Iterator[str]:
    """Yield the lines of a table: the inputs first, then their siblings."""
    data = data_folder()
    yield "| kind | what | right | found | right? |"
    yield "|---" * 5 + "|"
    inputs = [
        Sibling(name, "the input", _right_of(data, name), files_of(data, name), judge)
        for name, judge in MISREAD.items()
    ]
    for each in (*inputs, *siblings()):
        found, right = _outcome(each)
        yield f"| {each.kind} | {each.what} | {each.right} | {found} | {'yes' if right else '**no**'} |"


def _outcome(sibling: Sibling) -> tuple[str, bool]:
    """Read a file: what came of it, and whether that is right."""
    seen = [""]

    def judge(capture: Capture) -> str:
        seen[0] = _described(capture)
        return "not refused" if isinstance(sibling.judge, str) else sibling.judge(capture)

    how, why = verdict(sibling.files, judge)
    right = how == "refused" and why.startswith(sibling.judge) if isinstance(sibling.judge, str) else how == "right"
    return "; ".join(filter(None, (seen[0], why))), right


def _described(capture: Capture) -> str:
    cloud = capture.cloud
    if cloud is None:
        sizes = {photo.size for photo in capture.photos}
        return f"{len(capture.photos)} photos of {' and '.join(f'{w} × {h}' for w, h in sorted(sizes))} pixels"
    size = " × ".join(f"{side:.3g}" for side in np.ptp(cloud.xyz, axis=0) * capture.metres_per_unit)
    colours = "no colours" if cloud.rgb is None else f"colours of {cloud.rgb.mean(axis=0).round().astype(int).tolist()}"
    return f"{len(cloud.xyz):,} points, {size}, {colours}"


def _right_of(data: Path, name: str) -> str:
    text = (data / "misread" / name / "README").read_text()
    return text.split("Right:")[1].split(" At 1426a68")[0].strip().replace("|", ", ")


def _points(truth: np.ndarray = XYZ, rgb: np.ndarray | None = RGB, **more: Any) -> Judge:
    return judge_of(Truth(truth, rgb, **more))


_TABLES: tuple[tuple[str, str, OddTable], ...] = (
    ("csv_name_first", "names of points, semicolons", OddTable(header=("x", "y", "z"), separator=";", front="name")),
    ("csv_name_first", "no header, names of points", OddTable(separator=",", front="name")),
    ("csv_name_first", "times of the day in front", OddTable(header=("x", "y", "z"), separator=",", front="time")),
    ("csv_name_first", "seconds since 1970, no header", OddTable(separator="\t", front="seconds")),
    (
        "csv_name_first",
        "all in quotation marks",
        OddTable(header=("x", "y", "z"), separator=",", front="name", quoted=True),
    ),
    ("csv_pandas_index", "decimal commas", OddTable(header=("x", "y", "z"), separator=";", decimal=",", front="index")),
    ("csv_pandas_index", "no header", OddTable(separator=",", front="index")),
    ("csv_pandas_index", "row and column of the scanner", OddTable(separator=" ", front="row and column")),
    ("csv_units", "millimetres", OddTable(header=("X [mm]", "Y [mm]", "Z [mm]"), separator=";")),
    ("csv_units", "feet, in round brackets", OddTable(header=("x(ft)", "y(ft)", "z(ft)"), separator=",")),
    (
        "csv_units",
        "German names",
        OddTable(header=("Rechtswert", "Hochwert", "Höhe"), separator=";", encoding="cp1252"),
    ),
    (
        "csv_units",
        "ParaView's names, an empty column",
        OddTable(header=("Points:0", "Points:1", "Points:2"), separator=",", hollow=True),
    ),
    ("tab_decimal_comma_room", "with names", OddTable(header=("x", "y", "z"), separator="\t", decimal=",")),
    ("tab_decimal_comma_room", "semicolons and blanks", OddTable(separator="; ", decimal=",")),
    ("tab_decimal_comma_room", "blanks alone", OddTable(separator=" ", decimal=",")),
    ("tab_excel_unicode", "big endian", OddTable(encoding="utf-16-be", separator="\t", decimal=",")),
    (
        "tab_excel_unicode",
        "without its mark",
        OddTable(encoding="utf-16-le", remark="#", header=("x", "y", "z"), separator="\t"),
    ),
    ("tab_excel_unicode", "ends of lines of an old Mac", OddTable(encoding="utf-16", ends="\r", separator="\t")),
    ("xyz_msvc_nan", "1.#QNAN", OddTable(nothing="1.#QNAN")),
    ("xyz_msvc_nan", "empty fields", OddTable(nothing="", separator=",")),
    (
        "xyz_msvc_nan",
        "a footer, short rows and remarks",
        OddTable(after=("End of file",), odd_rows=("1.5", "a remark"), nothing="inf"),
    ),
)


def _tables() -> Iterator[Sibling]:
    for kind, what, table in _TABLES:
        truth = Truth(XYZ[KEPT] * table.metres, RGB[KEPT], near=1e-6)
        yield Sibling(kind, what, POINTS, {"scan.csv": table.written(XYZ, RGB)}, judge_of(truth))
    table = OddTable(separator=";", decimal=",")
    truth = Truth((XYZ + SURVEY)[KEPT], RGB[KEPT])
    far = all_of(judge_of(truth), surveyed(tuple(SURVEY)))
    right = "its points, Z up, and where they are"
    yield Sibling("xyz_utm", "decimal commas", right, {"a.txt": table.written(XYZ + SURVEY, RGB)}, far)
    yield Sibling(
        "xyz_utm",
        "with names",
        right,
        {"a.txt": OddTable(header=("Easting", "Northing", "Elevation"), separator=",").written(XYZ + SURVEY, RGB)},
        far,
    )


def _rows(*columns: Any, separator: str = " ") -> list[str]:
    return [separator.join(map(str, row)) for row in zip(*(np.asarray(each).tolist() for each in columns), strict=True)]


def _texts() -> Iterator[Sibling]:
    """Tables that are written by hand here."""
    x, y, z = XYZ.T
    lines = ["x,y,z,name", *_rows(x, y, z, [f"Punkt {number}" for number in range(len(x))], separator=",")]
    yield Sibling("csv_name_first", "names behind", BARE, {"a.csv": "\n".join(lines).encode()}, _points(rgb=None))
    lines = ["Unnamed: 0,x,y,z,red,green,blue", *_rows(range(len(x)), x, y, z, *RGB.T, separator=",")]
    yield Sibling("csv_pandas_index", "Unnamed: 0", POINTS, {"a.csv": "\n".join(lines).encode()}, _points())
    for what, names in (
        ("x_m", "x_m,y_m,z_m"),
        ("X/m", "X/m,Y/m,Z/m"),
        ("metres in words", "x (meters),y (meters),z (meters)"),
    ):
        text = "\n".join([names, *_rows(x, y, z, separator=",")]).encode()
        yield Sibling("csv_units", what, BARE, {"a.csv": text}, _points(rgb=None))
    written = [[f"{value:,.4f}" for value in row] for row in (XYZ + SURVEY).tolist()]
    for what, separator, marks in (
        ("points at thousands", ";", {",": ".", ".": ","}),
        ("blanks at thousands", ";", {",": " ", ".": ","}),
        ("Swiss, 5'432'100.5", ";", {",": "'"}),
        ("American, in quotation marks", '","', {}),
    ):
        rows = [separator.join(row).translate(str.maketrans(marks)) for row in written]
        text = "\n".join(f'"{row}"' if separator == '","' else row for row in rows)
        yield Sibling("tab_decimal_comma_room", what, BARE, {"a.csv": text.encode()}, _points(XYZ + SURVEY, None))
    for what, head in (("Excel's sep=; above it", "sep=;\nx;y;z"), ("units in a line of their own", "x;y;z\nm;m;m")):
        text = "\n".join([head, *_rows(x, y, z, separator=";")])
        yield Sibling("csv_units", what, BARE, {"a.csv": text.encode()}, _points(rgb=None))
    text = "\n".join(_rows(x - 10, y, z, separator=";")).replace("-", "\u2212")
    yield Sibling(
        "xyz_msvc_nan", "a typographic minus", BARE, {"a.csv": text.encode()}, _points(XYZ - [10, 0, 0], None)
    )
    for kind, what, count in (
        ("pts_two_scans", "three scans, Windows", 3),
        ("pts_two_scans", "one, no count of its own", 1),
    ):
        parts = np.array_split(np.arange(len(XYZ)), count)
        text = "\r\n".join(
            line
            for part in parts
            for line in (
                [str(len(part))] * (count > 1) + _rows(*XYZ[part].T, np.arange(len(part)) % 4096 - 2048, *RGB[part].T)
            )
        )
        yield Sibling(kind, what, POINTS, {"a.pts": text.encode()}, _points())


def _vertices(xyz: np.ndarray = XYZ, rgb: np.ndarray = RGB, kind: str = "uchar", exact: str = "float") -> Any:
    names = [(exact, each) for each in "xyz"] + [(kind, each) for each in ("red", "green", "blue")]
    return ("vertex", names, np.hstack([xyz, rgb]).tolist())


_L = np.array([(0, 0, 0), (4, 0, 0), (4, 1, 0), (1, 1, 0), (1, 3, 0), (0, 3, 0)], float)
_L_TRIANGLES = np.array([[_L[0], _L[1], _L[2]], [_L[0], _L[2], _L[3]], [_L[0], _L[3], _L[4]], [_L[0], _L[4], _L[5]]])
_L_RGB = np.tile([10, 200, 30], (6, 1))


def _floor(rgb: np.ndarray | None = _L_RGB[:4]) -> Judge:
    return judge_of(Truth(_L_TRIANGLES, rgb, is_surface=True))


def _plys() -> Iterator[Sibling]:
    corners = [0, 1, 2, 3, 4, 5]
    listed, flags = ("uchar int", "vertex_indices"), ("uchar", "flags")
    coordinates = ("uchar float", "texcoord")
    whole = "the whole L, in its colours"
    for what, form, properties, row, first in (
        ("texture coordinates first", "ascii", [coordinates, listed], [[0.5] * 12, corners], False),
        ("binary, flags first", "binary_big_endian", [flags, listed], [7, corners], False),
        ("faces before vertices", "binary_little_endian", [flags, listed], [7, corners], True),
        ("names in upper case", "ascii", [(k, n.upper()) for k, n in (flags, listed)], [7, corners], False),
    ):
        elements: list[Any] = [_vertices(_L, _L_RGB), ("face", properties, [row])]
        yield Sibling(
            "ply_ascii_face_scalar_first", what, whole, {"a.ply": ply(form, elements[:: -1 if first else 1])}, _floor()
        )
    faces = ("face", [listed, *(("uchar", each) for each in ("red", "green", "blue"))], [[corners, 10, 200, 30]])
    bare = ("vertex", [("float", each) for each in "xyz"], _L.tolist())
    yield Sibling(
        "ply_ascii_face_scalar_first", "colours of faces", whole, {"a.ply": ply("ascii", [bare, faces])}, _floor()
    )
    beyond = RGB / 255
    beyond[17] = 1.0000001, 1.02, 1
    meant = np.where(np.arange(len(RGB))[:, None] == 17, 255, RGB)
    for kind in ("float", "double"):
        data = ply("binary_little_endian", [_vertices(rgb=beyond, kind=kind)])
        yield Sibling("ply_float_colour_over_one", kind, POINTS, {"a.ply": data}, _points(rgb=meant))
    yield Sibling(
        "ply_float_colour_over_one",
        "of 16 bits",
        POINTS,
        {"a.ply": ply("ascii", [_vertices(rgb=RGB * 257, kind="ushort")])},
        _points(),
    )
    for what, gone in (
        ("infinity, half of them", np.arange(len(XYZ)) % 2 > 0),
        ("7 of 10", np.arange(len(XYZ)) % 10 > 2),
    ):
        holes = np.where(gone[:, None], np.inf if what.startswith("inf") else np.nan, XYZ)
        data = ply("binary_little_endian", [_vertices(holes)])
        yield Sibling("ply_nan_40pct", what, POINTS, {"a.ply": data}, _points(XYZ[~gone], RGB[~gone]))
    names = [*_vertices()[1], ("uchar uint", "view_indices"), ("int float", "view_weights")]
    for form in ("ascii", "binary_big_endian"):
        rows = [[*row, [1] * (number % 3), [0.5] * 2] for number, row in enumerate(_vertices()[2])]
        yield Sibling(
            "ply_openmvs_views",
            f"lists of any length, {form}",
            POINTS,
            {"a.ply": ply(form, [("vertex", names, rows)])},
            _points(),
        )
    black = ply_bytes(XYZ.astype(np.float32), np.zeros_like(RGB, np.uint8))
    yield Sibling("las_rgb_all_zero", "a PLY, no intensity", BARE, {"a.ply": black}, _points(rgb=None))
    exact = ply("binary_little_endian", [_vertices(XYZ + SURVEY, exact="double")])
    far = all_of(_points(XYZ + SURVEY), surveyed(tuple(SURVEY)))
    yield Sibling("xyz_utm", "a PLY of doubles", "its points, Z up, and where they are", {"a.ply": exact}, far)


def _scans() -> Iterator[Sibling]:
    gone = np.arange(len(XYZ)) % 5 > 2
    holes = np.where(gone[:, None], np.nan, XYZ).astype("<f4")
    packed = (RGB.astype(np.uint32) << [16, 8, 0]).sum(1).astype(np.uint32)
    fields = [*((name, holes[:, axis]) for axis, name in enumerate("xyz")), ("rgb", packed.view("<f4"))]
    for form in ("ascii", "binary_compressed"):
        yield Sibling(
            "ply_nan_40pct",
            f"a PCD in one row, {form}",
            POINTS,
            {"a.pcd": pcd_of(fields, form, 1)},
            _points(XYZ[~gone], RGB[~gone]),
        )
    yield Sibling(
        "xyz_msvc_nan",
        "a NumPy array of NaN",
        POINTS,
        {"a.npy": npy_bytes(np.hstack([holes, RGB]))},
        _points(XYZ[~gone], RGB[~gone]),
    )
    head = ["20", "20", "0 0 0", "1 0 0", "0 1 0", "0 0 1", "1 0 0 0", "0 1 0 0", "0 0 1 0", "0 0 0 1"]
    beams = _rows(*np.where(gone[:, None], 0, XYZ).T, np.full(len(XYZ), 0.5), *RGB.T)
    yield Sibling(
        "ply_nan_40pct",
        "a PTX, 0 0 0 for no return",
        POINTS,
        {"a.ptx": "\n".join([*head, *beams]).encode()},
        _points(XYZ[~gone], RGB[~gone]),
    )
    yield Sibling("ply_float_colour_over_one", "an E57 of floats", POINTS, {"a.e57": _e57(1.0)}, _points(shade=1.5))
    yield Sibling("ply_float_colour_over_one", "an E57 of 16 bits", POINTS, {"a.e57": _e57(65_535)}, _points(shade=1.5))


def _e57(top: float) -> bytes:
    import tempfile

    from tests.support.captures import e57_scan, save_e57

    stored = RGB / 255 if isinstance(top, float) else np.rint(RGB / 255 * top).astype(np.uint16)
    with tempfile.TemporaryDirectory() as folder, colours_up_to(top):
        save_e57(Path(folder) / "a.e57", [e57_scan(XYZ, stored)])
        return (Path(folder) / "a.e57").read_bytes()


def las_bytes(
    rgb: np.ndarray | None,
    *records: tuple[int, bytes],
    xyz: np.ndarray = XYZ,
    newer: bool = False,
    intensity: np.ndarray | None = None,
) -> bytes:
    """A LAS with these records of its coordinates."""
    import laspy

    made = laspy.create(point_format=7 if newer else 3, file_version="1.4" if newer else "1.2")
    made.header.scales, made.header.offsets = np.full(3, 1e-4), np.floor(xyz.min(axis=0))
    made.x, made.y, made.z = xyz.T
    if rgb is not None:
        made.red, made.green, made.blue = rgb.T
    if intensity is not None:
        made.intensity = intensity
    made.header.vlrs.extend(laspy.VLR("LASF_Projection", number, "", content) for number, content in records)
    stream = io.BytesIO()
    made.write(stream)
    return stream.getvalue()


def _las() -> Iterator[Sibling]:
    yield Sibling("las_rgb_all_zero", "no intensity either", BARE, {"a.las": las_bytes(None)}, _points(rgb=None))
    grey = np.clip(np.rint(255 * RGB[:, :1] / np.quantile(RGB[:, 0], 0.98)), 0, 255) * [1, 1, 1]
    yield Sibling(
        "las_rgb_all_zero",
        "format 7, intensities of 12 bits",
        "its intensities as grey",
        {"a.las": las_bytes(None, newer=True, intensity=16 * RGB[:, 0])},
        _points(rgb=grey),
    )
    one = RGB.copy()
    one[9, 1] = 300
    yield Sibling(
        "ply_float_colour_over_one",
        "a LAS of 8 bits, one 300",
        POINTS,
        {"a.las": las_bytes(one)},
        _points(rgb=np.minimum(one, 255)),
    )
    yield Sibling("ply_float_colour_over_one", "a LAS of 16 bits", POINTS, {"a.las": las_bytes(RGB * 257)}, _points())
    keys = {"US feet, GeoTIFF": (9003, FEET), "feet, GeoTIFF": (9002, 0.3048), "metres, GeoTIFF": (9001, 1.0)}
    for what, (code, metres) in keys.items():
        record = struct.pack("<12H", 1, 1, 0, 2, 1024, 0, 1, 1, 3076, 0, 1, code)
        yield Sibling(
            "las_us_feet",
            what,
            "its points in metres",
            {"a.las": las_bytes(RGB * 257, (34735, record))},
            _points(XYZ * metres, near=1e-3),
        )
    text = (
        f'COMPD_CS["a",PROJCS["b",GEOGCS["c",UNIT["degree",0.0174532925199433]],UNIT["US survey foot",{FEET!r}]],'
        'VERT_CS["d",VERT_DATUM["e",2005],UNIT["metre",1]]]\0'
    )
    yield Sibling(
        "las_us_feet",
        "heights in metres",
        "its points in metres",
        {"a.las": las_bytes(RGB * 257, (2112, text.encode()), newer=True)},
        _points(XYZ * (FEET, FEET, 1), near=1e-3),
    )
    yield Sibling(
        "xyz_utm",
        "a LAS",
        "its points, Z up, and where they are",
        {"a.las": las_bytes(RGB * 257, xyz=XYZ + SURVEY)},
        all_of(_points(XYZ + SURVEY, near=1e-3), surveyed(tuple(SURVEY))),
    )


def _obj(*lines: str, encoding: str = "utf-8") -> bytes:
    corners = [f"v {x} {y} {z}" for x, y, z in _L.tolist()]
    return "\n".join([*lines[:1], *corners, "vt 0.5 0.5", *lines[1:], ""]).encode(encoding)


_TEXTURED = "f " + " ".join(f"{number}/1" for number in range(1, 7))


def _painted(data: bytes, name: str = "t.png", encoding: str = "utf-8", text: str = "a.mtl") -> Files:
    material = f"newmtl m\nKd 1 1 1\nmap_Kd {name}\n".encode(encoding)
    return {"a.obj": _obj(f"mtllib {text}", "usemtl m", _TEXTURED, encoding=encoding), text: material, name: data}


def _png(mode: str, value: Any, form: str = "PNG", **more: Any) -> bytes:
    stream = io.BytesIO()
    Image.new(mode, (8, 8), value).save(stream, form, **more)
    return stream.getvalue()


def _meshes() -> Iterator[Sibling]:
    whole = "the whole L, and not its notch"
    faces = "\n".join(f"{x} {y} {z}" for x, y, z in _L.tolist()) + "\n6 0 1 2 3 4 5\n"
    yield Sibling("obj_concave", "an OFF", whole, {"a.off": f"OFF\n6 1 0\n{faces}".encode()}, _floor(None))
    relative = _obj("o L", "f -6 -5 -4 \\\n-3 -2 -1")
    yield Sibling("obj_concave", "relative indices, a line that goes on", whole, {"a.obj": relative}, _floor(None))
    old = _obj("o L", "f 1 2 3 4 5 6").replace(b"\n", b"\r")
    yield Sibling("obj_concave", "ends of lines of an old Mac", whole, {"a.obj": old}, _floor(None))
    turned = "f " + " ".join(map(str, (4, 5, 6, 1, 2, 3)))
    yield Sibling(
        "obj_concave",
        "begun at the notch, UTF-16",
        whole,
        {"a.obj": _obj("o L", turned, encoding="utf-16")},
        _floor(None),
    )
    glued = ply(
        "ascii",
        [
            ("vertex", [("float", each) for each in "xyz"], _L.tolist()),
            ("face", [("uchar int", "vertex_index")], [[[5, 4, 3, 2, 1, 0]]]),
        ],
    )
    yield Sibling("obj_concave", "a PLY, turned over", whole, {"a.ply": glued}, _floor(None))
    plain = picture([(10, 200, 30)], "png")
    painted = "the texture's colour"
    for what, files in (
        ("UTF-8", _painted(plain, "Wäsche.png", text="Möbel.mtl")),
        ("UTF-16", _painted(plain, "Wäsche.png", "utf-16", "Möbel.mtl")),
        ("names with blanks", _painted(plain, "my paint.png", text="my scan.mtl")),
        ("a texture of the names' other case", {**_painted(plain, "T.PNG"), "T.PNG": b"", "t.png": plain}),
    ):
        yield Sibling("obj_cp1252_names", what, painted, {name: data for name, data in files.items() if data}, _floor())
    remarked = {
        "a.obj": _obj("mtllib a.mtl # of it", "usemtl Material #25 # all", "f 1 2 3 4 5 6"),
        "a.mtl": b"newmtl Material #25 # green\nKd 0.03922 0.78431 0.11765\n",
    }
    yield Sibling("obj_cp1252_names", "a remark behind Material #25", "the material's colour", remarked, _floor())
    sjis = _painted(plain, "家.png", "cp932")
    yield Sibling(
        "obj_cp1252_names",
        "Shift-JIS: ambiguous, no text tells it",
        "read, though without the texture",
        sjis,
        _floor(np.tile([255] * 3, (4, 1))),
    )
    for what, data, colour in (
        ("1 bit", _png("1", 1), (255, 255, 255)),
        ("grey with alpha", _png("LA", (128, 255)), (128, 128, 128)),
        ("16 bits, dark", _png("I;16", 32 * 257), (32, 32, 32)),
        ("a palette", picture([(10, 200, 30)], "palette"), (10, 200, 30)),
        ("CMYK", _png("CMYK", (0, 0, 0, 127), "JPEG"), (128, 128, 128)),
    ):
        yield Sibling(
            "obj_grey16_texture",
            what,
            painted,
            _painted(data, "t.jpg" if what == "CMYK" else "t.png"),
            judge_of(Truth(_L_TRIANGLES, np.tile(colour, (4, 1)), is_surface=True, shade=2)),
        )
    facets = b"".join(bytes(12) + each.astype("<f4").tobytes() + bytes(2) for each in _L_TRIANGLES)
    body = struct.pack("<I", len(_L_TRIANGLES)) + facets
    solid = b"solid exported".ljust(80) + body + b"tail"
    yield Sibling("stl_trailing", "its head begins with solid", "the whole L", {"a.stl": solid}, _floor(None))
    yield Sibling(
        "stl_trailing",
        "behind gzip",
        "the whole L",
        {"a.stl.gz": gzip.compress(bytes(80) + body + bytes(37))},
        _floor(None),
    )
    text = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in each.tolist())
        + "endloop\nendfacet\n"
        for each in _L_TRIANGLES
    )
    yield Sibling(
        "stl_trailing",
        "a text, its solid called vertex 1 2 3",
        "the whole L",
        {"a.stl": f"solid vertex 1 2 3\n{text}endsolid vertex 1 2 3\n".encode()},
        _floor(None),
    )


def _gltfs() -> Iterator[Sibling]:
    shines: dict[str, Any] = {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}}
    light = to_linear(np.array([10, 200, 30], np.uint8)).tolist()
    gloss = {"extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0, 0, 0, 1]}}}
    for what, material in (
        ("a factor alone", {**shines, "emissiveFactor": light}),
        ("an older material", {**gloss, "emissiveFactor": light}),
    ):
        yield Sibling(
            "glb_emissive_only", what, "the colour that it shines in", {"a.glb": _l_writer(material).glb()}, _floor()
        )
    dull = {"pbrMetallicRoughness": {"baseColorFactor": [*light, 1]}, "emissiveFactor": [1, 1, 1]}
    yield Sibling(
        "glb_emissive_only", "a colour beside it", "its base colour", {"a.glb": _l_writer(dull).glb()}, _floor()
    )
    for what, coloured, rest in (
        ("no colours", False, {}),
        ("colours, a scale of the node", True, {"scale": [2, 2, 2]}),
    ):
        writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0, **rest}])
        attributes = {"POSITION": writer.add(XYZ.astype("<f4"))}
        if coloured:
            attributes["COLOR_0"] = writer.add(to_linear(RGB.astype(np.uint8)).astype("<f4"))
        writer.tree["meshes"] = [{"primitives": [{"attributes": attributes, "mode": 0}]}]
        yield Sibling(
            "glb_points",
            what,
            POINTS if coloured else BARE,
            {"a.glb": writer.glb()},
            _points(XYZ * (2 if rest else 1), RGB if coloured else None),
        )
    for what, mode, indices in (("a fan", 6, [3, 4, 5, 0, 1, 2]), ("a strip", 5, [1, 2, 0, 3, 5, 4])):
        writer = _l_writer({"pbrMetallicRoughness": {"baseColorFactor": [*light, 1]}}, mode, indices)
        yield Sibling("glb_points", what, "the whole L", {"a.glb": writer.glb()}, _floor())
    data = _l_writer({"pbrMetallicRoughness": {"baseColorFactor": [*light, 1]}}).glb()
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    asset, tree["buffers"] = tree.pop("asset"), [{"uri": "a%20b.bin", "byteLength": len(data) - 28 - size}]
    late = json.dumps({"extras": "x" * 100_000, **tree, "asset": asset})
    for what, encoding in (("its buffer beside it", "utf-8"), ("with a mark", "utf-8-sig")):
        files = {"a.gltf": late.encode(encoding), "a b.bin": data[28 + size :]}
        yield Sibling("gltf_asset_late", what, "the whole L", files, _floor())


def _l_writer(material: Mapping[str, Any], mode: int = 6, indices: Sequence[int] = (3, 4, 5, 0, 1, 2)) -> GltfWriter:
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0}], materials=[dict(material)])
    part = {"attributes": {"POSITION": writer.add(_L.astype("<f4"))}, "mode": mode, "material": 0}
    writer.tree["meshes"] = [{"primitives": [part | {"indices": writer.add(np.array(indices, "u1")[:, None])}]}]
    return writer


def _zips() -> Iterator[Sibling]:
    files = _painted(picture([(10, 200, 30)], "png"), "Wäsche.png", text="Möbel.mtl")
    for what, pack in ZIPS.items():
        yield Sibling("pack_backslashes_zip", what, "the texture's colour", {"scan.zip": pack(files)}, _floor())
    out = {"scan.zip": zipped({"..\\..\\a.obj": files["a.obj"]})}
    yield Sibling("pack_backslashes_zip", "backslashes that lead out", "refused by name", out, "ARCHIVE_TRAVERSAL")


def _photos() -> Iterator[Sibling]:
    data = data_folder()
    (chart_png,) = files_of(data, "photo_p3_chart").values()
    image = Image.open(io.BytesIO(chart_png))
    profile = image.info["icc_profile"]
    for form, more in (("JPEG", {"quality": 100, "subsampling": 0}), ("TIFF", {}), ("WEBP", {"lossless": True})):
        stream = io.BytesIO()
        image.convert("RGB").save(stream, form, icc_profile=profile, **more)
        yield Sibling("photo_p3_chart", form, "the patches as sRGB", {f"a.{form.lower()}": stream.getvalue()}, chart)
    seen = ImageCms.profileToProfile(image.convert("RGB"), io.BytesIO(profile), ImageCms.createProfile("sRGB"))
    stream = io.BytesIO()
    assert seen is not None
    seen.save(stream, "PNG")
    yield Sibling("photo_p3_chart", "sRGB, no profile", "the patches as sRGB", {"a.png": stream.getvalue()}, chart)
    panoramas = [Image.open(io.BytesIO(each)) for each in files_of(data, "photos_equirect_small").values()]
    for what, size in (("told by their pixels", None), ("PNG, half as large", 2)):
        files = {}
        for number, each in enumerate(panoramas):
            stream = io.BytesIO()
            small = each if size is None else each.resize((each.width // size, each.height // size))
            small.convert("RGB").save(stream, "JPEG" if size is None else "PNG")
            files[f"{number}.{'jpg' if size is None else 'png'}"] = stream.getvalue()
        side = 160 if size is None else 80
        yield Sibling("photos_equirect_small", what, "split into views", files, split_views(8 * len(files), side))
