"""Check glTF files, and rewrite them for trimesh: what it does not read of the format becomes arrays of floats.

trimesh takes normalised integers as they are stored, vertex colours, which are linear light, for sRGB, and the first
set of texture coordinates without its transform.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder, parse_json, translate_errors, truncated, unreadable
from capture2vr.edge.clouds.gltf_tree import FAN, POINTS, TRANSFORM, TRIANGLES, used_tree, without_unread
from capture2vr.edge.clouds.tables import MAX_POINTS, too_many_points
from capture2vr.edge.srgb import to_srgb
from capture2vr.sentences.sentence import say

LIGHT = "_LIGHT"
"""Vertex attribute of a rewritten glTF: its vertex colours (V,3) as linear light in [0,1]."""

_GLB_HEADER = 12
_BIN = b"BIN\0"
_FLOAT, _INDEX = 5126, 5125
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", _FLOAT: "<f4"}
_TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_GLOSS = "KHR_materials_pbrSpecularGlossiness"
_READ_EXTENSIONS = (TRANSFORM, "KHR_mesh_quantization", "EXT_texture_webp", "KHR_lights_punctual", "KHR_xmp_json_ld")
_SHADING = "KHR_materials_"  # begins the names of extensions that leave shape and base colour as they are
_UNCOMPRESSED = say("export_gltf_without_compression")
_ADVICE = {
    "KHR_draco_mesh_compression": _UNCOMPRESSED,
    "EXT_meshopt_compression": _UNCOMPRESSED,
    "KHR_meshopt_compression": _UNCOMPRESSED,
    "KHR_texture_basisu": say("export_textures_as_jpeg_png"),
}


def plain_gltf(
    data: bytes, kind: str, folder: Folder, file: str, beside: Mapping[str, bytes]
) -> tuple[bytes, dict[str, bytes]]:
    """Check a file of `kind` "glb" or "gltf" and rewrite it -> the JSON of a .gltf, and its buffers by their URIs.

    beside: the files that it refers to. Positions are then numbers as they are meant, TEXCOORD_0 is of the base colour
    texture, with its transform, and LIGHT has the vertex colours.
    Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
    """
    if kind == "glb":
        tree, chunk = _glb_parts(data, file)
    else:
        tree, chunk = parse_json(data.decode("utf-8-sig", "replace"), file), b""
    _check(tree, folder, file)
    with translate_errors(file, "glTF"):
        for material in tree.get("materials", []):
            _take_diffuse(material)
        tree = used_tree(tree, file)
        buffers = _Buffers(tree, chunk, beside, file)
        for mesh in tree["meshes"]:
            for primitive in mesh["primitives"]:
                primitive["attributes"] = _plain_attributes(primitive, tree, buffers)
                if primitive.get("mode") == FAN:
                    primitive |= {"mode": TRIANGLES, "indices": buffers.add_fan(primitive)}
        plain = without_unread(tree, sum(map(len, buffers.contents.values())), file)
        return json.dumps(plain).encode(), buffers.contents


def _glb_parts(data: bytes, file: str) -> tuple[dict[str, Any], bytes]:
    """The JSON chunk of a GLB, parsed, and its binary chunk, which may be missing."""
    if len(data) < _GLB_HEADER + 8:
        raise truncated(file, say("cut_off_inside_glb_header"))
    total, length = struct.unpack_from("<I", data, 8)[0], struct.unpack_from("<I", data, _GLB_HEADER)[0]
    if max(total, length) > len(data):
        what = say("bytes_but", count=max(total, length), size=len(data))
        raise truncated(file, say("cut_off_header_announces", what=what))
    at = _GLB_HEADER + 8 + length
    tree = parse_json(data[_GLB_HEADER + 8 : at].decode("utf-8", "replace"), file)
    while at + 8 <= len(data):
        size, name = struct.unpack_from("<I4s", data, at)
        if at + 8 + size > len(data):
            raise truncated(file, say("cut_off_inside_chunk_bytes", size=size))
        if name == _BIN:
            return tree, data[at + 8 : at + 8 + size]
        at += 8 + size
    return tree, b""


def _check(tree: dict[str, Any], folder: Folder, file: str) -> None:
    """Refuse a glTF with too large counts, extensions that are not read, or buffer files that are missing or outside.

    trimesh would allocate memory or open the files before it notices.
    """
    with translate_errors(file, "glTF"):
        for name in tree.get("extensionsRequired", []):
            if name not in _READ_EXTENSIONS and not str(name).startswith(_SHADING):
                advice = _ADVICE.get(name, say("export_gltf_without_extension"))
                raise unreadable(file, say("needs_not_supported", name=str(name)[:120]), advice)
        for accessor in tree.get("accessors", []):
            if int(accessor["count"]) > 3 * MAX_POINTS:
                raise too_many_points(int(accessor["count"]), file)
        unbacked = sum(int(accessor["count"]) for accessor in tree.get("accessors", []) if "bufferView" not in accessor)
        if unbacked > MAX_POINTS:  # zeros that need no bytes in the file
            raise too_many_points(unbacked, file)
        _check_buffers(tree, folder, file)


def _check_buffers(tree: dict[str, Any], folder: Folder, file: str) -> None:
    """Refuse a glTF whose buffer files are missing or outside."""
    for buffer in tree.get("buffers", []):
        uri = buffer.get("uri", "data:")
        if not uri.startswith("data:") and find_uri(folder, file, uri) is None:
            hint = say("send_bin_file_together")
            raise unreadable(file, say("refers_to_missing", name=repr(uri[:120])), hint)


def find_uri(folder: Folder, file: str, uri: str) -> str | None:
    """Return the name of the file that a URI in a mesh file refers to, or None; `%20` is a space.

    Raises CAPTURE_UNREADABLE for one outside the capture.
    """
    return folder.find(uri, by=file) or folder.find(unquote(uri), by=file)


class _Buffers:
    """Reads the accessors of a glTF, and adds accessors of floats to its tree, each with a buffer of its own.

    contents: all buffers by URIs that no file can have
    """

    def __init__(self, tree: dict[str, Any], chunk: bytes, beside: Mapping[str, bytes], file: str) -> None:
        self._tree, self._file = tree, file
        self._left = 3 * MAX_POINTS  # rows of new accessors: a hostile file has each row used by many primitives
        self._added: dict[tuple[int, str], int] = {}
        self.contents: dict[str, bytes] = {}
        for table in ("buffers", "bufferViews", "accessors"):
            tree.setdefault(table, [])
        read: dict[str | None, bytes] = {None: chunk}  # a buffer without a URI is the GLB's
        for buffer in tree["buffers"]:
            uri = buffer.get("uri")
            if uri not in read:
                read[uri] = base64.b64decode(uri.partition("base64,")[2]) if "base64," in uri else beside[uri]
            buffer["uri"] = self._keep(read[uri])

    def _keep(self, content: bytes) -> str:
        uri = f"\0{len(self.contents)}"
        self.contents[uri] = content
        return uri

    def is_plain(self, index: int) -> bool:
        """Whether trimesh reads an accessor as it is meant."""
        accessor = self._tree["accessors"][index]
        return not accessor.get("normalized", False) and "sparse" not in accessor

    def add(self, index: int, name: str, change: Callable[[NDArray[Any]], NDArray[Any]]) -> int:
        """Add what `change`, called `name`, makes of an accessor's rows (N,k); return the index of the new accessor.

        Normalised integers come to it as the fractions that they mean.
        """
        if (index, name) not in self._added:
            with np.errstate(over="ignore", invalid="ignore"):
                rows = self._rows(index)
                if self._tree["accessors"][index].get("normalized", False):
                    rows = _unit(rows)
                rows = np.ascontiguousarray(change(rows), "<f4")
            self._added[index, name] = self._keep_accessor(rows, _FLOAT, f"VEC{rows.shape[1]}")
        return self._added[index, name]

    def add_fan(self, primitive: dict[str, Any]) -> int:
        """Add the indices of the triangles of a fan; return the index of their accessor."""
        if "indices" in primitive:
            corners = self._rows(primitive["indices"])[:, 0]
        else:
            corners = np.arange(self._tree["accessors"][primitive["attributes"]["POSITION"]]["count"])
        inner = np.arange(1, max(1, len(corners) - 1))
        triangles = np.ascontiguousarray(corners[np.stack([0 * inner, inner, inner + 1], axis=1)], "<u4")
        return self._keep_accessor(triangles.reshape(-1, 1), _INDEX, "SCALAR")

    def _keep_accessor(self, rows: NDArray[Any], component: int, kind: str) -> int:
        """Add an accessor of rows, with a buffer of their own; return its index."""
        view = {"buffer": len(self._tree["buffers"]), "byteLength": rows.nbytes}
        place = {"bufferView": len(self._tree["bufferViews"]), "count": len(rows), "componentType": component}
        self._tree["buffers"].append({"uri": self._keep(rows.tobytes()), "byteLength": rows.nbytes})
        self._tree["bufferViews"].append(view)
        self._tree["accessors"].append(place | {"type": kind})
        return len(self._tree["accessors"]) - 1

    def _rows(self, index: int) -> NDArray[Any]:
        """The rows (N,k) of an accessor, as they are stored."""
        accessor = self._tree["accessors"][index]
        kind, width, count = np.dtype(_KINDS[accessor["componentType"]]), _TYPES[accessor["type"]], accessor["count"]
        self._left -= count
        if self._left < 0:
            raise too_many_points(3 * MAX_POINTS - self._left, self._file)
        rows = (
            self._stored(accessor, kind, count, width) if "bufferView" in accessor else np.zeros((count, width), kind)
        )
        if "sparse" not in accessor:
            return rows
        sparse, rows = accessor["sparse"], rows.copy()  # some rows replace those of the buffer, or zeros
        places = np.dtype(_KINDS[sparse["indices"]["componentType"]])
        replaced = self._stored(sparse["indices"], places, sparse["count"], 1)[:, 0]
        rows[replaced] = self._stored(sparse["values"], kind, sparse["count"], width)
        return rows

    def _stored(self, place: dict[str, Any], kind: np.dtype[Any], count: int, width: int) -> NDArray[Any]:
        """The rows (count,width) that begin at a byte offset of a buffer view."""
        view = self._tree["bufferViews"][place["bufferView"]]
        start, step = view.get("byteOffset", 0), view.get("byteStride", width * kind.itemsize)
        if step <= 0:
            raise ValueError(say("bytestride_not_positive"))
        data = memoryview(self.contents[self._tree["buffers"][view["buffer"]]["uri"]])
        data = data[start : start + view["byteLength"]]
        return np.ndarray((count, width), kind, data, place.get("byteOffset", 0), (step, kind.itemsize))


def _plain_attributes(primitive: dict[str, Any], tree: dict[str, Any], buffers: _Buffers) -> dict[str, int]:
    """The attributes that are used of a primitive: POSITION, and TEXCOORD_0 and LIGHT where it has them; of points
    COLOR_0, in sRGB."""
    attributes: dict[str, int] = primitive["attributes"]
    position = attributes["POSITION"]
    is_plain = buffers.is_plain(position)
    plain = {"POSITION": position if is_plain else buffers.add(position, "as meant", lambda rows: rows)}
    material = tree["materials"][primitive["material"]] if "material" in primitive else {}
    texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
    if texture is not None:
        uv = attributes.get(f"TEXCOORD_{texture['texCoord']}")
        if uv is not None:
            plain["TEXCOORD_0"] = _plain_uv(uv, texture["transform"], buffers)
    if "COLOR_0" in attributes and primitive.get("mode") == POINTS:  # trimesh keeps no attributes of points
        plain["COLOR_0"] = buffers.add(attributes["COLOR_0"], "sRGB", lambda rows: to_srgb(_light(rows)) / 255)
    elif "COLOR_0" in attributes:
        plain[LIGHT] = buffers.add(attributes["COLOR_0"], "light", _light)
    return plain


def _plain_uv(uv: int, transform: dict[str, Any], buffers: _Buffers) -> int:
    """The accessor of texture coordinates that need no transform: `uv` itself, or a new one."""
    if buffers.is_plain(uv) and not transform:
        return uv
    return buffers.add(uv, f"uv {json.dumps(transform)}", lambda rows: _transformed(rows, transform))


def _unit(rows: NDArray[Any]) -> Floats:
    """Scale integers to [0,1], signed ones to [-1,1], as the format's section 3.6.2.2 says; floats stay."""
    if rows.dtype.kind == "f":
        return rows
    floats: Floats = np.maximum(rows / np.float32(np.iinfo(rows.dtype).max), np.float32(-1))
    return floats


