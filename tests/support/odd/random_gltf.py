"""Random glTF files and the triangles that they mean: nodes in trees, instances, skins, morph targets, strips, fans."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.support.gltf_files import GltfWriter


def turned(vector: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """A vector turned by a quaternion x y z w, by its axis and angle (Rodrigues)."""
    rotation = rotation / np.linalg.norm(rotation)
    sine = np.linalg.norm(rotation[:3])
    if sine == 0:
        return vector
    axis, angle = rotation[:3] / sine, 2 * np.arctan2(sine, rotation[3])
    return (
        vector * np.cos(angle)
        + np.cross(axis, vector) * np.sin(angle)
        + axis * np.dot(axis, vector) * (1 - np.cos(angle))
    )


def matrix_of(move: np.ndarray, turn: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(4,4): where the three axes and the origin go."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([turned(axis * size, turn) for axis, size in zip(np.eye(3), scale, strict=True)], axis=1)
    matrix[:3, 3] = move
    return matrix


def placed(matrix: np.ndarray, point: np.ndarray) -> np.ndarray:
    return matrix[:3, :3] @ point + matrix[:3, 3]


def stored(
    rng: np.random.Generator, shape: tuple[int, int], kind: str, normalised: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Random rows as a file has them, and the numbers that they mean."""
    if kind == "f4":
        rows = rng.normal(size=shape).astype("<f4")
        return rows, rows.astype(float)
    info = np.iinfo(kind)
    whole = rng.integers(info.min, info.max, shape, endpoint=True).astype(f"<{kind}")
    return whole, np.maximum(whole / info.max, -1.0) if normalised else whole.astype(float)


def corners_of(mode: int, indices: np.ndarray) -> list[tuple[int, int, int]]:
    """The triangles of a list, a strip or a fan, as the format's section 3.7.2.1 writes them."""
    if mode == 4:
        return [tuple(indices[at : at + 3]) for at in range(0, len(indices) - 2, 3)]  # type: ignore[misc]
    if mode == 5:
        return [(indices[at], indices[at + 1 + at % 2], indices[at + 2 - at % 2]) for at in range(len(indices) - 2)]
    return [(indices[at + 1], indices[at + 2], indices[0]) for at in range(len(indices) - 2)]


@dataclass
class Made:
    """A random file and the triangles that it means."""

    writer: GltfWriter
    triangles: list[np.ndarray]


def random_nodes(rng: np.random.Generator, count: int) -> tuple[list[dict[str, Any]], list[np.ndarray]]:
    """Nodes in random trees, by matrices or by parts of which some are missing, and where each is in the scene."""
    nodes: list[dict[str, Any]] = []
    own: list[np.ndarray] = []
    for _ in range(count):
        move, turn = rng.normal(size=3), rng.normal(size=4)
        scale = rng.choice([-1, 1], 3) * rng.uniform(0.5, 2, 3)
        if rng.random() < 0.3:
            own.append(matrix_of(move, turn, scale))
            nodes.append({"matrix": own[-1].T.ravel().tolist()})
            continue
        parts = {"translation": move, "rotation": turn / np.linalg.norm(turn), "scale": scale}
        given = {name: part for name, part in parts.items() if rng.random() < 0.7}
        plain = {"translation": np.zeros(3), "rotation": np.array([0, 0, 0, 1.0]), "scale": np.ones(3)} | given
        own.append(matrix_of(*plain.values()))
        nodes.append({name: part.tolist() for name, part in given.items()})
    order = rng.permutation(count)  # a node may come behind its children
    all_of = list(own)
    for at in range(1, count):
        if rng.random() < 0.7:
            parent = order[rng.integers(at)]
            nodes[parent].setdefault("children", []).append(int(order[at]))
            all_of[order[at]] = all_of[parent] @ own[order[at]]
    return nodes, all_of


def add_skin(rng: np.random.Generator, writer: GltfWriter, part: dict[str, Any], count: int, sets: int) -> list[Any]:
    """Joints and weights for a primitive: of each vertex (joint, weight) as they are meant."""
    pairs: list[list[tuple[int, float]]] = [[] for _ in range(count)]
    shares = rng.dirichlet(np.ones(4 * sets), count)
    kind = rng.choice(["f4", "u1", "u2"])
    for at in range(sets):
        joints = rng.integers(0, 3, (count, 4))
        weights = shares[:, 4 * at : 4 * at + 4]
        rows = weights.astype("<f4") if kind == "f4" else np.rint(weights * np.iinfo(kind).max).astype(f"<{kind}")
        part["attributes"][f"JOINTS_{at}"] = writer.add(joints.astype(rng.choice(["u1", "<u2"])))
        part["attributes"][f"WEIGHTS_{at}"] = writer.add(rows, normalised=kind != "f4")
        for vertex in range(count):
            pairs[vertex] += [*zip(joints[vertex].tolist(), rows[vertex].astype(float), strict=True)]
    return [[(joint, weight / sum(w for _, w in own)) for joint, weight in own] for own in pairs]


