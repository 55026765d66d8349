"""Copy what is read of a glTF's JSON into a tree of its own, and refuse counts that would cost much.

A hostile file has a hundred thousand parts, or few that all refer to the same large thing: what trimesh does with each
of them, such as copying `extras`, decoding a picture or following a chain of nodes, must not be repeated as often.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np

from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MAX_NODES = 5_000  # of a scene; trimesh takes about a millisecond per node
MAX_PARTS = 20_000  # primitives, those of a mesh as often as nodes show it; trimesh takes 0.2 ms for each
_MOST = {"meshes": MAX_PARTS, "accessors": 100_000, "bufferViews": 100_000, "buffers": 1_000, "scenes": 1_000}
_MOST |= {"materials": 5_000, "textures": 5_000, "images": 5_000}
_MAX_DEPTH = 200  # nodes above a node; skeletons have some fifty
_LEAST_ROW = 12  # bytes of a row that is copied: three floats
_MOST_VIEWED = 4  # times the bytes of all buffers: trimesh copies each view
_LEAST_VIEWED = 2**24  # bytes that views may have in any case
POINTS, TRIANGLES, STRIP, FAN = 0, 4, 5, 6  # modes of primitives that are read
_READ_MODES = (POINTS, TRIANGLES, STRIP, FAN)
TRANSFORM = "KHR_texture_transform"
_NODE_KEYS = ("mesh", "matrix", "translation", "rotation", "scale")
_NOTHING = {"componentType": 5121, "count": 0, "type": "SCALAR"}  # an accessor that nobody reads


def used_tree(tree: dict[str, Any], file: str) -> dict[str, Any]:
    """Return the parts of a glTF's tree that are read, in new dictionaries: no names, extras, cameras, animations.

    The numbers of accessors, bufferViews, buffers, meshes, materials and nodes stay. Pictures that are the same come
    once. Raises CAPTURE_TOO_LARGE.
    """
    for name, most in _MOST.items():
        if (count := len(tree.get(name, []))) > most:
            raise too_many_entries(name, count, most, file)
    textures, images = _textures_and_images(tree)
    used: dict[str, Any] = {"asset": {"version": "2.0"}, "textures": textures, "images": images}
    used |= {"meshes": _meshes(tree, file), "materials": [_material(each) for each in tree.get("materials", [])]}
    used |= {name: tree[name] for name in ("buffers", "bufferViews", "accessors") if name in tree}
    roots: Sequence[int] | None = None
    if "scenes" in tree:
        roots = tree["scenes"][tree.get("scene", 0)].get("nodes", [])
        used |= {"scene": 0, "scenes": [{"nodes": roots}]}
    return used | {"nodes": _nodes(tree, used["meshes"], roots or (), file)}


def too_many_entries(name: str, count: int, most: int, file: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a glTF with so many entries under a name."""
    what = say("has_too_many_entries_under", count=count, name=name, most=most)
    return CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("join_meshes_scene_into"),))


def without_unread(tree: dict[str, Any], held: int, file: str) -> dict[str, Any]:
    """Return a tree whose accessors and views are those that primitives and pictures refer to; others are empty.

    held: bytes of all buffers. Raises CAPTURE_TOO_LARGE where the views are many times as large.
    """
    read = _read_accessors(tree["meshes"])
    accessors = [each if place in read else _NOTHING for place, each in enumerate(tree["accessors"])]
    viewed = {each["bufferView"] for each in (*accessors, *tree["images"]) if "bufferView" in each}
    views = [
        each if place in viewed else {"buffer": each["buffer"], "byteLength": 0}
        for place, each in enumerate(tree["bufferViews"])
    ]
    size = sum(int(view["byteLength"]) for view in views) + sum(_copied(each, views) for each in accessors)
    if size > max(_LEAST_VIEWED, _MOST_VIEWED * held):
        raise _too_large(say("has_buffer_views_of_bytes", size=size, held=held), file)
    return tree | {"accessors": accessors, "bufferViews": views}


def _read_accessors(meshes: Sequence[Mapping[str, Any]]) -> set[int]:
    """Return the numbers of the accessors that primitives refer to."""
    primitives = [primitive for mesh in meshes for primitive in mesh["primitives"]]
    places = {place for each in primitives for place in each["attributes"].values()}
    return places | {each["indices"] for each in primitives if "indices" in each}


def _copied(accessor: Mapping[str, Any], views: Sequence[Mapping[str, Any]]) -> int:
    """Return the bytes that trimesh copies of an accessor whose rows are apart from each other."""
    if "bufferView" not in accessor or "byteStride" not in views[accessor["bufferView"]]:
        return 0
    return int(accessor["count"]) * _LEAST_ROW


