"""Meshes that are valid and odd, with the triangles and colours that they mean, each drawn by chance."""

from __future__ import annotations

import base64
import io
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

import numpy as np
from PIL import Image

from capture2vr.edge.srgb import to_linear
from tests.support.gltf_files import GltfWriter
from tests.support.odd.clouds import Made, scan, with_remarks
from tests.support.odd.ply_bytes import ply
from tests.support.odd.random_gltf import random_file
from tests.support.odd.truth import Truth

_APART = 3.0  # metres between the middles of pieces: whose radius is at most one


@dataclass(frozen=True, slots=True)
class Piece:
    """A flat polygon, seen whole from its middle (3,) and mostly concave: corners (N,3), and its colour."""

    middle: np.ndarray
    corners: np.ndarray
    colour: tuple[int, int, int]

    @property
    def triangles(self) -> np.ndarray:
        """(N,3,3) what it covers."""
        following = np.roll(self.corners, -1, axis=0)
        return np.stack([np.broadcast_to(self.middle, self.corners.shape), self.corners, following], axis=1)


def pieces(chance: Random, most: int = 5) -> list[Piece]:
    """Some pieces beside each other, turned in any way."""
    made = []
    for number in range(chance.randint(2, most)):
        count = chance.choice((3, 4, 4, 5, 7, 12))
        turns = np.sort((np.arange(count) + [chance.uniform(-0.2, 0.2) for _ in range(count)]) * 2 * np.pi / count)
        # Of triangles and quads the middle would not see all of a side that is bent in too far.
        radii = np.array([chance.uniform(0.7 if count < 5 else 0.25, 1.0) for _ in range(count)])
        basis, _ = np.linalg.qr(np.random.default_rng(chance.getrandbits(32)).normal(size=(3, 3)))
        middle = np.array([_APART * number, 0.5, 0.1 * number])
        flat = np.stack([radii * np.cos(turns), radii * np.sin(turns)], axis=1)
        colour = (chance.randint(1, 255), chance.randint(1, 255), chance.randint(1, 255))
        made.append(Piece(np.round(middle, 4), middle + flat @ basis[:2], colour))
    return made


def truth_of(made: Sequence[Piece], *, coloured: bool, near: float = 1e-4, shade: float = 1.0) -> Truth:
    """What pieces mean."""
    triangles = np.concatenate([each.triangles for each in made])
    rgb = np.concatenate([np.tile(each.colour, (len(each.corners), 1)) for each in made])
    return Truth(triangles, rgb if coloured else None, is_surface=True, near=near, shade=shade)


def _joined(made: Sequence[Piece]) -> tuple[np.ndarray, list[list[int]], np.ndarray]:
    """Corners (V,3) of all pieces, the polygons of their numbers, and the colours (V,3) of the corners."""
    starts = np.cumsum([0, *(len(each.corners) for each in made)])
    polygons = [list(range(start, start + len(each.corners))) for start, each in zip(starts, made, strict=False)]
    colours = np.concatenate([np.tile(each.colour, (len(each.corners), 1)) for each in made])
    return np.concatenate([each.corners for each in made]), polygons, colours


