"""Place the meshes of a glTF: nodes and instances, morph targets, skins; and its triangles, of strips and fans too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.clouds.gltf import DRACO, MAX_NODES, MAX_PARTS, GltfFile, no_entry, too_complex, too_many_entries
from capture2vr.edge.clouds.sample_surface import MAX_FACES, too_many_faces
from capture2vr.edge.clouds.tables import MAX_POINTS, too_many_points
from capture2vr.sentences.sentence import say

POINTS, TRIANGLES, _STRIP, _FAN = 0, 4, 5, 6  # modes of primitives
SURFACES = (TRIANGLES, _STRIP, _FAN)
_MAX_DEPTH = 200  # nodes above a node; skeletons have some fifty
_MAX_INSTANCES = 1_000_000  # of all nodes


@dataclass(frozen=True, slots=True)
class PlacedMesh:
    """A mesh with the matrices (K,4,4) of all nodes and instances that show it alike; joints (J,4,4) of its skin."""

    primitives: Sequence[Mapping[str, Any]]
    weights: Sequence[float]
    joints: Floats | None
    matrices: Floats


@dataclass(frozen=True, slots=True)
class Primitive:
    """What a primitive shows: faces (F,3) of its vertices, none of points, and vertices (K·V,3) and faces in the scene.

    rows: the places of its V vertices in the accessors, None where they are all of them
    """

    gltf: GltfFile
    tree: Mapping[str, Any]
    weights: Sequence[float]
    rows: Ints | None
    faces: Ints
    vertices: Floats
    placed_faces: Ints

    def attribute(self, name: str, *, fractions: bool = False) -> Floats | None:
        """Read the rows (V,k) of an attribute, morphed; None where the primitive has none."""
        return _morphed(self.gltf, self.tree, self.weights, self.rows, name, fractions=fractions)


def placed_meshes(gltf: GltfFile) -> list[PlacedMesh]:
    """Place the meshes that the scene shows. Raises CAPTURE_TOO_LARGE and ValueError."""
    nodes, matrices = gltf.tree.get("nodes", []), _global_matrices(gltf)
    found: dict[tuple[int, int | None, tuple[float, ...]], list[Floats]] = {}
    parts = instances = 0
    for place in _shown(gltf):
        node = nodes[place]
        if "mesh" not in node:
            continue
        mesh = gltf.entry("meshes", node["mesh"])
        parts += len(mesh["primitives"])
        own = _instances(gltf, node) if node.get("skin") is None else None
        instances += 1 if own is None else len(own)
        if parts > MAX_PARTS:
            raise too_many_entries("primitives", parts, MAX_PARTS, gltf.file)
        if instances > _MAX_INSTANCES:
            raise too_many_entries("EXT_mesh_gpu_instancing", instances, _MAX_INSTANCES, gltf.file)
        weights = tuple(map(float, node.get("weights", mesh.get("weights", ()))))
        all_own = matrices[place][None] if own is None else matrices[place] @ own
        found.setdefault((node["mesh"], node.get("skin"), weights), []).append(all_own)
    skins = {skin for _, skin, _ in found}
    joints = {skin: None if skin is None else _joints(gltf, skin, matrices) for skin in skins}
    return [
        PlacedMesh(gltf.tree["meshes"][mesh]["primitives"], weights, joints[skin], np.concatenate(own))
        for (mesh, skin, weights), own in found.items()
    ]


def _shown(gltf: GltfFile) -> list[int]:
    """Return the numbers of the nodes of the scene that are not hidden: of all scenes where the file has none."""
    nodes = gltf.tree.get("nodes", [])
    if "scenes" in gltf.tree:
        level = gltf.entry("scenes", gltf.tree.get("scene", 0)).get("nodes", [])
    else:
        below = {child for node in nodes for child in node.get("children", [])}
        level = [place for place in range(len(nodes)) if place not in below]
    shown: dict[int, None] = {}
    while level:
        level = [
            place for place in dict.fromkeys(level) if place not in shown and _is_visible(gltf.entry("nodes", place))
        ]
        shown |= dict.fromkeys(level)
        level = [child for place in level for child in nodes[place].get("children", [])]
    return list(shown)


def _is_visible(node: Mapping[str, Any]) -> bool:
    return bool(node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True))


def _global_matrices(gltf: GltfFile) -> Floats:
    """Return the matrices (N,4,4) of all nodes in the scene. Raises CAPTURE_TOO_LARGE, and ValueError unless nodes are
    trees."""
    nodes = gltf.tree.get("nodes", [])
    children: list[Sequence[int]] = [node.get("children", []) for node in nodes]
    if sum(map(len, children)) > MAX_NODES:
        raise too_complex(say("has_more_than_nodes", most=MAX_NODES), gltf.file)
    parent = np.full(len(nodes), -1)
    for place, below in enumerate(children):
        for child in below:
            gltf.entry("nodes", child)
            if parent[child] >= 0:
                raise ValueError(say("nodes_are_no_trees"))
            parent[child] = place
    matrices, level, depth, seen = _own_matrices(nodes), np.flatnonzero(parent < 0), 0, 0
    while len(level):
        seen, depth = seen + len(level), depth + 1
        if depth > _MAX_DEPTH:
            raise too_complex(say("has_nodes_nested_deeper", most=_MAX_DEPTH), gltf.file)
        level = np.array([child for place in level for child in children[place]], np.int64)
        matrices[level] = matrices[parent[level]] @ matrices[level]
    if seen < len(nodes):  # the others are below themselves
        raise ValueError(say("nodes_are_no_trees"))
    return matrices


def _own_matrices(nodes: Sequence[Mapping[str, Any]]) -> Floats:
    """Return the matrices (N,4,4) from nodes to their parents, whether they are given or made of parts."""
    plain: dict[str, Sequence[float]] = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}
    parts = ([node.get(name, none) for node in nodes] for name, none in plain.items())
    moves, turns, scales = (np.array(part, np.float64) for part in parts)
    matrices = _matrices(moves.reshape(-1, 3), turns.reshape(-1, 4), scales.reshape(-1, 3))
    for place, node in enumerate(nodes):
        if "matrix" in node:
            matrices[place] = np.array(node["matrix"], np.float64).reshape(4, 4).T
    return matrices


def _matrices(moves: Floats, turns: Floats, scales: Floats) -> Floats:
    """Return the matrices (N,4,4) that scale, turn by quaternions (N,4) x y z w of any length, and move."""
    lengths = np.linalg.norm(turns, axis=1, keepdims=True)
    turns = np.where(lengths > 0, turns / np.where(lengths > 0, lengths, 1), (0, 0, 0, 1))
    cross = np.cross(turns[:, None, :3], np.eye(3)).swapaxes(1, 2)
    matrices = np.tile(np.eye(4), (len(turns), 1, 1))
    matrices[:, :3, :3] = (np.eye(3) + 2 * turns[:, 3, None, None] * cross + 2 * cross @ cross) * scales[:, None]
    matrices[:, :3, 3] = moves
    return matrices


def _instances(gltf: GltfFile, node: Mapping[str, Any]) -> Floats | None:
    """Return the matrices (K,4,4) of a node's EXT_mesh_gpu_instancing; None where it has none."""
    attributes = node.get("extensions", {}).get("EXT_mesh_gpu_instancing", {}).get("attributes", {})
    defaults = {"TRANSLATION": (0.0, 0.0, 0.0), "ROTATION": (0.0, 0.0, 0.0, 1.0), "SCALE": (1.0, 1.0, 1.0)}
    counts = {gltf.count(attributes[name]) for name in defaults if name in attributes}
    if not counts:
        return None
    (count,) = counts
    if count > _MAX_INSTANCES:
        raise too_many_entries("EXT_mesh_gpu_instancing", count, _MAX_INSTANCES, gltf.file)
    return _matrices(
        *(
            gltf.floats(attributes[name]) if name in attributes else np.tile(default, (count, 1))
            for name, default in defaults.items()
        )
    )


