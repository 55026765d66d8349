"""Public test files of other projects, read by our readers and by theirs: read, refused by name, differing, crashed.

`python -m tests.bench readers FOLDER …`: every file of points or a mesh in the folders, such as clones of trimesh,
laspy, PDAL, pye57, tinyobjloader and assimp. `--list` names those that are not read like that. They are read in
processes of their own, ten in each; a crash is one of the file alone.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture

_MESHES = (".obj", ".stl", ".off", ".glb", ".gltf", ".ply")
_SUFFIXES = (
    *_MESHES,
    ".las",
    ".laz",
    ".e57",
    ".pcd",
    ".xyz",
    ".pts",
    ".ptx",
    ".csv",
    ".txt",
    ".npy",
    ".gz",
    ".spz",
    ".splat",
)
_BESIDE = (".mtl", ".bin", ".png", ".jpg", ".jpeg", ".tga", ".bmp", ".webp")
_TEXTS = (".csv", ".txt", ".gz")  # endings that say nothing: such a file counts where it was read
_AT_ONCE = 10
_SECONDS = 300  # for the files of one process
_MOST_BESIDE = 64 << 20  # bytes of the files beside a mesh that are copied with it
_NEAR = 0.02  # of the size: bounds that differ by more are others; points on a surface do not reach its corners


@dataclass(frozen=True, slots=True)
class FileOutcome:
    """What became of a file: how ("read", "refused", "differs" or "crash"), why, and the seconds of reading."""

    file: Path
    how: str
    why: str = ""
    seconds: float = 0.0


def main(arguments: list[str]) -> None:
    """Print a table of the files in some folders by their ending."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench readers", description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--list", action="store_true", help="name each file that was not read as others read it")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.child:
        for file in options.folders:
            print(json.dumps(_look_at(file)), flush=True)
        return
    files = [path for folder in options.folders for path in sorted(folder.rglob("*")) if _is_wanted(path)]
    with ThreadPoolExecutor(2) as pool:
        parts = [files[start : start + _AT_ONCE] for start in range(0, len(files), _AT_ONCE)]
        outcomes = [each for part in pool.map(_outcomes, parts) for each in part]
    known = [each for each in outcomes if each.how != "refused" or each.file.suffix.lower() not in _TEXTS]
    print("| ending | files | read | refused by name | differ | crash | slowest, s |")
    print("|---" * 7 + "|")
    for row in _rows(known):
        print(f"| {' | '.join(map(str, row))} |")
    if options.list:
        for each in known:
            if each.how != "read":
                print(f"- {each.how}: {each.file} {each.why}")


def _is_wanted(path: Path) -> bool:
    return path.suffix.lower() in _SUFFIXES and path.is_file() and not path.is_symlink() and path.stat().st_size > 0


def _rows(outcomes: Sequence[FileOutcome]) -> Iterator[list[object]]:
    for ending in sorted({each.file.suffix.lower() for each in outcomes}):
        own = [each for each in outcomes if each.file.suffix.lower() == ending]
        count = Counter(each.how for each in own)
        codes = Counter(each.why.split(":")[0] for each in own if each.how == "refused")
        refused = ", ".join(f"{number} {code}" for code, number in codes.most_common())
        slowest = f"{max(each.seconds for each in own):.2f}"
        yield [ending, len(own), count["read"], refused, count["differs"], count["crash"], slowest]


def _outcomes(files: Sequence[Path]) -> list[FileOutcome]:
    """Read files in a process of its own; one after another where that ends badly."""
    command = [sys.executable, "-m", "tests.bench.readers", "--child", *map(str, files)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS, check=False)
        lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        ended = f"exit code {done.returncode}: {done.stderr.strip()[-200:]}"
    except subprocess.TimeoutExpired:
        lines, ended = [], f"over {_SECONDS} s"
    if len(lines) == len(files):
        return [FileOutcome(file, **line) for file, line in zip(files, lines, strict=True)]
    if len(files) == 1:
        return [FileOutcome(files[0], "crash", ended)]
    return [each for file in files for each in _outcomes([file])]


def _look_at(file: Path) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as scratch:
        began = time.perf_counter()
        try:
            capture = read_capture(_alone(file, Path(scratch)))
        except CaptureError as error:
            return {"how": "refused", "why": f"{error.code}: {error.message}"}
        except Exception as error:  # noqa: BLE001 - whatever else comes out of a reader is a crash
            return {"how": "crash", "why": repr(error)}
        seconds = time.perf_counter() - began
    if capture.cloud is None:
        return {"how": "read", "seconds": seconds}
    origin = np.zeros(3) if capture.cloud.origin is None else capture.cloud.origin
    ours = np.stack([capture.cloud.xyz.min(axis=0), capture.cloud.xyz.max(axis=0)]) + origin
    theirs = _their_bounds(file)
    if file.suffix.lower() in (".las", ".laz"):  # whose heights may have another unit, which laspy does not convert
        ours, theirs = ours[:, :2], None if theirs is None else theirs[:, :2]
    if theirs is None or np.abs(ours - theirs).max() <= _NEAR * float(np.ptp(theirs, axis=0).max()):
        return {"how": "read", "seconds": seconds}
    why = f"{ours.round(4).tolist()} instead of {theirs.round(4).tolist()}"
    return {"how": "differs", "why": why, "seconds": seconds}


def _alone(file: Path, scratch: Path) -> Path:
    """Copy a file to a folder: a mesh with what lies beside it, such as its materials, but no other mesh."""
    shutil.copyfile(file, scratch / file.name)
    if file.suffix.lower() not in (".obj", ".gltf"):
        return scratch / file.name
    left = _MOST_BESIDE
    for path in sorted(file.parent.rglob("*")):
        if path.is_file() and path.suffix.lower() in _BESIDE and (left := left - path.stat().st_size) > 0:
            target = scratch / path.relative_to(file.parent)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    return scratch


def _their_bounds(file: Path) -> Any:
    """(2,3) the least and the greatest coordinates as another reader has them; None where it does not read the file."""
    try:
        if file.suffix.lower() in (".las", ".laz"):
            import laspy

            xyz = np.asarray(laspy.read(file).xyz)
        elif file.suffix.lower() == ".e57":
            import pye57

            scans = pye57.E57(str(file))
            parts = [scans.read_scan(number, ignore_missing_fields=True) for number in range(scans.scan_count)]
            xyz = np.concatenate([np.stack([part[f"cartesian{axis}"] for axis in "XYZ"], axis=1) for part in parts])
        elif file.suffix.lower() in _MESHES:
            import trimesh

            bounds = trimesh.load_scene(file).bounds
            return None if bounds is None or not np.isfinite(bounds).all() else np.asarray(bounds)
        else:
            return None
        xyz = xyz[np.isfinite(xyz).all(axis=1)]
        return np.stack([xyz.min(axis=0), xyz.max(axis=0)])
    except Exception:  # noqa: BLE001 - what the other reader cannot read is not compared
        return None


if __name__ == "__main__":
    main(sys.argv[1:])