def ply_mesh(chance: Random) -> Made:
    """Polygons with scalars and lists before their corners, and colours of vertices or of faces; faces first, too."""
    made = pieces(chance)
    xyz, polygons, rgb = _joined(made)
    way = chance.choice(("vertex colours", "face colours", "no colours"))
    vertex: list[tuple[tuple[str, str], Sequence[Any]]] = [
        ((chance.choice(("float", "double")), name), xyz[:, axis].tolist()) for axis, name in enumerate("xyz")
    ]
    face: list[tuple[tuple[str, str], Sequence[Any]]] = [
        (
            (
                f"{chance.choice(('uchar', 'int'))} {chance.choice(('int', 'uint'))}",
                chance.choice(("vertex_indices", "vertex_index")),
            ),
            polygons,
        ),
        *chance.sample(
            [
                (("uchar", "flags"), [7] * len(polygons)),
                (("uchar float", "texcoord"), [[0.5] * (2 * len(each)) for each in polygons]),
                (("int", "material"), [1] * len(polygons)),
            ],
            chance.choice((0, 1, 3)),
        ),
    ]
    for at, name in enumerate(("red", "green", "blue")):
        if way == "vertex colours":
            vertex.append((("uchar", name), rgb[:, at].tolist()))
        if way == "face colours":
            face.append((("uchar", name), [each.colour[at] for each in made]))
    case = chance.choice((str.lower, str.lower, str.upper))
    elements = [
        (
            case(name),
            [(kind, case(each)) for (kind, each), _ in columns],
            list(zip(*(values for _, values in columns), strict=True)),
        )
        for name, columns in (("vertex", _shuffled(chance, vertex)), ("face", _shuffled(chance, face)))
    ]
    form = chance.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    data = with_remarks(chance, ply(form, _shuffled(chance, elements)))
    return "mesh.ply", data, f"{form}, {way}", truth_of(made, coloured=way != "no colours")


def _shuffled(chance: Random, values: Sequence[Any]) -> list[Any]:
    return chance.sample(values, len(values))


def picture(colours: Sequence[tuple[int, int, int]], form: str) -> bytes:
    """A picture with a square of 8 pixels for each colour, in a row."""
    pixels = np.repeat(np.repeat(np.array([colours], np.uint8), 8, axis=0), 8, axis=1)
    image = Image.fromarray(pixels)
    if form == "palette":
        image = image.quantize(len(colours) + 1, dither=Image.Dither.NONE)
    stream = io.BytesIO()
    settings: dict[str, Any] = {"webp": {"lossless": True}, "jpeg": {"quality": 95, "subsampling": 0}}.get(form, {})
    image.save(stream, {"palette": "PNG"}.get(form, form.upper()), **settings)
    return stream.getvalue()


@dataclass(frozen=True, slots=True)
class _ObjWay:
    """How an OBJ is written. colours: "vertices", "some vertices", "materials", "texture", "none"."""

    colours: str
    relative: bool
    grouped: bool
    continued: bool
    normals: bool
    encoding: str
    ends: str


def obj(chance: Random) -> Made | tuple[dict[str, bytes], str, Truth]:
    """Relative indices, groups, lines that go on, any encoding, and colours of all kinds."""
    made = pieces(chance)
    way = _ObjWay(
        chance.choice(("vertices", "some vertices", "materials", "texture", "none")),
        *(chance.random() < 0.4 for _ in range(4)),
        chance.choice(("utf-8", "utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-be")),
        chance.choice(("\n", "\r\n")),
    )
    stem = chance.choice(("scan", "Möbel", "my scan (2)"))
    form = chance.choice(("png", "jpeg", "bmp", "webp", "tiff", "palette"))
    painted = f"{chance.choice(('paint', 'Wäsche', 'my paint'))}.{'png' if form == 'palette' else form}"
    text = way.ends.join(_obj_lines(chance, way, made, stem))
    files = {f"{stem}.obj": text.encode(way.encoding)}
    if way.colours in ("materials", "texture"):
        files[f"{stem}.mtl"] = way.ends.join(_mtl_lines(chance, way, made, painted)).encode(way.encoding)
    if way.colours == "texture":
        files[painted] = picture([each.colour for each in made], form)
    shade = 4.0 if form == "jpeg" and way.colours == "texture" else 1.0
    if way.colours == "some vertices":
        made = [*made[:1], *_mean_coloured(made)]
        shade = 1.5
    truth = truth_of(made, coloured=way.colours != "none", near=2e-4, shade=shade)
    if chance.random() < 0.2:
        files["Z other.mtl"] = b"newmtl other\nKd 1 0 1\n"
    return files, f"{way.colours}, {way.encoding}", truth


def _mean_coloured(made: Sequence[Piece]) -> list[Piece]:
    """All but the first, which alone has a colour, in that colour."""
    return [Piece(each.middle, each.corners, made[0].colour) for each in made[1:]]