def _joints(gltf: GltfFile, index: int, matrices: Floats) -> Floats:
    """Return the matrices (J,4,4) from a skin's bind pose to where its joints are now."""
    skin = gltf.entry("skins", index)
    for joint in skin["joints"]:
        gltf.entry("nodes", joint)
    now = matrices[np.array(skin["joints"], np.int64)]
    if "inverseBindMatrices" not in skin:
        return now
    return now @ gltf.floats(skin["inverseBindMatrices"])[: len(now)].reshape(-1, 4, 4).swapaxes(1, 2)


def check_counts(gltf: GltfFile, placed: Sequence[PlacedMesh]) -> None:
    """Refuse too many triangles or points before any is read. Raises CAPTURE_TOO_LARGE."""
    faces = points = 0
    for mesh in placed:
        for tree in mesh.primitives:
            if (index := tree.get("indices", tree["attributes"].get("POSITION"))) is None:
                continue
            mode, count = tree.get("mode", TRIANGLES), gltf.count(index) * len(mesh.matrices)
            faces += count // 3 if mode == TRIANGLES else count if mode in SURFACES else 0
            points += count if mode == POINTS else 0
    if faces > MAX_FACES:
        raise too_many_faces(faces, gltf.file)
    if points > MAX_POINTS:
        raise too_many_points(points, gltf.file)