def random_file(seed: int, *, skin: int, morphs: int, instances: bool, mode: int, kind: str, sparse: bool) -> Made:
    rng = np.random.default_rng(seed)
    writer, count = GltfWriter(scene=0), 3 * int(rng.integers(2, 5))
    normalised = kind != "f4" and bool(rng.integers(2))
    rows, meant = stored(rng, (count, 3), kind, normalised)
    if sparse or rng.random() < 0.5:
        part: dict[str, Any] = {"attributes": {"POSITION": writer.add(rows, normalised=normalised, sparse=sparse)}}
    else:
        other = rng.normal(size=(count, 3)).astype("<f4")
        position, normal = writer.interleave(rows, other, normalised=(0,) if normalised else ())
        part = {"attributes": {"POSITION": position, "NORMAL": normal}}
    indices = np.arange(count)
    if rng.random() < 0.7:
        indices = rng.permutation(count)[: count - 3 * int(rng.integers(2))]
        part["indices"] = writer.add(indices[:, None].astype(rng.choice(["u1", "<u2", "<u4"])))
    part["mode"] = mode
    moves = [stored(rng, (count, 3), "f4", False) for _ in range(morphs)]
    if morphs:
        part["targets"] = [{"POSITION": writer.add(each, sparse=bool(rng.integers(2)))} for each, _ in moves]
    pairs = add_skin(rng, writer, part, count, skin) if skin else None
    nodes, matrices = random_nodes(rng, 6)
    writer.tree |= {"meshes": [{"primitives": [part]}], "nodes": nodes}
    below = {child for node in nodes for child in node.get("children", [])}
    writer.tree["scenes"] = [{"nodes": [place for place in range(len(nodes)) if place not in below]}]
    shares = np.zeros(morphs)
    if morphs and rng.random() < 0.5:
        shares = rng.normal(size=morphs)
        writer.tree["meshes"][0]["weights"] = shares.tolist()
    binds = [np.eye(4)] * 3
    if skin:
        writer.tree["skins"] = [{"joints": rng.choice(6, 3, replace=False).tolist()}]
        if rng.random() < 0.7:
            binds = [matrix_of(rng.normal(size=3), rng.normal(size=4), np.ones(3)) for _ in range(3)]
            stacked = np.stack([bind.T.ravel() for bind in binds]).astype("<f4")
            writer.tree["skins"][0]["inverseBindMatrices"] = writer.add(stacked)
    triangles = []
    shown: set[tuple[float, ...]] = set()
    for place in rng.choice(6, 2, replace=False).tolist():
        nodes[place] |= {"mesh": 0}
        own_shares = shares
        if morphs and rng.random() < 0.5:
            own_shares = rng.normal(size=morphs)
            nodes[place]["weights"] = own_shares.tolist()
        points = [
            meant[vertex]
            + sum((share * move[vertex] for share, (_, move) in zip(own_shares, moves, strict=True)), np.zeros(3))
            for vertex in range(count)
        ]
        own = [matrices[place]]
        if skin and pairs is not None:
            nodes[place]["skin"] = 0
            joints = [
                matrices[joint] @ bind for joint, bind in zip(writer.tree["skins"][0]["joints"], binds, strict=True)
            ]
            points = [
                sum((weight * placed(joints[joint], points[vertex]) for joint, weight in pairs[vertex]), np.zeros(3))
                for vertex in range(count)
            ]
            own = [] if tuple(own_shares) in shown else [np.eye(4)]  # twice in one place is once
            shown.add(tuple(own_shares))
        elif instances:
            own = [matrices[place] @ each for each in add_instances(rng, writer, nodes[place])]
        for matrix in own:
            at = [placed(matrix, point) for point in points]
            order = [0, 1, 2] if np.linalg.det(matrix) > 0 else [0, 2, 1]
            triangles += [np.stack([at[corner] for corner in face])[order] for face in corners_of(mode, indices)]
    return Made(writer, triangles)


def add_instances(rng: np.random.Generator, writer: GltfWriter, node: dict[str, Any]) -> list[np.ndarray]:
    """Three instances of a node's mesh, of whose parts some are missing, and their matrices."""
    turns = rng.normal(size=(3, 4))
    turns = np.rint(turns / np.linalg.norm(turns, axis=1, keepdims=True) * 32767).astype("<i2")
    parts = {
        "TRANSLATION": rng.normal(size=(3, 3)).astype("<f4"),
        "ROTATION": turns,
        "SCALE": rng.uniform(0.5, 2, (3, 3)).astype("<f4"),
    }
    given = {name: rows for name, rows in parts.items() if name == "SCALE" or rng.random() < 0.7}
    attributes = {name: writer.add(rows, normalised=name == "ROTATION") for name, rows in given.items()}
    node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    plain = {"TRANSLATION": np.zeros((3, 3)), "ROTATION": np.tile([0, 0, 0, 1.0], (3, 1))} | given
    return [matrix_of(*(plain[name][at].astype(float) for name in parts)) for at in range(3)]
