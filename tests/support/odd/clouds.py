"""Point clouds that are valid and odd, with the points and colours that they mean, each drawn by chance."""

from __future__ import annotations

import io
import re
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from tests.support.captures import e57_scan, lzf_compress, npy_bytes, save_e57
from tests.support.odd.ply_bytes import ply
from tests.support.odd.tables import odd_table
from tests.support.odd.truth import Truth

Made = tuple[str, bytes, str, Truth]
"""Name, content, what is odd, and what it means."""

_SIZES = ((0.6, 0.4, 0.2), (6.0, 4.0, 2.5), (60.0, 40.0, 8.0))
_HERE, _SURVEY = ((0.0, 0.0, 0.0), (2.5, 0.1, 1.2), (-30.0, 4.0, -7.0)), ((345_678.0, 5_432_100.0, 321.0),)
_CHANNELS = ("red", "green", "blue")


def scan(chance: Random, count: int = 300, *, survey: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Points (N,3) of an ellipsoid, of four decimals, and their colours (N,3) of 1 to 255."""
    rng = np.random.default_rng(chance.getrandbits(32))
    turn = rng.normal(size=(count, 3))
    place = chance.choice((*_HERE, *_SURVEY) if survey else _HERE)
    xyz = turn / np.linalg.norm(turn, axis=1, keepdims=True) * chance.choice(_SIZES) + place
    return np.round(xyz, 4), rng.integers(1, 256, (count, 3))


def some_missing(chance: Random, count: int) -> np.ndarray:
    """(N,) which points had no return: none, or up to half of them."""
    share = chance.choice((0.0, 0.0, 0.05, 0.3, 0.5))
    return np.array([chance.random() < share for _ in range(count)])


def table(chance: Random) -> Made:
    """A table in some dialect; some rows have no numbers."""
    xyz, rgb = scan(chance, 400)
    made = odd_table(chance)
    kept = np.arange(len(xyz)) % 20 != 7
    name = chance.choice(("scan.txt", "scan.xyz", "scan.csv", "scan.asc", "Punkte Büro.txt"))
    truth = Truth(xyz[kept] * made.metres, rgb[kept] if made.coloured else None, near=1e-6)
    return name, made.written(xyz, rgb), "a dialect", truth


def pts(chance: Random) -> Made:
    """Scans one after another, each with the number of its points above it."""
    xyz, rgb = scan(chance, 450)
    count = chance.choice((1, 2, 3))
    parts = list(zip(np.array_split(xyz, count), np.array_split(rgb, count), strict=True))
    ends, reach = chance.choice(("\n", "\r\n")), chance.choice((1, 4096))
    lines: list[str] = []
    for points, colours in parts:
        lines.append(f"{len(points)}{chance.choice(('', ' '))}")
        for number, (point, colour) in enumerate(zip(points.tolist(), colours.tolist(), strict=True)):
            grey = f"{0.1 + 0.8 * (number % 7) / 7:.3f}" if reach == 1 else str(number % 4096 - 2048)
            lines.append(" ".join([*(f"{value:.4f}" for value in point), grey, *map(str, colour)]))
    return "scan.pts", (ends.join(lines) + ends).encode(), f"{count} scans", Truth(xyz, rgb)


def ptx(chance: Random) -> Made:
    """Scans with poses, of which some have colours, and the others are grey then; some beams come back from nowhere."""
    whole, colours, lines = [], [], list[str]()
    kinds = chance.choice((("rgb",), ("rgb", "rgb"), ("rgb", "grey")))
    for kind in kinds:
        xyz, rgb = scan(chance, 300, survey=False)
        gone = some_missing(chance, len(xyz))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[3, :3] = _turned(chance).T, np.round([chance.uniform(-9, 9) for _ in range(3)], 3)
        shown = matrix.T if chance.random() < 0.3 else matrix
        lines += ["20", "15", *(" ".join(map(str, row)) for row in (matrix[3, :3], *matrix[:3, :3]))]
        lines += [" ".join(f"{value:.15g}" for value in row) for row in shown]
        for point, colour, lost in zip(xyz, rgb, gone, strict=True):
            words = ["0", "0", "0", "0.5"] if lost else [*map(str, point), "0.25"]
            lines.append(" ".join([*words, *(map(str, [0, 0, 0] if lost else colour) if kind == "rgb" else ())]))
        whole.append((xyz @ matrix[:3, :3] + matrix[3, :3])[~gone])
        colours.append(rgb[~gone] if kind == "rgb" else np.full((int((~gone).sum()), 3), 128))
    ends = chance.choice(("\n", "\r\n"))
    truth = Truth(np.concatenate(whole), np.concatenate(colours))
    return "hall.ptx", (ends.join(lines) + ends).encode(), " and ".join(kinds), truth


def _turned(chance: Random) -> np.ndarray:
    """(3,3) some rotation."""
    basis, _ = np.linalg.qr(np.random.default_rng(chance.getrandbits(32)).normal(size=(3, 3)))
    return np.asarray(basis * np.sign(np.linalg.det(basis)))


def ply_colours(chance: Random, rgb: np.ndarray) -> tuple[str, list[tuple[str, str]], np.ndarray, np.ndarray | None]:
    """How colours are stored: a word for it, their properties, the numbers (N,k), and the colours that they mean."""
    way = chance.choice(("bytes", "bytes", "diffuse", "floats", "floats, one beyond", "16 bits", "unfilled", "none"))
    names = [f"diffuse_{each}" for each in _CHANNELS] if way == "diffuse" else list(_CHANNELS)
    if way == "none":
        return way, [], np.zeros((len(rgb), 0)), None
    if way == "unfilled":
        return way, [("uchar", each) for each in names], np.zeros((len(rgb), 3)), None
    if way.startswith("floats"):
        stored = rgb / 255
        if way == "floats, one beyond":
            stored[5] = 1.0000001, 1.02, 1.0
            rgb = np.where(np.arange(len(rgb))[:, None] == 5, 255, rgb)
        return way, [("float", each) for each in names], stored, rgb
    if way == "16 bits":
        return way, [("ushort", each) for each in names], rgb * 257, rgb
    return way, [(kind, each) for each in names for kind in ("uchar",)], rgb, rgb


_REMARKS = (
    b"comment made by M\xc3\xbcller & S\xc3\xb6hne\n",
    b"comment Gr\xf6\xdfe\n",
    b"comment \xc3\x85ngstr\xc3\xb6m\n",
    b"obj_info num_cols 640\n",
    b"comment the header ends with end_header\n",
    b"comment element vertex 7\n",
)


_ALIASES = {b"float": b"float32", b"double": b"float64", b"uchar": b"uint8", b"int": b"int32", b"ushort": b"uint16"}


def with_remarks(chance: Random, data: bytes) -> bytes:
    """A PLY with remarks in its header, or with the header's lines as Windows ends them."""
    head, end, body = data.partition(b"end_header\n")
    first, _, others = head.partition(b" 1.0\n")
    if chance.random() < 0.4:
        for name, alias in _ALIASES.items():
            others = re.sub(rb"\b%b\b(?= )" % name, alias, others)
    head = first + b" 1.0\n" + b"".join(chance.sample(_REMARKS, chance.choice((0, 1, 2)))) + others
    return (head + end).replace(b"\n", chance.choice((b"\n", b"\n", b"\r\n"))) + body


def ply_cloud(chance: Random) -> Made:
    """Vertices whose properties come in any order, with lists between them; elements in any order."""
    xyz, rgb = scan(chance)
    form = chance.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    gone = some_missing(chance, len(xyz))
    way, names, stored, meant = ply_colours(chance, rgb)
    exact = "double" if np.abs(xyz).max() > 1e4 else chance.choice(("float", "double"))
    columns: list[tuple[tuple[str, str], list[Any]]] = []
    for axis, name in enumerate("xyz"):
        values = np.where(gone, chance.choice((np.nan, np.inf)), xyz[:, axis])
        columns.append(((exact, name), values.tolist()))
    columns += [(name, stored[:, at].tolist()) for at, name in enumerate(names)]
    others: list[tuple[tuple[str, str], list[Any]]] = [
        (("uchar", "alpha"), [255] * len(xyz)),
        (("float", "confidence"), [0.5] * len(xyz)),
        (("uchar uint", "view_indices"), [list(range(number % 4)) for number in range(len(xyz))]),
        (("int float", "view_weights"), [[0.25, 0.75]] * len(xyz)),
    ]
    columns += chance.sample(others, chance.choice((0, 1, 2, 4)))
    chance.shuffle(columns)
    case = chance.choice((str.lower, str.lower, str.upper))
    rows = list(zip(*(values for _, values in columns), strict=True))
    elements: list[Any] = [(case("vertex"), [(kind, case(name)) for (kind, name), _ in columns], rows)]
    elements += chance.sample(
        [("face", [("uchar int", "vertex_indices")], []), ("camera", [("float", "f")], [(1.5,)])],
        chance.choice((0, 1, 2)),
    )
    chance.shuffle(elements)
    truth = Truth(xyz[~gone], None if meant is None else meant[~gone], near=1e-5 if exact == "float" else 1e-9)
    return "scan.ply", with_remarks(chance, ply(form, elements)), f"{form}, {way}", truth


def pcd(chance: Random) -> Made:
    """Fields in any order, colours in a float, an integer or fields of their own, padding and features between."""
    xyz, rgb = scan(chance)
    gone = some_missing(chance, len(xyz))
    exact = "<f8" if np.abs(xyz).max() > 1e4 else chance.choice(("<f4", "<f8"))
    packed = (rgb.astype(np.uint32) << [16, 8, 0]).sum(1).astype(np.uint32)
    way = chance.choice(("rgb as float", "rgb as integer", "rgba", "fields", "none"))
    fields: list[tuple[str, np.ndarray]] = [
        (name, np.where(gone, np.nan, xyz[:, axis]).astype(exact)) for axis, name in enumerate("xyz")
    ]
    fields += {
        "rgb as float": [("rgb", packed.view("<f4"))],
        "rgb as integer": [("rgb", packed)],
        "rgba": [("rgba", packed | np.uint32(0xFF000000))],
        "fields": [(name, rgb[:, at].astype("u1")) for at, name in enumerate("rgb")],
        "none": [],
    }[way]
    extra = [
        ("_", np.zeros((len(xyz), 3), "u1")),
        ("fpfh", np.ones((len(xyz), 33), "<f4")),
        ("ring", np.arange(len(xyz), dtype="<u2")),
    ]
    fields += chance.sample(extra, chance.choice((0, 1, 3)))
    chance.shuffle(fields)
    form = chance.choice(("ascii", "binary", "binary_compressed"))
    height = chance.choice((1, 20))
    data = pcd_of(fields, form, height, word=chance.choice(("FIELDS", "FIELDS", "COLUMNS")))
    truth = Truth(xyz[~gone], None if way == "none" else rgb[~gone], near=1e-5 if exact == "<f4" else 1e-9)
    return "scan.pcd", data, f"{form}, {way}", truth


def pcd_of(fields: list[tuple[str, np.ndarray]], form: str, height: int, *, word: str = "FIELDS") -> bytes:
    """A PCD of fields (N,) or (N,k), as "ascii", "binary" or "binary_compressed"."""
    tables = [values.reshape(len(values), -1) for _, values in fields]
    count = len(tables[0])
    head = [
        f"{word} {' '.join(name for name, _ in fields)}",
        f"SIZE {' '.join(str(each.itemsize) for each in tables)}",
        f"TYPE {' '.join({'f': 'F', 'u': 'U', 'i': 'I'}[each.dtype.kind] for each in tables)}",
        f"COUNT {' '.join(str(each.shape[1]) for each in tables)}",
        *(f"WIDTH {count // height}", f"HEIGHT {height}", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {count}"),
    ]
    start = ("# .PCD v0.7\nVERSION 0.7\n" + "\n".join(head) + f"\nDATA {form}\n").encode()
    if form == "ascii":
        rows = zip(*(each.tolist() for each in tables), strict=True)
        return start + "\n".join(" ".join(repr(value) for part in row for value in part) for row in rows).encode()
    if form == "binary":
        return start + b"".join(each[row].tobytes() for row in range(count) for each in tables)
    plain = b"".join(each.tobytes() for each in tables)
    squeezed = lzf_compress(plain)
    return start + struct.pack("<II", len(squeezed), len(plain)) + squeezed


def las(chance: Random) -> Made:
    """Colours of 8 or 16 bits, never filled, or none; units in feet, of heights others; 0 0 0 for no return."""
    import laspy

    xyz, rgb = scan(chance)
    newer = chance.random() < 0.5
    form = chance.choice((6, 7, 8) if newer else (0, 1, 2, 3))
    made = laspy.create(point_format=form, file_version="1.4" if newer else chance.choice(("1.2", "1.3")))
    unit, height = chance.choice(((None, None), ("metre", None), ("foot", None), ("foot", "metre"), ("metre", "foot")))
    metres = np.array([FEET if each == "foot" else 1.0 for each in (unit, unit, height or unit)])
    gone = some_missing(chance, len(xyz)) if np.abs(xyz).max() < 1e4 else np.zeros(len(xyz), bool)
    gone = gone if gone.sum() >= 3 else np.zeros(len(xyz), bool)
    made.header.scales, made.header.offsets = np.full(3, 1e-4), np.floor(xyz.min(axis=0))
    made.x, made.y, made.z = np.where(gone[:, None], 0.0, xyz).T
    way, meant = _las_colours(chance, made, rgb, coloured=form in (2, 3, 7, 8))
    if unit is not None:
        made.header.vlrs.append(laspy.VLR("LASF_Projection", *_reference(unit, height, wkt=newer)))
    if chance.random() < 0.3:
        made.add_extra_dim(laspy.ExtraBytesParams("deviation", "uint16"))
    suffix = "laz" if chance.random() < 0.1 else "las"
    stream = io.BytesIO()
    made.write(stream, do_compress=suffix == "laz")
    truth = Truth((xyz * metres)[~gone], None if meant is None else meant[~gone], near=1e-3)
    return f"uav.{suffix}", stream.getvalue(), f"{suffix}, {way}, {unit}", truth


FEET = 1200 / 3937
"""Metres of a US survey foot."""


def _las_colours(chance: Random, made: Any, rgb: np.ndarray, *, coloured: bool) -> tuple[str, np.ndarray | None]:
    """Fill the colours of a LAS; return a word for how, and what they mean."""
    ways = ("16 bits", "8 bits", "8 bits, one beyond", "intensity", "nothing")
    way = chance.choice(ways if coloured else ways[3:])
    if way in ("nothing", "intensity"):
        if way == "nothing":
            return way, None
        shades = np.minimum(40 * rgb[:, 0], 65_535)
        made.intensity = shades
        grey = np.clip(np.rint(255 * rgb[:, 0] / np.quantile(rgb[:, 0], 0.98)), 0, 255)
        return "unfilled with intensity", np.repeat(grey[:, None], 3, axis=1)
    stored = rgb.astype(np.uint16) * (257 if way == "16 bits" else 1)
    if way == "8 bits, one beyond":
        stored[9, 1] = 300
        rgb = rgb.copy()
        rgb[9, 1] = 255
    made.red, made.green, made.blue = stored.T
    return way, rgb


def _reference(unit: str, height: str | None, *, wkt: bool) -> tuple[int, str, bytes]:
    """The record of a coordinate reference system: its number, what it says of itself, and its content."""
    metres = {"metre": 1.0, "foot": FEET}
    if wkt:
        text = f'PROJCS["x",GEOGCS["y",UNIT["degree",0.0174532925199433]],UNIT["{unit}",{metres[unit]!r}]]'
        if height is not None:
            text = f'COMPD_CS["z",{text},VERT_CS["h",VERT_DATUM["d",2005],UNIT["{height}",{metres[height]!r}]]]'
        return 2112, "", text.encode() + b"\0"
    code = {"metre": 9001, "foot": 9003}
    rows = [(1024, 1), (3076, code[unit]), *([(4099, code[height])] if height is not None else [])]
    words = [1, 1, 0, len(rows), *(word for key, value in rows for word in (key, 0, 1, value))]
    return 34735, "", struct.pack(f"<{len(words)}H", *words)


@contextmanager
def colours_up_to(top: float) -> Iterator[None]:
    """Make pye57, which writes bytes alone, write colours of 0 to `top`: whole numbers where that is one, or floats."""
    from pye57 import e57

    real = e57.libe57

    def number(image: Any, *values: Any) -> Any:
        if values not in ((255,), (0, 0, 255)):
            return real.IntegerNode(image, *values)
        if isinstance(top, int):
            return real.IntegerNode(image, *(top if each == 255 else each for each in values))
        single = (0.0, real.E57_SINGLE, 0.0, top)
        return real.FloatNode(image, *(single if len(values) == 3 else (top,)))

    names = {name: getattr(real, name) for name in dir(real)}
    channels = dict.fromkeys(("colorRed", "colorGreen", "colorBlue"), "H" if isinstance(top, int) else "f")
    with (
        patch.object(e57, "libe57", SimpleNamespace(**{**names, "IntegerNode": number})),
        patch.object(e57, "SUPPORTED_POINT_FIELDS", {**e57.SUPPORTED_POINT_FIELDS, **channels}),
    ):
        yield


def e57(chance: Random) -> Made:
    """Scans with poses, colours of any range, invalid points, or an intensity alone."""
    way = chance.choice(("bytes", "10 bits", "16 bits", "floats", "intensity", "none"))
    top = {"10 bits": 1023, "16 bits": 65_535, "floats": 1.0}.get(way, 255)
    scans, poses, whole, colours = [], [], [], []
    for _ in range(chance.choice((1, 2))):
        xyz, rgb = scan(chance, survey=False)
        gone = some_missing(chance, len(xyz))
        stored = rgb / 255 if way == "floats" else np.rint(rgb / 255 * top).astype(np.uint16)
        columns = e57_scan(xyz, stored if way not in ("none", "intensity") else None)
        if way == "intensity":
            rgb[:2, 0] = 1, 255
            columns["intensity"] = rgb[:, 0] / 255
        if gone.any():
            columns["cartesianInvalidState"] = 2 * gone.astype(np.int8)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = _turned(chance), [chance.uniform(-9, 9) for _ in range(3)]
        scans, poses = [*scans, columns], [*poses, pose]
        whole.append((xyz @ pose[:3, :3].T + pose[:3, 3])[~gone])
        colours.append(rgb[~gone])
    with tempfile.TemporaryDirectory() as folder, colours_up_to(top):
        save_e57(Path(folder) / "a.e57", scans, poses)
        data = (Path(folder) / "a.e57").read_bytes()
    rgb = np.concatenate(colours)
    if way == "intensity":
        grey = np.clip(255 * (rgb[:, :1] - 1) / np.quantile(rgb[:, 0] - 1, 0.98), 0, 255)
        rgb = np.repeat(grey, 3, axis=1)
    truth = Truth(np.concatenate(whole), None if way == "none" else rgb, near=1e-4, shade=1.5)
    return "hall.e57", data, f"{len(scans)} scans, {way}", truth


def npy(chance: Random) -> Made:
    """An array in any order of bytes and of its axes, or records with names."""
    xyz, rgb = scan(chance)
    gone = some_missing(chance, len(xyz))
    kind = chance.choice(("<f8", ">f8"))
    xyz_stored = np.where(gone[:, None], np.nan, xyz)
    way = chance.choice(("rows", "Fortran's order", "records", "fractions"))
    if way == "records":
        names = [("X", kind), ("Y", kind), ("Z", kind), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
        array = np.zeros(len(xyz), names)
        for (name, _), column in zip(names, np.hstack([xyz_stored, rgb]).T, strict=True):
            array[name] = column
    else:
        array = np.hstack([xyz_stored, rgb / 255 if way == "fractions" else rgb]).astype(kind)
        array = np.asfortranarray(array) if way == "Fortran's order" else array
    return "scan.npy", npy_bytes(array), way, Truth(xyz[~gone], rgb[~gone], near=1e-9)
