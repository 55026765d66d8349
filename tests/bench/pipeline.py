"""Capture to published LOD set, each capture in a process of its own so that its peak memory is its own."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.edge.read_capture import read_capture
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.bench.data_files import data_file

_STAGES = ("POINT_CLOUD", "FITTING", "EXTRACTING", "TEXTURING", "PACKING", "PUBLISHING")


def dress(points: int) -> Capture:
    """Area-weighted samples of the dress."""
    import trimesh

    mesh = trimesh.load(data_file("dress/dress-v17k-f34k.obj"), process=False)
    return Capture("points", "sampled", Cloud(np.asarray(trimesh.sample.sample_surface(mesh, points, seed=0)[0])))


def room(points: int) -> Capture:
    """A furnished room of 5 × 4 × 2.6 m as a scanner sees it from inside, σ = 2 mm."""
    rng = np.random.default_rng(0)
    boxes = [((0, 0, 0), (5, 4, 2.6))]
    boxes += [
        ((x, y, 0), (w, d, h))
        for x, y, w, d, h in [(0.3, 0.3, 2, 0.9, 0.8), (3, 2.5, 1.6, 1, 0.74), (4.2, 0, 0.8, 0.5, 2)]
    ]
    corners, edges = [], []
    for low, size in boxes:
        for axis in range(3):
            u, v = (each for each in range(3) if each != axis)
            for side in (0, size[axis]):
                corner = np.array(low, float)
                corner[axis] += side
                corners.append(corner)
                edges.append((np.eye(3)[u] * size[u], np.eye(3)[v] * size[v]))
    area = np.array([np.linalg.norm(np.cross(*edge)) for edge in edges])
    face = rng.choice(len(corners), size=points, p=area / area.sum())
    s, t = rng.random((2, points, 1))
    xyz = np.array(corners)[face] + s * np.array(edges)[face, 0] + t * np.array(edges)[face, 1]
    xyz += rng.normal(scale=0.002, size=xyz.shape)
    rgb = (120 + 100 * np.sin(xyz * 3)).astype(np.uint8)
    return Capture("points", "simulated", Cloud(xyz, rgb), scale_confidence="metric", up=np.array([0.0, 0.0, 1.0]))


CASES = {
    "dress, 10,000 points": lambda: dress(10_000),
    "dress, 50,000 points": lambda: dress(50_000),
    "living room, 5 RGB-D frames": lambda: read_capture(data_file("rgbd_livingroom")),
    "scanned room, 196,133 points": lambda: read_capture(data_file("cloud_room/fragment.pcd")),
    "room, 1,000,000 points": lambda: room(1_000_000),
}


def one(name: str) -> dict[str, object]:
    """Run one case in this process: seconds per stage, peak memory, size of the result."""
    capture = CASES[name]()
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for step in reconstruct(capture, load_preset("draft")):
            if isinstance(step, Bundle):
                bundle = step
        seconds = dict(bundle.manifest["seconds"])
        published = time.perf_counter()
        publish(bundle, LocalStore(Path(folder)), key="bench")
        seconds["PUBLISHING"] = time.perf_counter() - published
    return {
        "seconds": seconds,
        "total": time.perf_counter() - began,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "quality": bundle.manifest["quality"],
    }


def main(arguments: list[str]) -> None:
    """Print the table; an argument picks the cases that contain it."""
    print(f"| capture | cells | triangles | {' | '.join(stage.lower() for stage in _STAGES)} | total s | peak MB |")
    print(f"|---|---|---|{'---|' * len(_STAGES)}---|---|")
    for name in CASES:
        if arguments and arguments[0] not in name:
            continue
        command = [
            sys.executable,
            "-c",
            f"import json; from tests.bench.pipeline import one; print(json.dumps(one({name!r})))",
        ]
        row = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
        stages = " | ".join(f"{row['seconds'].get(stage, 0):.2f}" for stage in _STAGES)
        quality = row["quality"]
        print(
            f"| {name} | {quality['resolution']} | {quality['triangles']:,} | {stages} | {row['total']:.1f} "
            f"| {row['peak_mb']:,.0f} |",
            flush=True,
        )