def primitives(gltf: GltfFile, mesh: PlacedMesh, modes: Sequence[int]) -> Iterator[Primitive]:
    """Read the primitives of a placed mesh that have one of the modes, those that mirrored nodes show apart.

    A mirrored triangle has its corners in the other order: so its normal points to the same side of the surface.
    """
    for tree in mesh.primitives:
        if tree.get("mode", TRIANGLES) not in modes or "POSITION" not in tree["attributes"]:
            continue
        rows, faces = _faces(gltf, tree)
        own = _morphed(gltf, tree, mesh.weights, rows, "POSITION")
        assert own is not None
        matrices = mesh.matrices
        if mesh.joints is not None and "JOINTS_0" in tree["attributes"]:
            own, matrices = _skinned(gltf, tree, rows, own[:, :3], mesh.joints), np.eye(4)[None]
        mirrored = np.linalg.det(matrices[:, :3, :3]) < 0
        for some, order in ((matrices[~mirrored], [0, 1, 2]), (matrices[mirrored], [0, 2, 1])):
            if len(some):
                with np.errstate(invalid="ignore", over="ignore"):
                    vertices = own[:, :3] @ some[:, :3, :3].swapaxes(1, 2) + some[:, None, :3, 3]
                all_faces = faces[:, order] + len(own) * np.arange(len(some))[:, None, None]
                yield Primitive(
                    gltf, tree, mesh.weights, rows, faces[:, order], vertices.reshape(-1, 3), all_faces.reshape(-1, 3)
                )


def _faces(gltf: GltfFile, tree: Mapping[str, Any]) -> tuple[Ints | None, Ints]:
    """Return which rows of its accessors a primitive uses, None for all, and its triangles (F,3), none of points.

    Many primitives may share accessors of which each uses a few rows: then only those are read.
    """
    mode, position = tree.get("mode", TRIANGLES), gltf.entry("accessors", tree["attributes"]["POSITION"])
    if DRACO in tree.get("extensions", {}) and "bufferView" not in position:  # nor is it there uncompressed
        raise gltf.unsupported(DRACO)
    count = position["count"]
    corners: Ints = np.arange(count)
    if "indices" in tree:
        indices = gltf.rows(tree["indices"])
        if indices.dtype.kind != "u" or (len(indices) and indices.max() >= count):
            raise ValueError(say("face_has_indices_vertices"))
        corners = indices[:, 0].astype(np.int64)
    if mode == POINTS:
        return corners if "indices" in tree else None, np.empty((0, 3), np.int64)
    at = np.arange(max(0, len(corners) - 2))
    if mode == TRIANGLES:
        faces = corners[: len(corners) // 3 * 3].reshape(-1, 3)
    elif mode == _STRIP:
        faces = corners[np.stack([at, at + 1 + at % 2, at + 2 - at % 2], axis=1)]
    else:
        faces = corners[np.stack([at + 1, at + 2, 0 * at], axis=1)]
    if count <= faces.size:
        return None, faces
    rows, places = np.unique(faces, return_inverse=True)
    return rows, places.reshape(-1, 3)


def _morphed(
    gltf: GltfFile,
    tree: Mapping[str, Any],
    weights: Sequence[float],
    rows: Ints | None,
    name: str,
    *,
    fractions: bool = False,
) -> Floats | None:
    """Read an attribute (V,k), and add the displacements of the morph targets, each times its weight."""
    if name not in tree["attributes"]:
        return None
    values = gltf.floats(tree["attributes"][name], rows, fractions=fractions)
    for weight, target in zip(weights, tree.get("targets", ()), strict=False):
        if weight and name in target:
            moves = gltf.floats(target[name], rows, fractions=fractions)
            values[:, : moves.shape[1]] += weight * moves
    return values


def _skinned(gltf: GltfFile, tree: Mapping[str, Any], rows: Ints | None, own: Floats, joints: Floats) -> Floats:
    """Move vertices (V,3) by the weighted mean of their joints' matrices, whatever sets of four joints they have."""
    attributes = tree["attributes"]
    sets = [at for at in range(len(attributes)) if f"JOINTS_{at}" in attributes and f"WEIGHTS_{at}" in attributes]
    picked = np.hstack([gltf.floats(attributes[f"JOINTS_{at}"], rows) for at in sets]).astype(np.int64)
    if picked.size and not 0 <= picked.min() <= picked.max() < len(joints):
        raise no_entry("joints", picked.max())
    weights = np.hstack([gltf.floats(attributes[f"WEIGHTS_{at}"], rows, fractions=True) for at in sets])
    weights[weights.sum(axis=1) <= 0, 0] = 1  # else such a vertex would lie at the scene's origin
    weights /= weights.sum(axis=1, keepdims=True)
    moved = np.zeros_like(own)
    for joint, weight in zip(picked.T, weights.T, strict=True):
        matrices = joints[joint]
        moved += weight[:, None] * (np.einsum("vij,vj->vi", matrices[:, :3, :3], own) + matrices[:, :3, 3])
    return moved
