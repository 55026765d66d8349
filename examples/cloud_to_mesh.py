"""From a point cloud to a mesh: `python examples/cloud_to_mesh.py cloud.npy mesh.glb`.

The cloud is a .npy of N rows, x y z or x y z r g b (bytes); any unit, any frame. The mesh is in the same frame, in the
format that its name ends with: .glb, .ply, .obj or .stl.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import capture2vr


def main() -> None:
    """Read the cloud, reconstruct its surface, write the mesh."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--preset", default="auto", help="draft: within seconds; auto: by the points and the device")
    parser.add_argument("--resolution", type=int, default=0, help="cells along the longest side; 0: by the points")
    asked = parser.parse_args()

    columns = np.load(asked.cloud)
    xyz, rgb = columns[:, :3], columns[:, 3:6].astype(np.uint8) if columns.shape[1] >= 6 else None
    mesh = capture2vr.mesh_from_points(
        xyz,
        rgb,
        asked.preset,
        resolution=asked.resolution,
        progress=lambda each: print(f"{each.fraction:4.0%}  {each.stage}"),
    )
    mesh.to_trimesh().export(asked.mesh)
    print(f"{asked.mesh}: {len(mesh.vertices):,} vertices, {len(mesh.faces):,} triangles")


if __name__ == "__main__":
    main()
