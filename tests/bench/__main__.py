"""`python -m tests.bench NAME`: the tables of tests/bench/results. Compare timings within one run only."""

from __future__ import annotations

import importlib
import os
import platform
import sys

from tests.bench.data_files import DataMissing

BENCHES = {
    "yardstick": "every shape by every method: how near, how whole, how long; kept in yardstick.json",
    "ablation": "each loss off in turn, and the weight of self-consistency (the paper's Table 4)",
    "complexity": "parameters, bytes, seconds a step of our network and the ancestors' (the paper's Table 5)",
    "extraction": "seconds, memory and topology of the extraction, 64 to 512 cells, local and learned field",
    "photos": "photos to points: seconds per stage, and distance from a surface that is known",
    "matching": "photos that are hard to place: placed, errors of the cameras, by SIFT and with the network's matches",
    "captures": "captures to assets beside held-out photos: holes, leaks, likeness, seconds",
    "rendered": "photos rendered of what is hard to capture, beside the true surface: depth by luma, openings",
    "texture": "seconds and CPU seconds of each level's texture, held-out likeness; --old COMMIT beside it",
    "masks": "the cut-out of one photo before busy backgrounds: automatic, by a tap, by a rectangle",
    "single-image": "one photo to points, held-out shapes: our heads, the mean shape, the nearest training shapes",
    "delivery": "what reaches a headset: bytes, seconds on the wire and to import, errors of the levels of detail",
    "pipeline": "capture to published LOD set: seconds per stage and peak memory",
    "walk": "five minutes in a scene of 1,365 tiles, in an emulated headset: bytes kept, heap, first picture",
    "visit": "the viewer in a browser on a throttled link: first mesh, bytes, longest task, three visits",
    "lighthouse": "Lighthouse on its emulated phone: accessibility and speed of capture, collection and viewer",
    "phone": "photos of a phone through gateway and worker: seconds to the preview and to the end",
    "service": "many people on one service: what keys cost, 10,000 tenants, turns in the queue, kills",
    "catalogue": "a publication and a look in collections of 100 to 1,000,000 assets; 32 publishers at once",
    "dispatch": "10,000 queued jobs, 4 gateways, 50 pretend workers, one Postgres: no job twice, milliseconds, CPU",
    "jobs": "millions of jobs in one database: milliseconds of the metrics, the queue's figures, a new job",
    "trace": "one capture's trace over gateway and worker, drawn as a waterfall: where the seconds of a job go",
    "engine": "16 jobs on a real Ray cluster of 1, 2 and 4 nodes: seconds, share of k times one node",
    "fuzz": "hostile files of every format: answers, CPU seconds, memory, what is left; resumable",
    "attack": "the attacks of docs/security.md on a started product: answers, CPU seconds, memory, what others waited",
    "uploads": "32 phones of 20 MB each, plain and resumable: seconds, memory, latency; a film of 1 GB with 20 cuts",
}
ON_DEMAND = {
    "splats": "Gaussian splats beside the mesh that they cover: likeness to held-out photos, bytes",
    "formats": "which programs read what is downloaded: Blender, Godot, Babylon.js, glTF-Transform, usd-core, trimesh",
    "odd": "valid but odd files that mean what is known: right, wrong, refused, crashed; --siblings of misread ones",
    "models": "learned models (--folder DIR): masks and depth, seconds, memory; --settings FILE...: of ONNX Runtime",
    "search-index": "search in a collection of a million assets by its index: seconds, MB, milliseconds",
    "unity-runtime": "Unity's own Addressables, where you have it, on 10,000 assets: ms, requests, bytes of each step",
    "readers": "public test files of other projects: read as others read them, refused by name, crashed",
    "soak": "hours of 50 publishers at once on a service that is killed in parts every minute; FOLDER, resumable",
    "large-files": "tables, LAS, PLY, glTF of millions of points: CPU seconds and memory; --old COMMIT beside it",
    "scenes": "flats of 1 to 64 million points by tiles: time over area, memory, distance from the truth; resumable",
    "walkthrough": "a new user's way on a phone-sized page, each step with its picture",
    "rgbd-walk": "RGB-D walks of 500 and 2,000 frames through a flat: time, memory, distance; --track: drift",
    "fleet": "10 to 100,000 captures a day, simulated: first look, workers, cost, what a pool bears; --measure first",
    "tables": "the paper's Tables 2 and 3 on the ShapeNet shapes, 3D scenes, DeepFashion3D that you have",
    "table2": "the paper's Table 2: dress and truck, printed figures beside those reached",
    "table3": "the paper's Table 3: a lounge",
    "table4": "the paper's Table 4: with and without self-consistency, and memory",
    "table5": "the paper's Table 5: parameters, bytes, seconds; the same as complexity",
    "table6": "the paper's Table 6: reconstruct, send and import, by hand and by the product",
    "table7": "the paper's Table 7: vertices, edges, faces, bytes and seconds to import of each method's lounge",
    "figure5": "the paper's Figure 5: the dress in the colours of its error, by every method",
    "figure6": "the paper's Figure 6: the truck",
    "figure7": "the paper's Figure 7: the lounge",
    "figure8": "the paper's Figure 8: milliseconds a frame in a browser, and an estimate for Quest 3",
    "figure9": "the paper's Figure 9: garments that are deformed and partly hidden",
    "peer-extraction": "the extraction beside DCUDF2's and MIND's on the same fields, where you have them",
    "peer-fields": "published networks with their published weights (GeoUDF, LoSF), where you have them",
    "streams": "trainings of several jobs in one worker on a GPU: steps a second, on one CUDA stream and on one each",
    "published": "the methods of the literature at their own budget of steps: hours, resumable",
}