def _obj_lines(chance: Random, way: _ObjWay, made: Sequence[Piece], stem: str) -> list[str]:
    lines = [
        "# Grüße",
        *([f"mtllib {chance.choice(('', './'))}{stem}.mtl"] if way.colours in ("materials", "texture") else []),
    ]
    count = 0
    for number, piece in enumerate(made):
        lines += [f"o Stück {number}", f"g left right{number}", "s off"] if way.grouped else []
        bare = way.colours not in ("vertices", "some vertices") or (way.colours == "some vertices" and number)
        tint = "" if bare else "".join(f" {value / 255:.4f}" for value in piece.colour)
        blank = chance.choice((" ", "  ", "\t"))
        lines += [f"v{blank}{x:.5f}{blank}{y:.5f} {z:.5f}{tint}" for x, y, z in piece.corners.tolist()]
        lines += [f"vt {(number + 0.5) / len(made):.5f} 0.5"] if way.colours == "texture" else []
        lines += ["vn 0 0 1"] if way.normals else []
        lines += [f"usemtl Stück {number}"] if way.colours in ("materials", "texture") else []
        size = len(piece.corners)
        numbers = [at - size if way.relative else count + at + 1 for at in range(size)]
        one = -1 if way.relative else number + 1
        textured = way.colours == "texture"
        ends = f"/{one if textured else ''}/{one}" if way.normals else f"/{one}" if textured else ""
        corners = [f"{each}{ends}" for each in numbers]
        half = size // 2
        lines += (
            [f"f {' '.join(corners[:half])} \\", " ".join(corners[half:])]
            if way.continued
            else ["f " + " ".join(corners)]
        )
        count += size
    return [*lines, ""]


def _mtl_lines(chance: Random, way: _ObjWay, made: Sequence[Piece], painted: str) -> list[str]:
    lines = []
    written = chance.choice((painted, f"./{painted}", f"C:\\Users\\me\\{painted}", f"-clamp on {painted}"))
    for number, piece in enumerate(made):
        lines += [f"newmtl Stück {number}", "Ka 0 0 0", "Ns 10"]
        if way.colours == "texture":
            lines += ["Kd 1 1 1", f"map_Kd {written}"]
        else:
            lines.append("Kd " + " ".join(f"{value / 255:.4f}" for value in piece.colour))
    return [*lines, ""]


def stl(chance: Random) -> Made:
    """Binary with anything in its head and bytes behind its end, or a text with any names, in any case."""
    made = pieces(chance)
    triangles = np.concatenate([each.triangles for each in made])
    if chance.random() < 0.5:
        head = chance.choice((b"made by hand", b"solid mesh", b"COLOR=\xff\0\0\xff", b"\0", b"  solid\tx facet"))
        facets = b"".join(bytes(12) + each.astype("<f4").tobytes() + b"\x1f\x80" for each in triangles)
        tail = bytes(chance.choice((0, 0, 2, 37, 500)))
        data = head.ljust(80, b"\0") + struct.pack("<I", len(triangles)) + facets + tail
        way = f"binary, {head[:5].decode('latin-1').strip()}, {len(tail)} bytes behind it"
        return chance.choice(("mesh.stl", "MESH.STL")), data, way, truth_of(made, coloured=False)
    names = ("", "mesh", "Würfel Größe 3", "facet normal", "endsolid", "a solid one", "vertex 1 2 3", "CATIA V5 (x=1)")
    lines: list[str] = []
    name = chance.choice(names)
    for part in np.array_split(triangles, chance.choice((1, 2, 3))):
        lines.append(f"solid {name}".rstrip())
        for each in part:
            lines += ["  facet normal 0 0 1", "    outer loop"]
            lines += [f"      vertex {x:.6e} {y:.6e} {z:.6e}" for x, y, z in each.tolist()]
            lines += ["    endloop", "  endfacet"]
        lines.append(f"endsolid {name}".rstrip() if chance.random() < 0.8 else "endsolid")
    text = chance.choice(("\n", "\r\n")).join([*lines, ""])
    text = chance.choice((str, str, str.upper, lambda each: each.replace("  ", "\t")))(text)
    data = text.encode(chance.choice(("utf-8", "cp1252")))
    return "mesh.stl", data, f"text, {name}", truth_of(made, coloured=False)


