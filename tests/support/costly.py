"""Captures of a few megabytes that once took minutes to read: many small parts, or few that are used again and again.

REFUSED has those that are refused by a count, of which some is exceeded; LINEAR those that are read, or refused late,
and whose cost grows with their size alone: each makes the files of a capture from a number of repetitions.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

import cv2
import numpy as np
from PIL import Image

from tests.support import captures

Files = Mapping[str, bytes]
"""The files of a capture, by name."""
Make = Callable[[int], Files]

_TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.array([0, 1, 2], "<u4").tobytes()
_PRIMITIVE: dict[str, Any] = {"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": 1}
_OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"
_POSE = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"


@cache
def _depth() -> bytes:
    return cv2.imencode(".png", captures.steps(captures.depth_m(captures.poses()[0])))[1].tobytes()


@cache
def _jpeg() -> bytes:
    return captures.jpg_bytes(captures.picture(0))


def _tree(**changed: Any) -> dict[str, Any]:
    """The JSON of a GLB of one triangle, with other entries."""
    accessors = [("VEC3", 5126, 0), ("SCALAR", 5125, 1), ("VEC2", 5126, 0)]
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [_PRIMITIVE]}],
        "buffers": [{"byteLength": len(_TRIANGLE)}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}],
        "accessors": [
            {"bufferView": at, "componentType": kind, "count": 3, "type": name} for name, kind, at in accessors
        ],
        **changed,
    }


def _glb(tree: dict[str, Any], more: bytes = b"") -> Files:
    return {"a.glb": captures.glb_of(tree, _TRIANGLE + more)}


def primitives(count: int) -> Files:
    """A mesh of many triangles, each a primitive of its own, all with the mesh's large `extras`."""
    return _glb(_tree(meshes=[{"primitives": [_PRIMITIVE] * count, "extras": {str(n): n for n in range(count)}}]))


def instances(count: int) -> Files:
    """Many nodes that show a mesh of many primitives."""
    nodes = [{"mesh": 0}] * 500
    return _glb(_tree(nodes=nodes, scenes=[{"nodes": [*range(500)]}], meshes=[{"primitives": [_PRIMITIVE] * count}]))


def edges(count: int) -> Files:
    """Nodes that each have all later ones as children."""
    return _glb(_tree(nodes=[{"mesh": 0, "children": [*range(at + 1, count)]} for at in range(count)]))


def nested(count: int) -> Files:
    """A chain of nodes, each with a mesh."""
    return _glb(_tree(nodes=[*({"mesh": 0, "children": [at + 1]} for at in range(count)), {"mesh": 0}]))


def views(count: int) -> Files:
    """Many views of the same megabyte, each of which some accessor reads."""
    tree = _tree(buffers=[{"byteLength": len(_TRIANGLE) + 10**6}])
    tree["bufferViews"] += [{"buffer": 0, "byteLength": 10**6}] * count
    tree["accessors"] += [{**tree["accessors"][0], "bufferView": 2 + at} for at in range(count)]
    parts = [{"attributes": {"POSITION": 3 + at}, "indices": 1} for at in range(count)]
    return _glb(tree | {"meshes": [{"primitives": parts}]}, bytes(10**6))


def textures(count: int, picture: bytes, *, one_view: bool = False) -> Files:
    """Many textures of one PNG's bytes: each of a byte more behind its end, or all of one view."""
    tree = _tree(buffers=[{"byteLength": len(_TRIANGLE) + len(picture) + count}])
    first = len(tree["bufferViews"])
    place = {"buffer": 0, "byteOffset": len(_TRIANGLE)}
    tree["bufferViews"] += [{**place, "byteLength": len(picture) + at} for at in range(1 if one_view else count)]
    tree["images"] = [{"bufferView": first + (0 if one_view else at), "mimeType": "image/png"} for at in range(count)]
    tree["textures"] = [{"source": at} for at in range(count)]
    tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": at}}} for at in range(count)]
    tree["meshes"] = [{"primitives": [{**_PRIMITIVE, "material": at} for at in range(count)]}]
    return _glb(tree, picture + bytes(count))


def _flat_png(side: int) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (side, side)).save(buffer, "PNG")
    return buffer.getvalue()


def _ply(lines: bytes) -> Files:
    xyz = b"element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    return {"a.ply": b"ply\nformat binary_little_endian 1.0\n" + xyz + lines + b"end_header\n" + _TRIANGLE[:36]}


def solids(count: int) -> Files:
    """An ASCII STL of many bodies of one name."""
    corners = b"".join(b"vertex %d %d 0\n" % corner for corner in ((0, 0), (1, 0), (0, 1)))
    body = b"solid x\nfacet normal 0 0 1\nouter loop\n" + corners + b"endloop\nendfacet\nendsolid x\n"
    return {"a.stl": body * count}


_TABLES = {"meshes": 20_001, "accessors": 100_001, "bufferViews": 100_001, "buffers": 1_001, "scenes": 1_001}
_TABLES |= {"materials": 5_001, "textures": 5_001, "images": 5_001}


def _many(name: str, count: int) -> Files:
    """A GLB with one entry under a name so often that it is refused."""
    (entry,) = _tree().get(name, [{}])[:1]
    return _glb(_tree(**{name: [entry] * count}))


