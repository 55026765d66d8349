"""Ball pivoting and screened Poisson of Open3D, as a program: `python peers.py ball-pivoting IN.npz OUT.npz`.

IN holds points (N,3); OUT gets vertices (V,3), faces (F,3), seconds and peak_mb. It imports nothing of ours, so that
any interpreter with Open3D can run it ($OPEN3D_PYTHON), and Open3D's crashes and memory stay out of the bench.

Settings are those of the published yardstick: estimated normals; radii of 1.2, 2 and 3.5 mean spacings; depth 8 and the
lowest 5 % of density trimmed. Peers get the points as scanned: neither has a step that removes noise or outliers.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import open3d as o3d

NORMAL_NEIGHBOURS, ORIENT_NEIGHBOURS = 16, 10  # the pair that gives the published figures; 30 and 30 are worse on cloth
RADII = (1.2, 2.0, 3.5)  # mean spacings
DEPTH = 8
TRIM = 0.05  # share of the vertices, those of least density: where Poisson closed what was open


def oriented(points: np.ndarray) -> o3d.geometry.PointCloud:
    """The cloud with estimated normals that agree with their neighbours'."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NORMAL_NEIGHBOURS))
    try:
        cloud.orient_normals_consistent_tangent_plane(ORIENT_NEIGHBOURS)
    except RuntimeError:  # points on one plane have no Delaunay tetrahedra to walk along, and any one side will do
        cloud.orient_normals_to_align_with_direction(np.linalg.svd(points - points.mean(0), full_matrices=False)[2][2])
    return cloud


def ball_pivoting(points: np.ndarray) -> o3d.geometry.TriangleMesh:
    """Bernardini et al. 1999: triangles that a rolling ball touches."""
    cloud = oriented(points)
    spacing = np.mean(cloud.compute_nearest_neighbor_distance())
    radii = o3d.utility.DoubleVector([radius * spacing for radius in RADII])
    return o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(cloud, radii)


def poisson(points: np.ndarray) -> o3d.geometry.TriangleMesh:
    """Kazhdan and Hoppe 2013: a closed indicator function, opened again where it had no points."""
    mesh, density = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(oriented(points), depth=DEPTH)
    density = np.asarray(density)
    mesh.remove_vertices_by_mask(density < np.quantile(density, TRIM))
    return mesh


PEERS = {"ball-pivoting": ball_pivoting, "poisson": poisson}


def peak_mb() -> float:
    """Peak resident memory of this process."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def main(name: str, source: str, target: str) -> None:
    """Mesh the points of `source` into `target`."""
    points = np.load(source)["points"].astype(np.float64)
    began = time.perf_counter()
    mesh = PEERS[name](points)
    seconds = time.perf_counter() - began
    np.savez(
        target,
        vertices=np.asarray(mesh.vertices),
        faces=np.asarray(mesh.triangles, np.int64),
        seconds=seconds,
        peak_mb=peak_mb(),
        version=f"Open3D {o3d.__version__}",
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