def off(chance: Random) -> Made:
    """Polygons, remarks, empty lines, counts in the first line, and colours of vertices or faces."""
    made = pieces(chance)
    xyz, polygons, rgb = _joined(made)
    way = chance.choice(("vertex colours", "face colours", "face colours as fractions", "no colours"))
    word, counts = "COFF" if way == "vertex colours" else "OFF", f"{len(xyz)} {len(polygons)} {chance.choice((0, 9))}"
    head = chance.choice(([word, counts], [f"{word} {counts}"], [word, "# Grüße", "", counts], [f"{word} # a", counts]))
    tints = [f" {r} {g} {b} 255" if way == "vertex colours" else "" for r, g, b in rgb.tolist()]
    lines = [*head, *(f"{x:.6f} {y:.6f}  {z:.6f}{tint}" for (x, y, z), tint in zip(xyz.tolist(), tints, strict=True))]
    lines += [chance.choice(("", "# faces"))] if chance.random() < 0.4 else []
    for number, piece in enumerate(made):
        shown = [f"{each / 255:.4f}" if "fractions" in way else str(each) for each in piece.colour]
        numbers = [len(polygons[number]), *polygons[number], *(shown if way.startswith("face") else [])]
        lines.append(" ".join(map(str, numbers)))
    data = (chance.choice(("\n", "\r\n")).join(lines) + "\n").encode()
    return "mesh.off", data, way, truth_of(made, coloured=way != "no colours")


def gltf(chance: Random) -> Made | tuple[dict[str, bytes], str, Truth]:
    """A scene of nodes, skins and instances; or coloured pieces as strips and fans; or points."""
    way = chance.choice(("scene", "pieces", "pieces", "points"))
    if way == "scene":
        made = random_file(
            chance.getrandbits(32),
            skin=chance.randrange(3),
            morphs=chance.randrange(4),
            instances=chance.random() < 0.5,
            mode=chance.choice((4, 5, 6)),
            kind=chance.choice(("f4", "i1", "u1", "i2", "u2")),
            sparse=chance.random() < 0.5,
        )
        if made.triangles:
            triangles = np.stack(made.triangles)
            truth = Truth(triangles, is_surface=True, near=1e-4 * (1 + float(np.abs(triangles).max())))
            return *_gltf_file(chance, made.writer), way, truth
    writer = GltfWriter(scene=0)
    return _gltf_points(chance, writer) if way == "points" else _gltf_pieces(chance, writer)


def _gltf_points(chance: Random, writer: GltfWriter) -> Made:
    xyz, rgb = scan(chance, survey=False)
    place = [chance.uniform(-5, 5) for _ in range(3)]
    attributes = {"POSITION": writer.add(xyz.astype("<f4"), sparse=chance.random() < 0.5)}
    coloured = chance.random() < 0.7
    if coloured:
        attributes["COLOR_0"] = writer.add(to_linear(rgb.astype(np.uint8)).astype("<f4"))
    writer.tree |= {
        "meshes": [{"primitives": [{"attributes": attributes, "mode": 0}]}],
        "nodes": [{"mesh": 0, "translation": place}],
        "scenes": [{"nodes": [0]}],
    }
    return *_gltf_file(chance, writer), "points", Truth(xyz + place, rgb if coloured else None, near=1e-4)


