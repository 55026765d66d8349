"""PLY out: an independent reader finds what was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from capture2vr.edge.export.ply import ply_bytes, write_ply
from tests.support import surfaces

MESH = surfaces.grid_with_holes()


def _read(path: Path) -> trimesh.Trimesh:
    """The mesh as it stands in the file: nothing merged and nothing left out."""
    return trimesh.load_mesh(path, process=False)


def _properties(read: trimesh.Trimesh) -> dict[str, list[str]]:
    """Names by element, from the header."""
    return {name: list(element["properties"]) for name, element in read.metadata["_ply_raw"].items()}


def test_geometry_and_colours_come_back(tmp_path: Path) -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (len(MESH.vertices), 3), dtype=np.uint8)
    write_ply(replace(MESH, rgb=rgb), tmp_path / "mesh.ply")
    read = _read(tmp_path / "mesh.ply")
    assert _properties(read) == {"vertex": ["x", "y", "z", "red", "green", "blue"], "face": ["vertex_indices"]}
    assert np.array_equal(read.vertices, MESH.vertices.astype(np.float32))
    assert np.array_equal(read.visual.vertex_colors[:, :3], rgb)
    assert np.array_equal(read.faces, MESH.faces)


def test_a_mesh_without_colours_has_none(tmp_path: Path) -> None:
    write_ply(MESH, tmp_path / "mesh.ply")
    assert _properties(_read(tmp_path / "mesh.ply"))["vertex"] == ["x", "y", "z"]


def test_far_from_the_origin_no_millimetre_is_lost(tmp_path: Path) -> None:
    offset = np.array([345_678.25, 5_432_100.5, 321.0])
    (tmp_path / "mesh.ply").write_bytes(ply_bytes(MESH, offset=offset))
    read = _read(tmp_path / "mesh.ply")
    np.testing.assert_allclose(read.vertices - offset, MESH.vertices, atol=1e-6)
    assert np.array_equal(read.faces, MESH.faces)
