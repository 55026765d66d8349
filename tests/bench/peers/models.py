"""Learned models with their true weights, where you have them: `--folder DIR` as EDGE_MODELS has it.

IS-Net beside our own cut, on photos: the share of the picture that each keeps, how alike the two are, and what the
model's process takes. `--sheet FILE` draws photo, our cut and the model's. `--settings FILE...` measures ONNX files
with other settings of ONNX Runtime instead, each in a process of its own.

MoGe-2, each that is there: its focal length beside that of the photo's metadata, how far its normals contradict its
depth, the size that it gives the object, and its depth beside a depth camera's.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.models.card import model_cards
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.graph import Graph
from capture2vr.edge.models.nouns import ModelError
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.single_photo.cutout import CutOut, cut_out, rotate_clockwise
from capture2vr.edge.single_photo.learned_depth import MODELS
from tests.bench.data_files import DataMissing, data_file
from tests.bench.peak_memory import peak_memory
from tests.bench.peers.model_depth import compare_depth
from tests.bench.texture import cpu_seconds

PHOTOS = (
    *(f"photos_statue/images/IMG_{number}.JPG" for number in (3023, 3031, 3039, 3047)),
    *(f"photos_banana/images/DSC_0{number}.JPG" for number in (423, 427)),
    *(f"photos_fruit/images/IMG_{number}.JPG" for number in (4190, 4195)),
    "rgbd_livingroom/color/00000.jpg",
)
SETTINGS = [(level, arena) for arena in (True, False) for level in ("ALL", "BASIC")]
_DIM = 0.2  # of what is cut away, in the sheet
_TILE = 240  # pixels of a picture's side there


@dataclass(frozen=True)
class Tried:
    """A cut, or why there is none, and what it took."""

    cut: CutOut | None
    said: str
    seconds: float
    processor_s: float
    megabytes: float


def main(arguments: list[str]) -> None:
    """Print the table. Raises DataMissing without a folder that has the models."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench models", description=__doc__)
    parser.add_argument("photos", nargs="*", type=Path, help="photos in place of those of the test data")
    parser.add_argument("--folder", type=Path, help="folder of the models")
    parser.add_argument("--sheet", type=Path, help="PNG to draw")
    parser.add_argument(
        "--settings", nargs="+", type=Path, default=(), help="ONNX files to measure with other settings"
    )
    options = parser.parse_args(arguments)
    photos = options.photos or [data_file(name) for name in PHOTOS]
    if options.settings:
        _compare_settings(options.settings, photos[0])
        return
    graphs = _graphs(options.folder)
    if "isnet" in graphs:
        _compare_cuts(ModelFolder(options.folder), photos, options.sheet)
    depth_models = [graph for name, graph in graphs.items() if name in MODELS]
    if depth_models:
        compare_depth(depth_models, photos)


def _graphs(folder: Path | None) -> dict[str, Graph]:
    """The models in the folder by name, once they have been checked. Raises DataMissing."""
    how = "`capture2vr models get NAME --folder DIR --accept-licence`, then --folder DIR"
    if folder is None:
        raise DataMissing(f"the models' weights are missing: {how}")
    try:
        found = {name: graph for name in model_cards() if (graph := ModelFolder(folder).find(name))}
        for graph in found.values():
            graph.check()
    except ModelError as error:
        raise DataMissing(error.with_remedy) from None
    if not found:
        raise DataMissing(f"no model is in {folder}: {how}")
    return found


def _compare_cuts(models: ModelFolder, paths: list[Path], sheet: Path | None) -> None:
    print("| photo | ours: area % | | IS-Net: area % | | IoU | seconds | CPU s | peak MB |")
    print("|---|---|---|---|---|---|---|---|---|")
    rows, used = [], 0
    for path in paths:
        photo = read_capture(path).photos[0]
        ours, learned = _tried(photo, None), _tried(photo, models)
        used += bool(learned.cut and learned.cut.models)
        took = f"{learned.seconds:.1f} | {learned.processor_s:.1f} | {learned.megabytes:.0f}"
        print(f"| {path.name} | {_area(ours)} | {_area(learned)} | {_alike(ours, learned)} | {took} |", flush=True)
        upright = rotate_clockwise(photo.load(1024), photo.turns)
        rows.append(np.hstack([_tile(upright, None), *(_drawn(upright, each) for each in (ours, learned))]))
    print(f"\nIS-Net decided in {used} of {len(paths)} photos. Memory is of its process and of this one together.")
    if sheet:
        cv2.imwrite(str(sheet), np.vstack(rows)[..., ::-1])