def _light(rows: NDArray[Any]) -> Floats:
    """Linear light (N,3) in [0,1] of COLOR_0 with or without alpha; its integers are always normalised."""
    if rows.shape[1] < 3:
        raise ValueError(say("vertex_colours_have_fewer_than"))
    return np.clip(np.nan_to_num(_unit(rows[:, :3])), 0, 1)


def _transformed(uv: NDArray[Any], transform: dict[str, Any]) -> Floats:
    """Transform texture coordinates (N,2) by KHR_texture_transform: scale, then rotate, then move them.

    Counter-clockwise where v runs down, as in the picture: the extension's GLSL turns the other way, its example and
    the viewers do not.
    """
    scale = np.asarray(transform.get("scale", (1, 1)), np.float64).reshape(2)
    offset = np.asarray(transform.get("offset", (0, 0)), np.float64).reshape(2)
    turn = float(transform.get("rotation", 0))
    c, s = np.cos(turn), np.sin(turn)
    moved: Floats = (uv[:, :2] * scale) @ np.array([[c, -s], [s, c]]) + offset
    return moved


def _take_diffuse(material: dict[str, Any]) -> None:
    """Make the diffuse colour and texture of an older material (specular and glossiness) the base colour."""
    gloss = material.get("extensions", {}).pop(_GLOSS, None)
    if gloss is not None:
        base = {"baseColorFactor": gloss.get("diffuseFactor", [1.0] * 4)}
        if "diffuseTexture" in gloss:
            base["baseColorTexture"] = gloss["diffuseTexture"]
        material["pbrMetallicRoughness"] = base
