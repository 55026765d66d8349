"""Shapes of glTF files: nodes, instances, skins, morph targets, strips and fans lie where the format's text says."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.capture.files import open_folder
from capture2vr.edge.clouds.meshes import MeshFile, read_mesh
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support.gltf_files import GltfWriter, posed_glb
from tests.support.odd.random_gltf import random_file

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
BALL = trimesh.creation.icosphere(subdivisions=3)


def mesh_of(data: bytes) -> MeshFile:
    with TemporaryDirectory() as folder:
        (Path(folder) / "scan.glb").write_bytes(data)
        return read_mesh(open_folder(Path(folder)), "scan.glb", "glb")


def triangles_of(data: bytes) -> np.ndarray:
    """(F,3,3) corners of all triangles."""
    return np.concatenate([each.vertices[each.faces] for each in mesh_of(data).surfaces])


def assert_same_triangles(found: np.ndarray, meant: np.ndarray) -> None:
    """In whatever order they come, and with whatever corner first, but not turned over."""
    assert len(found) == len(meant)
    turned = np.concatenate([np.roll(meant, by, axis=1) for by in range(3)])
    distance, nearest = cKDTree(turned.reshape(-1, 9)).query(found.reshape(-1, 9))
    assert distance.max() < 1e-4 * (1 + np.abs(meant).max())
    some = [(meant[number] == meant).all(axis=(1, 2)).any() for number in set(nearest % len(meant))]
    assert all(some)
    back, _ = cKDTree(np.concatenate([np.roll(found, by, axis=1) for by in range(3)]).reshape(-1, 9)).query(
        meant.reshape(-1, 9)
    )
    assert back.max() < 1e-4 * (1 + np.abs(meant).max())


def one_mesh(
    *, nodes: list[dict[str, Any]] | None = None, tree: dict[str, Any] | None = None, **primitive: Any
) -> bytes:
    """A GLB of a triangle, with other nodes, entries of its tree, and entries of its primitive."""
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=nodes or [{"mesh": 0}])
    part = {"attributes": {"POSITION": writer.add(TRIANGLE)}} | primitive
    writer.tree |= {"meshes": [{"primitives": [part]}]} | (tree or {})
    return writer.glb()


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    skin=st.integers(0, 2),
    morphs=st.integers(0, 3),
    instances=st.booleans(),
    mode=st.sampled_from([4, 5, 6]),
    kind=st.sampled_from(["f4", "i1", "u1", "i2", "u2"]),
    sparse=st.booleans(),
)
def test_random_files_are_read_as_they_are_meant(
    seed: int, skin: int, morphs: int, instances: bool, mode: int, kind: str, sparse: bool
) -> None:
    """The triangles of nodes in trees, instances, skins and morph targets, whatever way the numbers are stored."""
    made = random_file(seed, skin=skin, morphs=morphs, instances=instances, mode=mode, kind=kind, sparse=sparse)
    assert_same_triangles(triangles_of(made.writer.glb()), np.stack(made.triangles))


@pytest.mark.parametrize("own", [{"translation": [5, 6, 7]}, {"scale": [9, 9, 9]}])
def test_a_skinned_mesh_is_where_its_joints_are(own: dict[str, Any]) -> None:
    """Half-way between two joints; whatever the node that shows it says of itself."""
    writer = GltfWriter(scene=0, scenes=[{"nodes": [2, 0, 1]}])
    part = {
        "attributes": {
            "POSITION": writer.add(TRIANGLE),
            "JOINTS_0": writer.add(np.tile(np.array([0, 1, 0, 0], "u1"), (3, 1))),
            "WEIGHTS_0": writer.add(np.tile(np.array([0.5, 0.5, 0, 0], "<f4"), (3, 1))),
        }
    }
    nodes = [{"translation": [0, 0, 2]}, {"translation": [0, 4, 0]}, {"mesh": 0, "skin": 0, **own}]
    writer.tree |= {"meshes": [{"primitives": [part]}], "nodes": nodes, "skins": [{"joints": [0, 1]}]}
    np.testing.assert_allclose(triangles_of(writer.glb())[0], TRIANGLE + np.array([0, 2, 1]), atol=1e-6)


def test_weights_of_morph_targets_are_the_nodes_else_the_meshs_else_none() -> None:
    for node, mesh, expected in (([2], [1], 2), (None, [1], 1), (None, None, 0)):
        writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}])
        move = writer.add(np.tile(np.array([0, 0, 3], "<f4"), (3, 1)))
        part = {"attributes": {"POSITION": writer.add(TRIANGLE)}, "targets": [{"POSITION": move}]}
        writer.tree |= {
            "nodes": [{"mesh": 0} | ({"weights": node} if node else {})],
            "meshes": [{"primitives": [part]} | ({"weights": mesh} if mesh else {})],
        }
        np.testing.assert_allclose(triangles_of(writer.glb())[0], TRIANGLE + np.array([0, 0, 3 * expected]))


def test_the_outside_of_a_mirrored_mesh_is_still_outside(tmp_path: Path) -> None:
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0, "scale": [1, 1, -2]}])
    part = {
        "attributes": {"POSITION": writer.add(BALL.vertices.astype("<f4"))},
        "indices": writer.add(BALL.faces.reshape(-1, 1).astype("<u2")),
    }
    writer.tree |= {"meshes": [{"primitives": [part]}]}
    (tmp_path / "scan.glb").write_bytes(writer.glb())
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    assert cloud.normals is not None
    assert (np.einsum("nd,nd->n", cloud.normals, cloud.xyz) > 0).all()


@pytest.mark.parametrize(("rotation", "quarter"), [([0, 0, 5, 5], True), ([0, 0, 0, 0], False)])
def test_rotations_of_any_length_only_turn(rotation: list[float], quarter: bool) -> None:
    """As some writers have them; one of length zero turns nothing."""
    meant = np.stack([-TRIANGLE[:, 1], TRIANGLE[:, 0], TRIANGLE[:, 2]], axis=1) if quarter else TRIANGLE
    found = triangles_of(one_mesh(nodes=[{"mesh": 0, "rotation": rotation}]))
    np.testing.assert_allclose(found[0], meant, atol=1e-9)


def test_hidden_nodes_and_those_below_them_are_not_shown() -> None:
    hidden = {"extensions": {"KHR_node_visibility": {"visible": False}}}
    nodes = [{"children": [1, 2]}, {"mesh": 0, "translation": [0, 0, 1]}, {"children": [3], **hidden}, {"mesh": 0}]
    np.testing.assert_allclose(triangles_of(one_mesh(nodes=nodes)), [TRIANGLE + np.array([0, 0, 1])])


def test_parts_that_share_their_vertices_read_those_they_use() -> None:
    """Each has three of a million vertices, in all more than may be read."""
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0}])
    rows = np.random.default_rng(0).normal(size=(1_000_000, 3)).astype("<f4")
    position, faces = writer.add(rows), np.arange(300).reshape(100, 3) * 3_000
    parts = [
        {"attributes": {"POSITION": position}, "indices": writer.add(face[:, None].astype("<u4"))} for face in faces
    ]
    writer.tree |= {"meshes": [{"primitives": parts}]}
    np.testing.assert_allclose(triangles_of(writer.glb()), rows[faces])


def test_what_is_not_read_is_named_in_one_sentence() -> None:
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0}])
    attributes = {"POSITION": writer.add(TRIANGLE)}
    writer.tree |= {
        "meshes": [{"primitives": [{"attributes": attributes, "mode": mode} for mode in (0, 1, 3, 4)]}],
        "animations": [{}],
        "cameras": [{}],
        "extensionsUsed": ["ACME_shapes", "KHR_materials_clearcoat", "KHR_draco_mesh_compression"],
    }
    (warning,) = mesh_of(writer.glb()).warnings
    assert warning == (
        "scan.glb: was read without these parts of it: "
        "animations, cameras, lines, points beside the surface, ACME_shapes"
    )
    assert mesh_of(one_mesh()).warnings == ()


HOSTILE: dict[str, tuple[str, Any]] = {
    "a node below itself": ("below itself", lambda: one_mesh(nodes=[{"mesh": 0, "children": [0]}])),
    "nodes below each other": (
        "below itself",
        lambda: one_mesh(nodes=[{"mesh": 0}, {"children": [2]}, {"children": [1]}]),
    ),
    "a node below two others": (
        "below two others",
        lambda: one_mesh(nodes=[{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]),
    ),
    "a child that is not there": ("nodes has no entry of number 9", lambda: one_mesh(nodes=[{"children": [9]}])),
    "a mesh before the first": ("meshes has no entry of number -1", lambda: one_mesh(nodes=[{"mesh": -1}])),
    "a skin that is not there": ("skins has no entry", lambda: one_mesh(nodes=[{"mesh": 0, "skin": 0}])),
    "a joint that is not there": (
        "nodes has no entry of number 7",
        lambda: one_mesh(nodes=[{"mesh": 0, "skin": 0}], tree={"skins": [{"joints": [7]}]}),
    ),
    "a material that is not there": ("materials has no entry", lambda: one_mesh(material=3)),
    "an accessor that is not there": ("accessors has no entry", lambda: one_mesh(indices=5)),
    "indices that are no whole numbers": ("indices of vertices", lambda: one_mesh(indices=0)),
    "a scene that is not there": ("scenes has no entry", lambda: one_mesh(tree={"scene": 1})),
    "an older format": ("needs glTF 1.0", lambda: one_mesh(tree={"asset": {"version": "1.0"}})),
    "Draco alone": (
        "needs KHR_draco_mesh_compression",
        lambda: one_mesh(
            tree={"accessors": [{"count": 3, "componentType": 5126, "type": "VEC3"}]},
            extensions={"KHR_draco_mesh_compression": {}},
        ),
    ),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_what_leads_nowhere_or_in_circles_is_named(kind: str) -> None:
    says, make = HOSTILE[kind]
    with pytest.raises(CaptureError, match=says) as caught:
        mesh_of(make())
    assert caught.value.code == "CAPTURE_UNREADABLE"


def many_instances(count: int) -> bytes:
    """Instances whose places take no bytes."""
    attributes = {"TRANSLATION": 0}
    node = {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=[node])
    writer.tree["accessors"].append({"count": count, "componentType": 5126, "type": "VEC3"})
    part = {
        "attributes": {"POSITION": writer.add(TRIANGLE)},
        "indices": writer.add(np.tile([[0], [1], [2]], (300, 1)).astype("u1")),
    }
    writer.tree |= {"meshes": [{"primitives": [part]}]}
    return writer.glb()


def many_targets(count: int) -> bytes:
    """Morph targets that all have the same displacements, of which none takes bytes."""
    writer = GltfWriter(scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0, "weights": [1] * count}])
    writer.tree["accessors"].append({"count": 100_000, "componentType": 5126, "type": "VEC3"})
    part = {"attributes": {"POSITION": 0}, "targets": [{"POSITION": 0}] * count}
    writer.tree |= {"meshes": [{"primitives": [part]}]}
    return writer.glb()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (lambda: many_instances(2_000_000), "EXT_mesh_gpu_instancing"),
        (lambda: many_instances(20_000), "6,000,000 triangles"),
        (lambda: many_targets(100), "points"),
    ],
)
def test_what_costs_much_and_takes_few_bytes_is_refused(data: Any, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.edge.clouds.gltf.MAX_POINTS", 1_000_000)
    with pytest.raises(CaptureError, match=says) as caught:
        mesh_of(data())
    assert caught.value.code == "CAPTURE_TOO_LARGE"


def test_a_file_of_all_kinds_is_read() -> None:
    assert len(triangles_of(posed_glb())) == 8
