"""Writing small captures for tests and benches."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def write_ply(path: Path, xyz: np.ndarray, rgb: np.ndarray | None = None) -> Path:
    """A binary PLY of (N,3) points with optional (N,3) uint8 colours, as scanning apps export them."""
    fields = [(axis, "<f8") for axis in "xyz"] + (
        [(c, "u1") for c in ("red", "green", "blue")] if rgb is not None else []
    )
    rows = np.empty(len(xyz), dtype=fields)
    for axis, column in zip("xyz", np.asarray(xyz).T, strict=True):
        rows[axis] = column
    if rgb is not None:
        for name, column in zip(("red", "green", "blue"), rgb.T, strict=True):
            rows[name] = column
    kinds = {"<f8": "double", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(xyz)}"]
    header += [f"property {kinds[kind]} {name}" for name, kind in fields] + ["end_header", ""]
    path.write_bytes("\n".join(header).encode() + rows.tobytes())
    return path


def sphere_points(count: int) -> np.ndarray:
    """(count,3) points at random on the unit sphere, the same each time."""
    directions = np.random.default_rng(0).normal(size=(count, 3))
    unit: np.ndarray = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return unit
