"""Costs of reading large files: CPU seconds and peak memory, each in a process of its own, and the result's points.

With `--old COMMIT` the same files are read in a worktree of that commit just before, and the ratios are shown.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

ROOT = Path(__file__).parents[2]
_MILLION = 1_000_000
_AT_ONCE = 200_000  # rows of a table that are written at once


def _points(count: int, seed: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Points (N,6) in a room of 8 x 6 x 3 m, with colours of 0 to 255."""
    return np.random.default_rng(seed).uniform(0, [8, 6, 3, 255, 255, 255], (count, 6))


def _table(separator: str) -> Callable[[Path, int], None]:
    def write(path: Path, count: int) -> None:
        form = separator.join(["%.4f"] * 3 + ["%d"] * 3)
        with path.open("w") as file:
            for start in range(0, count, _AT_ONCE):
                np.savetxt(file, _points(min(_AT_ONCE, count - start), start), form)

    return write


def _las(path: Path, count: int) -> None:
    import laspy

    las = laspy.LasData(laspy.LasHeader(point_format=2, version="1.2"))
    las.header.scales = np.full(3, 1e-4)
    rows = _points(count)
    las.x, las.y, las.z = rows[:, :3].T
    las.red, las.green, las.blue = (rows[:, 3:].T * 257).astype(np.uint16)
    las.write(str(path))


def _ply_cloud(path: Path, count: int) -> None:
    rows = np.zeros(
        count, np.dtype([*((axis, "<f4") for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))])
    )
    for name, column in zip(rows.dtype.names or (), _points(count).T, strict=True):
        rows[name] = column
    kinds = ["float"] * 3 + ["uchar"] * 3
    lines = (f"property {kind} {name}" for kind, name in zip(kinds, rows.dtype.names or (), strict=True))
    head = "\n".join(["ply", "format binary_little_endian 1.0", f"element vertex {count}", *lines, "end_header\n"])
    path.write_bytes(head.encode() + rows.tobytes())


def _mesh(path: Path, count: int) -> None:
    """A hilly square of about so many triangles."""
    side = int(np.sqrt(count / 2))
    x, y = np.meshgrid(np.linspace(0, 1, side + 1), np.linspace(0, 1, side + 1))
    at = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    low = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:]], axis=-1).reshape(-1, 3)
    high = np.stack([at[:-1, :-1], at[1:, 1:], at[1:, :-1]], axis=-1).reshape(-1, 3)
    vertices = np.stack([x, y, 0.05 * np.sin(9 * x) * np.cos(7 * y)], axis=-1).reshape(-1, 3)
    trimesh.Trimesh(vertices, np.concatenate([low, high]), process=False).export(path)


ROWS: dict[str, tuple[str, Callable[[Path, int], None], float]] = {
    "table, blanks": ("a.xyz", _table(" "), 1.0),
    "table, commas": ("a.csv", _table(","), 0.25),
    "LAS": ("a.las", _las, 1.0),
    "PLY, points": ("a.ply", _ply_cloud, 1.0),
    "PLY, triangles": ("a.ply", _mesh, 0.1),
    "glTF, triangles": ("a.glb", _mesh, 0.1),
    "STL, triangles": ("a.stl", _mesh, 0.1),
}
"""By title: the file's name, what writes it, and how many points or triangles it has, of the largest."""


def _write(title: str, path: Path, count: int) -> None:
    ROWS[title][1](path, count)


def one(path: Path) -> dict[str, float]:
    """Read a capture in this process: CPU seconds, peak memory in MB and points."""
    from capture2vr.edge.read_capture import read_capture

    before = sum(each.ru_utime + each.ru_stime for each in _usage())
    capture = read_capture(path)
    assert capture.cloud is not None
    spent = sum(each.ru_utime + each.ru_stime for each in _usage()) - before
    peak = max(each.ru_maxrss for each in _usage()) / 1024
    count = capture.whole.count if capture.whole else len(capture.cloud.xyz)
    return {"seconds": spent, "mb": peak, "points": count}


def _usage() -> list[resource.struct_rusage]:
    return [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]


def _measured(tree: Path, path: Path) -> dict[str, float]:
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, str(Path(__file__).resolve()), str(path)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def _lines(millions: float, old: str, words: list[str]) -> Iterator[str]:
    from tests.bench.texture import worktree  # not above: an old commit's process has none

    yield "| file | size | points read | CPU s | peak MB |"
    yield f"|{'---|' * 5}"
    for title, (name, _, share) in ROWS.items():
        if not all(word in title for word in words):
            continue
        with tempfile.TemporaryDirectory() as folder, worktree(old) if old else nullcontext() as tree:
            path, count = Path(folder) / name, int(millions * share * _MILLION)
            # A process starts with the peak of the one that forked it, so that this one stays small.
            writer = get_context("spawn").Process(target=_write, args=(title, path, count))
            writer.start()
            writer.join()
            was = _measured(tree, path) if tree else None
            now = _measured(ROOT, path)
            costs = [_cell(now[key], was and was[key]) for key in ("seconds", "mb")]
            size = f"{path.stat().st_size / 2**20:.0f} MiB"
            yield f"| {title}, {count / _MILLION:g} million | {size} | {now['points']:,} | {' | '.join(costs)} |"


def _cell(now: float, was: float | None) -> str:
    return f"{now:,.1f}" if was is None else f"{was:,.1f} → {now:,.1f}, × {now / was:.2f}"


def main(arguments: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench large_files", description=__doc__)
    parser.add_argument("words", nargs="*", help=f"only rows that contain all of these words; all: {'; '.join(ROWS)}")
    parser.add_argument("--millions", type=float, default=20.0, help="points of the largest files")
    parser.add_argument("--old", metavar="COMMIT", default="", help="a commit to compare with")
    options = parser.parse_args(arguments)
    for line in _lines(options.millions, options.old, options.words):
        print(line, flush=True)


if __name__ == "__main__":
    print(json.dumps(one(Path(sys.argv[1]))))
