"""One peer's extraction of one field, in the interpreter that has what the peer needs: a process of its own.

    python -m tests.bench.peers.peer_extraction_child PEER FOLDER TASK.json NETWORK.pt MESH.npz

FOLDER holds the peer's repository. Both peers ask for a GPU by name; here their tensors stay where they are. `dump`
writes the garment network that DCUDF2's repository carries.
"""

from __future__ import annotations

import functools
import importlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

SAMPLES, SAMPLED_CELLS = 1_000_000, 256  # MIND's points and cells; each point is queried 200 times, so
MOST_SAMPLES = 100_000  # no more are taken than these, and on fewer cells as many a cell's face as it takes
ITERATIONS = 150  # of DCUDF2, as in its own evaluation
_GARMENT = {"d_in": 3, "d_out": 1, "d_hidden": 256, "n_layers": 8, "skip_in": [4], "multires": 8, "bias": 0.5}


def main() -> None:
    """Extract, and write vertices, faces, seconds and peak memory."""
    peer, folder, task, stored, target = sys.argv[1:]
    sys.path.insert(0, folder)
    if peer == "dump":
        _dump(Path(folder), Path(stored))
        return
    field = torch.load(stored, weights_only=False)
    asked = json.loads(Path(task).read_text())
    low, high = np.array(asked["low"], np.float32), np.array(asked["high"], np.float32)
    # Both write pictures of their progress into the folder they run in.
    os.chdir(tempfile.mkdtemp())
    Path("experiment/optimizer").mkdir(parents=True)
    for kind in (torch.Tensor, torch.nn.Module):
        kind.cuda = lambda self, *_, **__: self
    began = time.perf_counter()
    mesh = EXTRACTIONS[peer](field, asked["resolution"], low, high)
    seconds = time.perf_counter() - began
    peak = int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
    np.savez(target, vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces), seconds=seconds, peak_mb=peak)


def _dcudf2(field: Any, resolution: int, low: Any, high: Any) -> Any:
    module = importlib.import_module("dcudf2.mesh_extraction")

    def query(points: torch.Tensor) -> torch.Tensor:
        return field(points)[:, None]

    made = module.dcudf2(
        query,
        resolution,
        0.005,
        max_iter=ITERATIONS,
        bound_min=low,
        bound_max=high,
        is_cut=True,
        local_it=100,
        local_weight=1,
        report_freq=10**6,
    )
    return made.optimize()


def _mind(field: Any, resolution: int, low: Any, high: Any) -> Any:
    # Its viewer is imported and never shown.
    sys.modules.setdefault("polyscope", type(sys)("polyscope"))
    made = importlib.import_module("mind").MIND(field, resolution, bound_min=low, bound_max=high)
    made.generate_pointcloud_mesh_op = functools.partial(
        made.generate_pointcloud_mesh_op, sample_num=samples_of(resolution)
    )
    return made.run()


def samples_of(cells: int) -> int:
    """MIND's points for a number of cells along a side."""
    return min(MOST_SAMPLES, round(SAMPLES * (cells / SAMPLED_CELLS) ** 2))


EXTRACTIONS = {"dcudf2": _dcudf2, "mind": _mind}


class Clamped(torch.nn.Module):
    """A network whose values are (N,) and not negative."""

    def __init__(self, network: torch.nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        values: torch.Tensor = self.network(points)[:, 0].abs()
        return values


class Embedding:
    """The positional encoding of DCUDF2's network, which is a local function there and cannot be stored."""

    def __init__(self, frequencies: int) -> None:
        self._frequencies = frequencies
        self._embed = importlib.import_module("models.embedder").get_embedder(frequencies)[0]

    def __call__(self, points: torch.Tensor) -> torch.Tensor:
        embedded: torch.Tensor = self._embed(points)
        return embedded

    def __reduce__(self) -> tuple[type[Embedding], tuple[int]]:
        return type(self), (self._frequencies,)


def _dump(folder: Path, target: Path) -> None:
    """Write the garment network that DCUDF2's repository carries, its weights without their norms."""
    # As it is imported elsewhere: what is stored names the module of its class.
    module = importlib.import_module("tests.bench.peers.peer_extraction_child")
    network = importlib.import_module("models.fields").UDFNetwork(**_GARMENT)
    stored = folder / "experiment" / "out_cloth_batch" / "564" / "checkpoints" / "ckpt_080000.pth"
    network.load_state_dict(torch.load(stored, map_location="cpu", weights_only=False)["udf_network_fine"])
    for layer in network.children():
        if isinstance(layer, torch.nn.Linear):
            torch.nn.utils.remove_weight_norm(layer)
    network.embed_fn_fine = module.Embedding(_GARMENT["multires"])
    torch.save(module.Clamped(network), target)


if __name__ == "__main__":
    main()