# Modules below tests/bench that are not called as their bench is, and whether one draws several tables or figures.
_MODULES = {
    **{name: (f"browser.{name}", False) for name in ("lighthouse", "visit", "walk", "walkthrough")},
    **{
        name: (f"load.{name}", False)
        for name in (
            "attack",
            "catalogue",
            "dispatch",
            "engine",
            "fleet",
            "fuzz",
            "jobs",
            "service",
            "soak",
            "streams",
            "trace",
            "uploads",
        )
    },
    **{name: (f"paper.{name}", False) for name in ("ablation", "complexity", "tables")},
    **dict.fromkeys(("table2", "table3", "table4"), ("paper.paper_tables", True)),
    "table5": ("paper.complexity", False),
    **dict.fromkeys(("table6", "table7"), ("paper.paper_delivery", True)),
    **dict.fromkeys(("figure5", "figure6", "figure7", "figure9"), ("paper.paper_figures", True)),
    "figure8": ("paper.frame_times", False),
    "models": ("peers.models", False),
    "masks": ("single_photo.masks", False),
    "single-image": ("single_photo.single_image", False),
    "peer-extraction": ("peers.peer_extraction", False),
    "peer-fields": ("peers.peer_fields", False),
    "unity-runtime": ("load.unity_runtime", False),
}


def main(arguments: list[str]) -> int:
    """Run the named bench, or all that need nothing but this checkout and the test data."""
    name, *rest = arguments or [""]
    known = {**BENCHES, **ON_DEMAND}
    if name not in {*known, "all"}:
        print("usage: python -m tests.bench NAME [OPTIONS]\n")
        for bench, what in {**known, "all": f"everything but {', '.join(ON_DEMAND)}"}.items():
            print(f"  {bench:<12} {what}")
        return 2
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    for bench in BENCHES if name == "all" else [name]:
        print(f"## {bench}\n")
        _run(bench, rest)
        print()
    return 0


def _run(bench: str, arguments: list[str]) -> None:
    name, own = _MODULES.get(bench, (bench.replace("-", "_"), False))
    module = importlib.import_module(f"tests.bench.{name}")
    try:
        module.main(arguments, *([bench] if own else []))
    except DataMissing as missing:
        raise SystemExit(f"{bench}: {missing}") from None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