def _tried(photo: Photo, models: ModelFolder | None) -> Tried:
    began, busy = time.perf_counter(), cpu_seconds()
    with peak_memory() as peak:
        try:
            cut: CutOut | None = cut_out(photo, models=models)
        except CaptureError:
            cut = None
    said = "no object" if cut is None else "proposed" if any("stands out" in each for each in cut.warnings) else ""
    said = "model left out" if models and cut and not cut.models else said
    return Tried(cut, said, time.perf_counter() - began, cpu_seconds() - busy, peak.megabytes)


def _area(tried: Tried) -> str:
    return f"{100 * tried.cut.mask.mean():.1f} | {tried.said}" if tried.cut else f"| {tried.said}"


def _alike(one: Tried, other: Tried) -> str:
    """Intersection over union of two cuts."""
    if one.cut is None or other.cut is None:
        return ""
    first, second = one.cut.mask, other.cut.mask
    return f"{(first & second).sum() / max(1, (first | second).sum()):.2f}"


def _drawn(upright: Bytes, tried: Tried) -> Bytes:
    return _tile(upright if tried.cut is None else tried.cut.rgb, tried)


def _tile(rgb: Bytes, tried: Tried | None) -> Bytes:
    """Draw a picture into a square, what is cut away dimmed; all of it where there is no cut."""
    shown = rgb.astype(np.float32)
    if tried:
        kept = np.zeros(rgb.shape[:2], bool) if tried.cut is None else tried.cut.mask
        shown[~kept] = _DIM * shown[~kept] + [90, 0, 90]
    by = _TILE / max(rgb.shape[:2])
    small = cv2.resize(shown, None, fx=by, fy=by, interpolation=cv2.INTER_AREA)
    square = np.zeros((_TILE, _TILE, 3), np.uint8)
    square[: small.shape[0], : small.shape[1]] = small[:_TILE, :_TILE]
    return square


def _compare_settings(files: list[Path], photo: Path) -> None:
    """Measure each file with each setting. The first mask is what the others are compared with."""
    print("| file | optimised | arena | peak MB | of it before | load CPU s | run CPU s | mask off by at most, mean |")
    print("|---|---|---|---|---|---|---|---|")
    first: np.ndarray | None = None
    for file in files:
        for level, arena in SETTINGS:
            figures = _measured(file, photo, level, arena)
            mask = np.frombuffer(bytes.fromhex(figures.pop("mask")), np.uint8).reshape(128, 128) / 255
            first = mask if first is None else first
            off = f"{np.abs(mask - first).max():.2f}, {np.abs(mask - first).mean():.4f}"
            print(f"| {file.name} | {level} | {arena} | {' | '.join(map(str, figures.values()))} | {off} |", flush=True)


def _measured(file: Path, photo: Path, level: str, arena: bool) -> dict[str, Any]:
    command = [sys.executable, "-c", _ONE, str(file), str(photo), level, str(int(arena))]
    return dict(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))


_ONE = """
import json, resource, sys, time
import cv2, numpy as np, onnxruntime
file, photo, level, arena = sys.argv[1:]
memory = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000
options = onnxruntime.SessionOptions()
options.intra_op_num_threads, options.inter_op_num_threads = 2, 1
options.enable_cpu_mem_arena = options.enable_mem_pattern = arena == "1"
options.graph_optimization_level = getattr(onnxruntime.GraphOptimizationLevel, f"ORT_ENABLE_{level}")
options.add_session_config_entry("session.intra_op.allow_spinning", "0")
square = cv2.resize(cv2.imread(photo)[..., ::-1], (1024, 1024), interpolation=cv2.INTER_AREA).astype(np.float32)
square = ((square - 128) / 256).transpose(2, 0, 1)[None]
before, began = memory(), time.process_time()
session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
loaded = time.process_time()
mask = session.run(["output"], {"input": np.ascontiguousarray(square)})[0][0, 0]
ran = time.process_time()
took = {"peak": memory(), "before": before, "load": round(loaded - began, 2), "run": round(ran - loaded, 2)}
small = cv2.resize(mask, (128, 128), interpolation=cv2.INTER_AREA)
print(json.dumps({**took, "mask": (small * 255).round().astype(np.uint8).tobytes().hex()}))
"""
