"""Open glTF files: check what they announce, and read the rows of their accessors as the numbers that are meant."""

from __future__ import annotations

import base64
import struct
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.capture.files import Folder, parse_json, truncated, unreadable
from capture2vr.edge.capture.images import read_bytes
from capture2vr.edge.clouds.tables import MAX_POINTS, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MAX_NODES = 5_000  # and edges between them
MAX_PARTS = 20_000  # primitives, those of a mesh as often as nodes show it: each takes some tenths of a millisecond
_MOST = {"meshes": MAX_PARTS, "accessors": 100_000, "bufferViews": 100_000, "buffers": 1_000, "scenes": 1_000}
_MOST |= {"nodes": MAX_NODES, "materials": 5_000, "textures": 5_000, "images": 5_000, "skins": MAX_NODES}
_GLB_HEADER = 12
_BIN = b"BIN\0"
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_READ = {
    *("KHR_texture_transform", "KHR_mesh_quantization", "EXT_texture_webp", "EXT_mesh_gpu_instancing"),
    *("KHR_node_visibility", "KHR_lights_punctual", "KHR_animation_pointer", "KHR_xmp_json_ld", "FB_ngon_encoding"),
    *("EXT_mesh_features", "EXT_instance_features", "EXT_structural_metadata"),
}
_SHADING = "KHR_materials_"  # begins the names of extensions that leave shape and base colour as they are
_UNCOMPRESSED = say("export_gltf_without_compression")
DRACO = "KHR_draco_mesh_compression"
_ADVICE = {
    DRACO: _UNCOMPRESSED,
    "EXT_meshopt_compression": _UNCOMPRESSED,
    "KHR_meshopt_compression": _UNCOMPRESSED,
    "KHR_texture_basisu": say("export_textures_as_jpeg_png"),
}


def too_many_entries(name: str, count: int, most: int, file: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a glTF with so many entries under a name."""
    return too_complex(say("has_too_many_entries_under", count=count, name=name, most=most), file)


def too_complex(what: str, file: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a scene of too many parts."""
    return CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("join_meshes_scene_into"),))


