"""PLY out: an independent reader finds what was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from plyfile import PlyData

from services.edge.mesh import write_ply
from tests import surfaces

MESH = surfaces.grid_with_holes()


def test_geometry_and_colours_come_back(tmp_path: Path) -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (len(MESH.vertices), 3), dtype=np.uint8)
    write_ply(replace(MESH, rgb=rgb), tmp_path / "mesh.ply")
    read = PlyData.read(tmp_path / "mesh.ply")
    vertex = read["vertex"]
    assert np.array_equal(np.stack([vertex[axis] for axis in "xyz"], axis=1), MESH.vertices.astype(np.float32))
    assert np.array_equal(np.stack([vertex[band] for band in ("red", "green", "blue")], axis=1), rgb)
    assert np.array_equal(np.stack(read["face"]["vertex_indices"]), MESH.faces)


def test_a_mesh_without_colours_has_none(tmp_path: Path) -> None:
    write_ply(MESH, tmp_path / "mesh.ply")
    assert [item.name for item in PlyData.read(tmp_path / "mesh.ply")["vertex"].properties] == ["x", "y", "z"]
