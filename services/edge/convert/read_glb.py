"""Read a level of detail back from a .glb that `export.glb` wrote, in either packing."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import meshopt
import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.export.glb import KTX2, ORIGIN
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.srgb import to_srgb

_TYPES = {5126: "<f4", 5120: "i1", 5121: "u1", 5123: "<u2", 5125: "<u4"}  # of accessors, by OpenGL's numbers
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MESHOPT, _UNLIT = "EXT_meshopt_compression", "KHR_materials_unlit"


@dataclass(frozen=True, slots=True)
class StoredLevel:
    """A level of detail as its file has it, in the asset frame (metres, Y up).

    mesh      a `Mesh` where the texture is one that only graphics cards read (KTX2): then without colours
    ktx2      whether it is so
    unlit     whether colours are shown as they were captured
    is_packed whether the file is compressed with meshoptimizer
    """

    mesh: Mesh | TexturedMesh
    ktx2: bool
    unlit: bool
    is_packed: bool


def read_glb(data: bytes) -> StoredLevel:
    """Read a .glb of ours. Raises ValueError for a file of others, which may be anything."""
    try:
        return _level(_GlbFile.of(data))
    except (KeyError, IndexError, struct.error, TypeError) as error:
        raise ValueError(f"this is not a level of detail: {error!r}") from None


def _level(reader: _GlbFile) -> StoredLevel:
    document = reader.document
    ((primitive,),) = (mesh["primitives"] for mesh in document["meshes"])
    attributes, (node,) = primitive["attributes"], document["nodes"]
    scale, translation = (np.array(node.get(name, of), float) for name, of in (("scale", [1]), ("translation", [0])))
    vertices = reader.accessor(attributes["POSITION"]).astype(np.float64) * scale + translation
    faces = reader.accessor(primitive["indices"]).reshape(-1, 3).astype(np.int64)
    rgb = None
    if "COLOR_0" in attributes:
        rgb = to_srgb(reader.accessor(attributes["COLOR_0"])[:, :3] / 65535)
    origin = reader.accessor(attributes[ORIGIN]) if ORIGIN in attributes else None
    mesh, images = Mesh(vertices, faces, rgb, origin), document.get("images", [])
    ktx2 = bool(images) and images[0]["mimeType"] == KTX2
    used = document.get("extensionsUsed", ())
    made = mesh if ktx2 or not images else _textured(reader, mesh, attributes, images)
    return StoredLevel(made, ktx2, _UNLIT in used, _MESHOPT in used)


def _textured(reader: _GlbFile, mesh: Mesh, attributes: dict[str, int], images: list[dict[str, Any]]) -> TexturedMesh:
    from PIL import Image

    uv = reader.accessor(attributes["TEXCOORD_0"])
    uv = (uv / 65535 if uv.dtype == np.uint16 else uv).astype(np.float64)
    files = [reader.view(image["bufferView"]) for image in images]
    with Image.open(BytesIO(files[0])) as picture:
        side = max(picture.size)
    return TexturedMesh(mesh, uv, files[0], side, normals=files[1] if len(files) > 1 else None)


@dataclass(frozen=True, slots=True)
class _GlbFile:
    """A file's document, and its binary chunk."""

    document: dict[str, Any]
    binary: bytes

    @classmethod
    def of(cls, data: bytes) -> _GlbFile:
        magic, version, _, length = struct.unpack_from("<4sIII", data)
        if (magic, version) != (b"glTF", 2):
            raise ValueError("this is not a binary glTF 2.0 file")
        return cls(json.loads(data[20 : 20 + length]), data[28 + length :])

    def accessor(self, number: int) -> NDArray[Any]:
        """Decode an accessor to an array: (n,), or (n,k) for vectors."""
        accessor = self.document["accessors"][number]
        view = self.document["bufferViews"][accessor["bufferView"]]
        width, kind = _WIDTHS[accessor["type"]], np.dtype(_TYPES[accessor["componentType"]])
        stride = view.get("byteStride", width * kind.itemsize)
        count = accessor["count"]
        rows = np.frombuffer(self.view(accessor["bufferView"]), kind, count * stride // kind.itemsize)
        table = rows.reshape(count, -1)[:, :width]
        return table if width > 1 else table[:, 0]

    def view(self, number: int) -> bytes:
        """Return the bytes of a buffer view, decompressed."""
        view = self.document["bufferViews"][number]
        packed = view.get("extensions", {}).get(_MESHOPT)
        place = packed or view
        part = self.binary[place.get("byteOffset", 0) :][: place["byteLength"]]
        if not packed:
            return part
        rows = meshopt.decode_gltf_buffer(part, packed["count"], packed["byteStride"], packed["mode"])
        decoded: bytes = rows.tobytes()  # directions stay as they are encoded: normals are computed anew
        return decoded