REFUSED: dict[str, tuple[Callable[[], Files], str]] = {
    "a GLB of many primitives": (lambda: primitives(20_001), "a.glb"),
    "a GLB whose nodes show many primitives": (lambda: instances(50), "a.glb"),
    "a GLB with many edges between nodes": (lambda: edges(150), "a.glb"),
    "a GLB of nested nodes": (lambda: nested(300), "a.glb"),
    "a GLB whose textures share their bytes": (lambda: textures(100, _flat_png(4000)), "a.glb"),
    **{f"a GLB of many {name}": (partial(_many, name, count), "a.glb") for name, count in _TABLES.items()},
    "an OBJ of many material libraries": (
        lambda: {"a.obj": _OBJ + b"".join(b"mtllib %d.mtl\n" % number for number in range(101))},
        "a.obj",
    ),
    "an OBJ of many material libraries in a line": (
        lambda: {"a.obj": _OBJ + b"mtllib " + b"x " * 101 + b"\n"},
        "a.obj",
    ),
    "a PLY of many elements": (lambda: _ply(b"element vertex 0\nproperty float x\n" * 101), "a.ply"),
    "a PLY of many properties": (lambda: _ply(b"property float p\n" * 1_001), "a.ply"),
    "a list that names one depth image again and again": (lambda: _same_depth(20_001), "depth"),
}


def _same_depth(count: int) -> Files:
    listed = {"depth.txt": b"1.5 depth/0.png\n" * count, "groundtruth.txt": b"1.5 0 0 0 0 0 0 1\n"}
    return {**listed, "depth/0.png": _depth()}


def _wide_csv(count: int) -> Files:
    head = b"timestamp,frame,x,y,z,qx,qy,qz,qw" + b",a" * count + b"\n"
    return {
        "depth/0.png": _depth(),
        "odometry.csv": head + b"0,0\n" * count,
        "camera_matrix.csv": b"60,0,32,0,60,24,0,0,1",
    }


def _shared_keys(count: int) -> Files:
    """A transforms.json of many keys that hold for all of its many frames."""
    keys = ",".join(f'"k{number}":1' for number in range(count))
    frames = ",".join(f'{{"file_path":"{number}.jpg","transform_matrix":{_POSE}}}' for number in range(count))
    text = f'{{{keys},"fl_x":60,"w":64,"h":48,"frames":[{frames}]}}'
    return {"transforms.json": text.encode(), "0.jpg": _jpeg()}


def _deep_path(count: int) -> Files:
    """A COLMAP model whose photo lies in a folder of a folder of a folder …"""
    lines = b"0 1 0 0 0 0 0 0 1 " + b"a/" * count + b"0.jpg\n\n1 1 0 0 0 0 0 1 1 1.jpg\n\n"
    cameras = b"1 PINHOLE 64 48 60 60 32 24\n"
    return {"cameras.txt": cameras, "images.txt": lines, "images/0.jpg": _jpeg(), "images/1.jpg": _jpeg()}


def _blanks(count: int) -> Files:
    depths = {f"depth/{number}.png": _depth() for number in range(2)}
    return {**depths, "calib.txt": b"fx" + b" " * count}


def _pictures_beside(count: int) -> Files:
    """A model with many pictures that its materials do not name."""
    pictures = {f"p{number}.jpg": b"\xff\xd8\xff" for number in range(count)}
    return {"a.obj": _OBJ * 50 + b"mtllib a.mtl\n", "a.mtl": b"# a p 12.jp x-0.jp\n" * 400 * count, **pictures}


def _r3d(count: int) -> Files:
    """An archive of many frames, whose pictures are none."""
    buffer = io.BytesIO()
    camera = {"K": [60, 0, 0, 0, 60, 0, 32, 24, 1], "w": 64, "h": 48}
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("metadata", json.dumps({"poses": [[0, 0, 0, 1, 0, 0, 0]] * count, **camera}))
        for number in range(count):
            archive.writestr(f"rgbd/{number}.jpg", b"x")
    return {"a.r3d": buffer.getvalue()}


LINEAR: dict[str, tuple[Make, int]] = {
    "an OBJ that names its material library again and again": (
        lambda count: {"a.obj": _OBJ + b"mtllib a.mtl\n" * count, "a.mtl": b"newmtl a\nKd 1 0 0\n" * count},
        400,
    ),
    "a material that names its texture again and again": (
        lambda count: {
            "a.obj": _OBJ + b"mtllib a.mtl\n",
            "a.mtl": b"newmtl a\n" + b"map_Kd x.png\n" * 40 * count,
            **{f"{number}.txt": b"x" for number in range(count)},
        },
        100,
    ),
    "a texture behind many options": (
        lambda count: {"a.obj": _OBJ + b"mtllib a.mtl\n", "a.mtl": b"newmtl a\nmap_Kd " + b"-bm 1 " * count + b"x\n"},
        40_000,
    ),
    "a CSV of many columns and short rows": (_wide_csv, 500),
    "a transforms.json of many keys and frames": (_shared_keys, 500),
    "a photo in very many folders": (_deep_path, 5_000),
    "a calibration of blanks": (_blanks, 4_000),
    "pictures beside a model": (_pictures_beside, 100),
    "a .r3d of many frames": (_r3d, 100),
    "a GLB of views of the same bytes": (views, 200),
    "an STL of many solids": (solids, 2_000),
}
