"""One published network on one cloud, in an interpreter that has what it needs: a process of its own.

    python -m tests.bench.peers.peer_fields_child PEER FOLDER POINTS.npz MESH.npz CELLS

FOLDER holds the peer's repository with its weights; nothing of it is in this one. POINTS holds points (N,3) in the unit
frame; MESH gets vertices, faces, CPU seconds without imports, and peak memory. `peer_ops` stands in for GPU libraries.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import runpy
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tests.bench.peers import peer_ops

Arrays = tuple[Any, Any]
GEOUDF_WEIGHTS = Path("log_reconstruction_100.00_1.000_0.100")  # as its program names it
GEOUDF_PROGRAM = "eval_rec.py"
LOCAL_WEIGHTS = Path("DCUDF/pretrained_models/UDF/gf_sf_250/udf_model_best.t7")
_CHUNK = 1 << 14  # queries at once: a neighbourhood of 10 takes 10 kB of activations a query and layer


def main() -> None:
    """Reconstruct, and write the mesh."""
    peer, folder, source, target, cells = sys.argv[1:]
    with np.load(source) as stored:
        points = stored["points"].astype(np.float64)
    torch.manual_seed(0)
    peer_ops.install()
    sys.path.insert(0, folder)
    vertices, faces, seconds = PEERS[peer](Path(folder), points, int(cells))
    peak = int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
    np.savez(target, vertices=vertices, faces=faces, seconds=seconds, peak_mb=peak)


def _geoudf_program(folder: Path, points: Any, cells: int) -> tuple[Any, Any, float]:
    """GeoUDF's own program as it stands: points made denser, its field, its edge-based marching cubes."""
    trimesh = _trimesh()
    for library in ("numba", "open3d"):
        if importlib.util.find_spec(library):  # imports are no part of its seconds
            importlib.import_module(library)
    with tempfile.TemporaryDirectory() as scratch:
        cloud, made = Path(scratch) / "points.ply", Path(scratch) / "mesh.ply"
        trimesh.PointCloud(points).export(cloud)
        sys.argv = [GEOUDF_PROGRAM, f"--res={cells}", f"--input={cloud}", f"--output={made}"]
        os.chdir(folder)
        began = time.process_time()
        runpy.run_path(GEOUDF_PROGRAM, run_name="__main__")
        seconds = time.process_time() - began
        mesh = trimesh.load(made, process=False)
        return np.asarray(mesh.vertices), np.asarray(mesh.faces), seconds


def _trimesh() -> Any:
    """trimesh with the two methods that GeoUDF calls and later versions have under other names."""
    trimesh = importlib.import_module("trimesh")
    for name, mask in (("remove_duplicate_faces", "unique_faces"), ("remove_degenerate_faces", "nondegenerate_faces")):
        if not hasattr(trimesh.Trimesh, name):
            setattr(trimesh.Trimesh, name, lambda self, mask=mask: self.update_faces(getattr(self, mask)()))
    return trimesh


def _geoudf(folder: Path, points: Any) -> Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]:
    """GeoUDF's field: value and gradient are two heads of its network."""
    model = importlib.import_module("model")
    upsampling = with_weights(model.PUGeo(knn=20), folder / GEOUDF_WEIGHTS / "pu_model_best.t7")
    network = with_weights(model.UDF(), folder / GEOUDF_WEIGHTS / "udf_model_best.t7")
    with torch.no_grad():
        dense = upsampling(torch.from_numpy(points).float().T[None])

    def field(queries: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        with torch.no_grad():
            values, gradients = network(dense, queries.T[None])
        return values[0], gradients[0]

    return field


def _local_shape(folder: Path, points: Any) -> Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]:
    """The field of the local-shape network under DCUDF/ of LoSF's repository; its gradient by differentiation."""
    sys.path.insert(0, str(folder / "DCUDF"))
    network = with_weights(importlib.import_module("udf_models").Weighted_Dist_UDF(), folder / LOCAL_WEIGHTS)
    cloud = torch.from_numpy(points).float()[None]

    def field(queries: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        asked = queries.clone().requires_grad_()
        values = network(cloud, asked.T[None])[0]
        (slope,) = torch.autograd.grad(values.sum(), asked)
        return values.detach(), slope / (slope.norm(dim=1, keepdim=True) + 1e-12)

    return field


def with_weights(network: torch.nn.Module, path: Path) -> torch.nn.Module:
    """The network with stored weights, whose names may have the prefix of one that was trained on several GPUs."""
    stored = torch.load(path, map_location="cpu", weights_only=True)
    network.load_state_dict({name.removeprefix("module."): values for name, values in stored.items()})
    return network.eval()


def _meshed(field_of: Callable[[Path, Any], Any], folder: Path, points: Any, cells: int) -> tuple[Any, Any, float]:
    """A peer's field, meshed by the product's extraction and cleaning."""
    from capture2vr.edge.mesh.clean import clean
    from capture2vr.edge.mesh.extract import extract

    began = time.process_time()
    field = field_of(folder, points)

    def distance(queries: Any) -> Arrays:
        parts = torch.from_numpy(np.ascontiguousarray(queries, np.float32)).split(_CHUNK)
        answers = [field(part) for part in parts]
        values, gradients = (torch.cat(each).numpy() for each in zip(*answers, strict=True))
        return values, gradients

    mesh = clean(extract(distance, points, resolution=cells), points)
    return mesh.vertices, mesh.faces, time.process_time() - began


def _geoudf_field(folder: Path, points: Any, cells: int) -> tuple[Any, Any, float]:
    return _meshed(_geoudf, folder, points, cells)


def _local_shape_field(folder: Path, points: Any, cells: int) -> tuple[Any, Any, float]:
    return _meshed(_local_shape, folder, points, cells)


PEERS = {"geoudf": _geoudf_program, "geoudf-field": _geoudf_field, "local-shape": _local_shape_field}


if __name__ == "__main__":
    main()