class GltfFile:
    """An open glTF 2.0.

    tree: its JSON; absent: the URIs of files that were asked for, and are not in the capture
    """

    def __init__(self, folder: Folder, file: str, kind: str) -> None:
        """Open a file of `kind` "glb" or "gltf", and check its counts, its extensions and the names of its buffers.

        Raises CAPTURE_UNREADABLE, CAPTURE_TRUNCATED and CAPTURE_TOO_LARGE.
        """
        data = read_bytes(folder.path(file), file)
        if kind == "glb":
            self.tree, self._chunk = _glb_parts(data, file)
        else:
            self.tree, self._chunk = parse_json(data.decode("utf-8-sig", "replace"), file), b""
        self.file, self._folder = file, folder
        self.absent: list[str] = []
        self._left = 3 * MAX_POINTS  # rows: a hostile file has each used by many primitives
        self._read: dict[str, bytes] = {}  # files and buffers, by their URIs
        self._rows: dict[int, NDArray[Any]] = {}  # of sparse accessors
        self._check()

    def _check(self) -> None:
        tree = self.tree
        if str(tree.get("asset", {}).get("version", "2.0")).startswith("1.") or isinstance(tree.get("meshes"), dict):
            raise unreadable(self.file, say("needs_not_supported", name="glTF 1.0"))
        for name in tree.get("extensionsRequired", []):
            if name not in _READ and not str(name).startswith(_SHADING):
                raise self.unsupported(str(name))
        for name, most in _MOST.items():
            if (count := len(tree.get(name, []))) > most:
                raise too_many_entries(name, count, most, self.file)
        for accessor in tree.get("accessors", []):
            if int(accessor["count"]) > 3 * MAX_POINTS:
                raise too_many_points(int(accessor["count"]), self.file)
        self._check_buffers()

    def _check_buffers(self) -> None:
        for buffer in self.tree.get("buffers", []):
            uri = buffer.get("uri", "data:")
            if not uri.startswith("data:") and self._find(uri) is None:
                hint = say("send_bin_file_together")
                raise unreadable(self.file, say("refers_to_missing", name=repr(uri[:120])), hint)

    def unsupported(self, name: str) -> CaptureError:
        """Return a CAPTURE_UNREADABLE error that the file needs this extension."""
        advice = _ADVICE.get(name, say("export_gltf_without_extension"))
        return unreadable(self.file, say("needs_not_supported", name=name[:120]), advice)

    def unread_extensions(self) -> list[str]:
        """Name the extensions that the file uses and that are not read; what is compressed comes uncompressed too."""
        used = sorted({str(name)[:120] for name in self.tree.get("extensionsUsed", [])})
        return [name for name in used if not name.startswith(_SHADING) and name not in _READ | _ADVICE.keys()]

    def entry(self, name: str, index: object) -> dict[str, Any]:
        """Return an entry of one of the tree's tables. Raises ValueError where there is none."""
        table = self.tree.get(name, [])
        if not isinstance(index, int) or not 0 <= index < len(table):
            raise no_entry(name, index)
        found: dict[str, Any] = table[index]
        return found

    def _find(self, uri: str) -> str | None:
        """Return the name of the file that a URI refers to, or None; `%20` is a space."""
        return self._folder.find(uri, by=self.file) or self._folder.find(unquote(uri), by=self.file)

    def content(self, uri: str) -> bytes | None:
        """Read what a URI refers to; None for a file that is not in the capture.

        Raises CAPTURE_UNREADABLE for one outside the capture.
        """
        if uri not in self._read:
            if uri.startswith("data:"):
                head, _, rest = uri.partition(",")
                self._read[uri] = base64.b64decode(rest) if head.endswith("base64") else unquote_to_bytes(rest)
            elif (name := self._find(uri)) is not None:
                self._read[uri] = read_bytes(self._folder.path(name), name)
            else:
                self.absent.append(uri)
                return None
        return self._read[uri]

    def view(self, index: object) -> memoryview:
        """Return the bytes of a buffer view; a buffer without a URI is the GLB's."""
        view = self.entry("bufferViews", index)
        uri = self.entry("buffers", view["buffer"]).get("uri")
        start = view.get("byteOffset", 0)
        return memoryview(self._chunk if uri is None else self.content(uri) or b"")[start : start + view["byteLength"]]

    def count(self, index: object) -> int:
        """Return the number of an accessor's rows."""
        return int(self.entry("accessors", index)["count"])

    def floats(self, index: object, used: Ints | None = None, *, fractions: bool = False) -> Floats:
        """Read the rows (N,k) of an accessor, or those that are used: normalised integers as the fractions they mean.

        fractions: its integers are fractions whether it says so or not
        """
        rows = self.rows(index) if used is None else self.rows(index)[used]
        self.spend(len(rows))
        if rows.dtype.kind == "f" or not (fractions or self.entry("accessors", index).get("normalized", False)):
            return rows.astype(np.float64)
        return np.maximum(rows / np.iinfo(rows.dtype).max, -1.0)  # glTF 2.0, section 3.6.2.2

    def spend(self, rows: int) -> None:
        """Count rows that are worked with. Raises CAPTURE_TOO_LARGE when they are too many."""
        self._left -= rows
        if self._left < 0:
            raise too_many_points(3 * MAX_POINTS - self._left, self.file)

    def rows(self, index: object) -> NDArray[Any]:
        """Return the rows (N,k) of an accessor as they are stored, which is no copy unless they are sparse."""
        accessor = self.entry("accessors", index)
        kind, width, count = np.dtype(_KINDS[accessor["componentType"]]), _TYPES[accessor["type"]], accessor["count"]
        if "sparse" not in accessor:
            return self._stored(accessor, kind, count, width)
        number = int(str(index))
        if number not in self._rows:
            self.spend(count)
            sparse, rows = accessor["sparse"], self._stored(accessor, kind, count, width).copy()
            places = self._stored(
                sparse["indices"], np.dtype(_KINDS[sparse["indices"]["componentType"]]), sparse["count"], 1
            )
            rows[places[:, 0]] = self._stored(sparse["values"], kind, sparse["count"], width)
            self._rows[number] = rows
        return self._rows[number]

    def _stored(self, place: dict[str, Any], kind: np.dtype[Any], count: int, width: int) -> NDArray[Any]:
        """Return the rows (count,width) that begin at a byte offset of a buffer view; zeros where there is no view."""
        if "bufferView" not in place:
            return np.broadcast_to(np.zeros(1, kind), (count, width))
        step = self.entry("bufferViews", place["bufferView"]).get("byteStride", width * kind.itemsize)
        if step <= 0:
            raise ValueError(say("bytestride_not_positive"))
        data = self.view(place["bufferView"])
        return np.ndarray((count, width), kind, data, place.get("byteOffset", 0), (step, kind.itemsize))


def no_entry(name: str, index: object) -> ValueError:
    """Return the error that a table has no entry of this number."""
    return ValueError(say("has_no_entry_of_number", name=name, number=str(index)[:40]))


def _glb_parts(data: bytes, file: str) -> tuple[dict[str, Any], bytes]:
    """Return the JSON chunk of a GLB, parsed, and its binary chunk, which may be missing."""
    if len(data) < _GLB_HEADER + 8:
        raise truncated(file, say("cut_off_inside_glb_header"))
    total, length = struct.unpack_from("<I", data, 8)[0], struct.unpack_from("<I", data, _GLB_HEADER)[0]
    if max(total, length) > len(data):
        what = say("bytes_but", count=max(total, length), size=len(data))
        raise truncated(file, say("cut_off_header_announces", what=what))
    at = _GLB_HEADER + 8 + length
    tree = parse_json(data[_GLB_HEADER + 8 : at].decode("utf-8", "replace"), file)
    if data[4] == 1:
        return tree, b""  # refused by its version
    while at + 8 <= len(data):
        size, name = struct.unpack_from("<I4s", data, at)
        if at + 8 + size > len(data):
            raise truncated(file, say("cut_off_inside_chunk_bytes", size=size))
        if name == _BIN:
            return tree, data[at + 8 : at + 8 + size]
        at += 8 + size
    return tree, b""