def _gltf_pieces(chance: Random, writer: GltfWriter) -> Made:
    """Each a fan about its middle, a strip or a list, with colours of its vertices, its material or its texture."""
    made = pieces(chance)
    way = chance.choice(("vertices", "factor", "texture", "emission", "none"))
    parts, materials = [], list[dict[str, Any]]()
    moved = chance.random() < 0.5  # of texture coordinates, by the extension
    for number, piece in enumerate(made):
        vertices = np.concatenate([[piece.middle], piece.corners]).astype("<f4")
        mode, indices = _indices(chance, len(piece.corners))
        attributes = {"POSITION": writer.add(vertices, sparse=chance.random() < 0.3)}
        part: dict[str, Any] = {"attributes": attributes, "mode": mode, "indices": writer.add(indices[:, None])}
        light = to_linear(np.array(piece.colour, np.uint8))
        if way == "vertices":
            attributes["COLOR_0"] = writer.add(np.tile(light, (len(vertices), 1)).astype("<f4"))
        at = (number + 0.5) / len(made)
        if way in ("texture", "emission"):
            where = np.tile([0.5, 0.5] if moved else [at, 0.5], (len(vertices), 1))
            attributes["TEXCOORD_0"] = writer.add(where.astype("<f4"))
        if way not in ("vertices", "none"):
            part["material"] = number
            transform = {"offset": [at - 0.25, 0.25], "scale": [0.5, 0.5]}
            texture = {"index": 0, **({"extensions": {"KHR_texture_transform": transform}} if moved else {})}
            materials.append(_material(way, light.tolist(), texture))
        parts.append(part)
    writer.tree |= {"meshes": [{"primitives": parts}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}
    if materials:
        writer.tree["materials"] = materials
    if way in ("texture", "emission"):
        pixels = np.repeat(np.repeat(np.array([[each.colour for each in made]], np.uint8), 8, axis=0), 8, axis=1)
        writer.tree["textures"] = [{"source": writer.picture(pixels)}]
    return *_gltf_file(chance, writer), f"pieces, {way}", truth_of(made, coloured=way != "none", shade=1.5)


def _material(way: str, light: list[float], texture: dict[str, Any]) -> dict[str, Any]:
    black = {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}, "emissiveFactor": [1, 1, 1]}
    return {
        "factor": {"pbrMetallicRoughness": {"baseColorFactor": [*light, 1]}},
        "texture": {"pbrMetallicRoughness": {"baseColorTexture": texture}},
        "emission": black | {"emissiveTexture": texture},
    }[way]


def _indices(chance: Random, count: int) -> tuple[int, np.ndarray]:
    """The mode and the indices of a piece, whose middle is vertex 0: a list, a strip or a fan."""
    kind = chance.choice(("u1", "<u2", "<u4"))
    rim = [*range(1, count + 1), 1]
    if (mode := chance.choice((4, 5, 6))) == 6:
        return mode, np.array([0, *rim], kind)
    if mode == 4:
        return mode, np.array([each for at in range(count) for each in (0, rim[at], rim[at + 1])], kind)
    # A strip of all triangles, between which there are some without an area.
    return mode, np.array([each for at in range(count) for each in (0, 0, rim[at], rim[at + 1], rim[at + 1], 0)], kind)


def _gltf_file(chance: Random, writer: GltfWriter) -> tuple[str, bytes]:
    """A GLB, or a text that has its buffer in itself, before its key `asset`."""
    data = writer.glb()
    if chance.random() < 0.6:
        return "scene.glb", data
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    uri = "data:application/octet-stream;base64," + base64.b64encode(data[28 + size :]).decode()
    tree["buffers"] = [{"uri": uri, "byteLength": len(data) - 28 - size}]
    late = {"buffers": tree.pop("buffers"), **{name: tree[name] for name in sorted(tree, reverse=True)}}
    return "scene.gltf", json.dumps(late).encode(chance.choice(("utf-8", "utf-8-sig")))


def obj_points(chance: Random) -> Made:
    """Vertices alone."""
    xyz, rgb = scan(chance, survey=False)
    way = chance.choice(("fractions", "bytes", "no colours"))
    shown = {"fractions": rgb / 255, "bytes": rgb, "no colours": np.zeros((len(rgb), 0))}[way]
    rows = [
        " ".join(["v", *(f"{each:.4f}" for each in (*point, *colour))])
        for point, colour in zip(xyz, shown, strict=True)
    ]
    truth = Truth(xyz, None if way == "no colours" else rgb)
    return "points.obj", ("\n".join([*rows, ""])).encode(), f"points, {way}", truth
