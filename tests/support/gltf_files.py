"""Write glTF files as the format's text says, in all its ways of storing numbers."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.read_capture import read_capture
from tests.support import captures

KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfWriter:
    """A GLB that is being written: `tree` is its JSON, to which tables are added by hand."""

    def __init__(self, **tree: Any) -> None:
        self._data = bytearray()
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], **tree}

    def _view(self, content: bytes, **more: int) -> int:
        self._data.extend(b"\0" * (-len(self._data) % 4))
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self._data), "byteLength": len(content)} | more)
        self._data.extend(content)
        return len(self.tree["bufferViews"]) - 1

    def _accessor(self, rows: np.ndarray, **more: Any) -> int:
        kind = {"componentType": KINDS[rows.dtype.str[1:]], "count": len(rows), "type": _TYPES[rows.shape[1]]}
        self.tree["accessors"].append(kind | more)
        return len(self.tree["accessors"]) - 1

    def add(self, rows: np.ndarray, *, normalised: bool = False, sparse: bool = False) -> int:
        """An accessor of rows (N,k), each at a multiple of four bytes.

        sparse: every other row comes as one that replaces another value
        """
        if not sparse:
            return self.interleave(rows, normalised=(0,) if normalised else ())[0]
        places = np.arange(0, len(rows), 2).astype("<u2")
        stored = np.ascontiguousarray(rows).copy()
        stored[places] = 77
        index = self.add(stored, normalised=normalised)
        self.tree["accessors"][index]["sparse"] = {
            "count": len(places),
            "indices": {"bufferView": self._view(places.tobytes()), "componentType": KINDS["u2"]},
            "values": {
                "bufferView": self._view(b"1234" + np.ascontiguousarray(rows[places]).tobytes()),
                "byteOffset": 4,
            },
        }
        return index

    def interleave(self, *tables: np.ndarray, normalised: tuple[int, ...] = ()) -> list[int]:
        """Accessors of tables with as many rows each, whose rows take turns in one view."""
        if len(tables) == 1 and tables[0].shape[1] in (1, 16):  # indices and matrices are packed
            return [self._accessor(tables[0], bufferView=self._view(np.ascontiguousarray(tables[0]).tobytes()))]
        packed = [_padded(table) for table in tables]
        ends = np.cumsum([each.shape[1] for each in packed])
        view = self._view(np.hstack(packed).tobytes(), byteStride=int(ends[-1]))
        return [
            self._accessor(
                table,
                bufferView=view,
                byteOffset=int(end) - each.shape[1],
                **({"normalized": True} if at in normalised else {}),
            )
            for at, (table, each, end) in enumerate(zip(tables, packed, ends, strict=True))
        ]

    def picture(self, pixels: np.ndarray) -> int:
        """An image (H,W,3 or 4), as a PNG."""
        order = [2, 1, 0, 3][: pixels.shape[2]]
        view = self._view(cv2.imencode(".png", pixels[..., order])[1].tobytes())
        self.tree.setdefault("images", []).append({"bufferView": view, "mimeType": "image/png"})
        return len(self.tree["images"]) - 1

    def glb(self) -> bytes:
        return captures.glb_of(self.tree | {"buffers": [{"byteLength": len(self._data)}]}, bytes(self._data))


def _padded(table: np.ndarray) -> np.ndarray:
    """(N,b) bytes of a table's rows, b a multiple of four."""
    rows = np.ascontiguousarray(table).view(np.uint8).reshape(len(table), -1)
    return np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4)), constant_values=99)


def posed_glb() -> bytes:
    """A skinned and morphed square, instances of a strip beside it, and a texture that cuts its material out."""
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], "<f4")
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0, 2, 3]}])
    ones = np.hstack([np.ones((4, 1)), np.zeros((4, 3))])
    strip = {
        "attributes": {
            "POSITION": writer.add(square, sparse=True),
            "TEXCOORD_0": writer.add(square[:, :2].copy()),
            "COLOR_0": writer.add(np.ones((4, 4), "<f4")),
            "JOINTS_0": writer.add(ones.astype("u1")),
            "WEIGHTS_0": writer.add((255 * ones).astype("u1"), normalised=True),
        },
        "indices": writer.add(np.arange(4)[:, None].astype("<u2")),
        "mode": 5,
        "material": 0,
        "targets": [{"POSITION": writer.add(square)}],
    }
    places = {"TRANSLATION": writer.add(np.eye(3, dtype="<f4")), "ROTATION": writer.add(np.eye(4, dtype="<f4")[:3])}
    writer.tree |= {
        "meshes": [{"primitives": [strip], "weights": [0.5]}],
        "skins": [
            {
                "joints": [1, 0],
                "inverseBindMatrices": writer.add(np.tile(np.eye(4, dtype="<f4").reshape(1, 16), (2, 1))),
            }
        ],
        "nodes": [
            {"children": [1], "matrix": np.eye(4).ravel().tolist()},
            {"translation": [1, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]},
            {"mesh": 0, "skin": 0, "weights": [1.0]},
            {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": places}}},
        ],
        "materials": [
            {
                "alphaMode": "MASK",
                "alphaCutoff": 0.4,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [1, 1, 1, 0.9],
                    "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}},
                },
            }
        ],
        "textures": [{"source": writer.picture(np.full((2, 2, 4), 200, np.uint8)), "sampler": 0}],
        "samplers": [{"wrapS": 33071, "wrapT": 33648}],
    }
    return writer.glb()


def cloud_of(data: bytes) -> Cloud:
    """The points that are read of a GLB."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "scan.glb").write_bytes(data)
        cloud = read_capture(Path(folder)).cloud
    assert cloud is not None
    return cloud