def _nodes(tree: Mapping[str, Any], meshes: Sequence[Any], roots: Sequence[int], file: str) -> list[dict[str, Any]]:
    """Copy the nodes, after counting them, the edges between them, their depth and the primitives that they show."""
    nodes = tree.get("nodes", [])
    children = [node.get("children", []) for node in nodes]
    if max(len(nodes), len(roots) + sum(map(len, children))) > MAX_NODES:
        raise _too_large(say("has_more_than_nodes", most=MAX_NODES), file)
    shown = (nodes[place] for place in chain(roots, *children))
    parts = sum(len(meshes[node["mesh"]]["primitives"]) for node in shown if "mesh" in node)
    if parts > MAX_PARTS:
        raise too_many_entries("primitives", parts, MAX_PARTS, file)
    _check_depth(children, roots, file)
    return [_node(node, below) for node, below in zip(nodes, children, strict=True)]


def _check_depth(children: Sequence[Sequence[int]], roots: Sequence[int], file: str) -> None:
    """Refuse nodes below many others: trimesh goes from each up to the root. Raises CAPTURE_TOO_LARGE."""
    level, depth = set(roots), 0
    while level:
        level, depth = {child for place in level for child in children[place]}, depth + 1
        if depth > _MAX_DEPTH:
            raise _too_large(say("has_nodes_nested_deeper", most=_MAX_DEPTH), file)


def _node(node: Mapping[str, Any], children: Sequence[int]) -> dict[str, Any]:
    return {key: node[key] for key in _NODE_KEYS if key in node} | ({"children": children} if children else {})


def _too_large(what: str, file: str) -> CaptureError:
    return CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("join_meshes_scene_into"),))


def _meshes(tree: Mapping[str, Any], file: str) -> list[dict[str, Any]]:
    """Copy the primitives that are triangles or points, with what is read of them."""
    meshes = [mesh["primitives"] for mesh in tree.get("meshes", [])]
    if (count := sum(map(len, meshes))) > MAX_PARTS:
        raise too_many_entries("primitives", count, MAX_PARTS, file)
    return [
        {"primitives": [_primitive(each) for each in mesh if each.get("mode", TRIANGLES) in _READ_MODES]}
        for mesh in meshes
    ]


def _primitive(primitive: Mapping[str, Any]) -> dict[str, Any]:
    attributes = {
        name: place
        for name, place in primitive["attributes"].items()
        if name in ("POSITION", "COLOR_0") or name.startswith("TEXCOORD_")
    }
    return {key: primitive[key] for key in ("indices", "mode", "material") if key in primitive} | {
        "attributes": attributes
    }


def _material(material: Mapping[str, Any]) -> dict[str, Any]:
    """Copy a material's base colour; of one that is black and shines by itself, the colour that it shines in."""
    given = material.get("pbrMetallicRoughness", {})
    base: dict[str, Any] = {}
    if "baseColorFactor" in given:
        base["baseColorFactor"] = given["baseColorFactor"][:4]
    texture, shines = given.get("baseColorTexture"), material.get("emissiveFactor", ())
    if any(shines) and not any(base.get("baseColorFactor", (1,))[:3]):
        texture, base["baseColorFactor"] = material.get("emissiveTexture"), [*shines[:3], 1.0]
    if texture is not None:
        transform = texture.get("extensions", {}).get(TRANSFORM, {})
        base["baseColorTexture"] = {
            "index": int(texture["index"]),
            "texCoord": int(transform.get("texCoord", texture.get("texCoord", 0))),
            "transform": _transform(transform),
        }
    return {"pbrMetallicRoughness": base}


def _transform(transform: Mapping[str, Any]) -> dict[str, Any]:
    """Copy the numbers of KHR_texture_transform: as a hostile file has them, they may be texts of megabytes."""
    pairs = {key: np.asarray(transform[key], np.float64).reshape(2).tolist() for key in ("scale", "offset")
             if key in transform}  # fmt: skip
    return pairs | ({"rotation": float(transform["rotation"])} if "rotation" in transform else {})


def _textures_and_images(tree: Mapping[str, Any]) -> tuple[list[dict[str, int]], list[dict[str, Any]]]:
    """Copy the textures, and the pictures that they show, each once, however often it is listed."""
    listed = tree.get("images", [])
    images: dict[tuple[str, Any], int] = {}
    textures: list[dict[str, int]] = []
    for texture in tree.get("textures", []):
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
        source = webp.get("source", texture.get("source"))
        if source is None:
            textures.append({})
            continue
        key = next(((name, listed[source][name]) for name in ("bufferView", "uri") if name in listed[source]), None)
        textures.append({} if key is None else {"source": images.setdefault(key, len(images))})
    return textures, [{name: value} for name, value in images]
