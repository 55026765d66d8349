"""Costs of textures, level by level: seconds and CPU seconds of unwrapping, baking and encoding; held-out likeness.

Preset `draft`, on the CPU. Each row in a process of its own. With `--old COMMIT` the same is measured in a worktree of
that commit just before it, and the ratio of CPU seconds is shown: other work on the machine changes them little. Levels
are textured one after another, not at the same time as in the product, so that each one's CPU seconds are known.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from capture2vr.cli.demonstration.demo_garment import garment_scene
from capture2vr.cli.demonstration.demo_phone import simulate_capture
from capture2vr.edge.asset import assemble
from capture2vr.edge.mesh.nouns import TexturedMesh
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import Preset, load_preset
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.texture import texture_mesh
from capture2vr.storage.bundle import Bundle
from tests.bench.data_files import data_file

ROOT = Path(__file__).parents[2]
STAGES = ("unwrap", "bake", "encode")
_ONE_IN = 8  # pictures is held out


def _garment(folder: Path) -> Path:
    simulate_capture(garment_scene(), folder / "walk")
    return folder / "walk"


ROWS: dict[str, Callable[[Path], Path]] = {
    "garment, RGB-D, 40 frames": _garment,
    "living room, RGB-D, 5 frames": lambda _: data_file("rgbd_livingroom"),
    "fruit, 20 photos": lambda _: data_file("photos_fruit/images"),
}


def cpu_seconds() -> float:
    """CPU seconds of this process and of its children that have ended: unwrapping is done in one."""
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in spent)


class StageTimes:
    """Measures the stages of a reconstruction by wrapping the functions that textures are made by.

    levels  by level of detail, finest first: by stage its seconds and CPU seconds
    """

    def __init__(self) -> None:
        self.levels: list[dict[str, list[float]]] = []
        self._packed = 0

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Wrap the functions until the end of the block."""
        wrapped = [
            (texture_mesh, "needs_texture", self._begin_level),
            (texture_mesh, "unwrap", self._timed("unwrap")),
            (texture_mesh, "bake", self._timed("bake")),
            (texture_mesh, "jpeg_of", self._timed("encode")),
            (assemble, "pack_glb", self._pack),
        ]
        if hasattr(texture_mesh, "in_threads"):  # of commits that texture all levels at the same time
            wrapped.append((texture_mesh, "in_threads", lambda _: _one_after_another))
        before = [(module, name, getattr(module, name)) for module, name, _ in wrapped]
        try:
            for (module, name, wrap), (*_, function) in zip(wrapped, before, strict=True):
                setattr(module, name, wrap(function))
            yield
        finally:
            for module, name, function in before:
                setattr(module, name, function)

    def _begin_level(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def begin(*args: Any, **options: Any) -> Any:
            self.levels.append({stage: [0.0, 0.0] for stage in STAGES})
            return function(*args, **options)

        return begin

    def _timed(self, stage: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        return lambda function: lambda *args, **options: self._run(-1, stage, lambda: function(*args, **options))

    def _pack(self, function: Callable[..., bytes]) -> Callable[..., bytes]:
        def pack(asset: Any, *args: Any) -> bytes:
            if not isinstance(asset, TexturedMesh):  # of the bundle without textures
                return function(asset, *args)
            self._packed += 1
            return self._run(self._packed - 1, "encode", lambda: function(asset, *args))

        return pack

    def _run(self, level: int, stage: str, work: Callable[[], Any]) -> Any:
        began, spent = time.perf_counter(), cpu_seconds()
        result = work()
        figures = self.levels[level][stage]
        figures[0] += time.perf_counter() - began
        figures[1] += cpu_seconds() - spent
        return result


def _one_after_another(work: Callable[[Any], Any], parts: Sequence[Any]) -> list[Any]:
    """Stand in for threads: CPU seconds are told of the process, not of a thread."""
    return [work(part) for part in parts]


def one(source: Path, preset: Preset | None = None) -> dict[str, Any]:
    """Reconstruct a capture in this process: times of its levels, likeness, CPU seconds up to each bundle."""
    capture, times, spent = read_capture(source), StageTimes(), cpu_seconds()
    count = -(-max(len(capture.frames), len(capture.photos)) // _ONE_IN)
    until = []
    with times.watch():
        for step in reconstruct(capture, preset or load_preset("draft"), hold_out=count):
            if isinstance(step, Bundle):
                until.append(cpu_seconds() - spent)
                bundle = step
    photos = bundle.manifest["quality"].get("photos") or {}
    return {"levels": times.levels, "until": until, **{key: photos.get(key) for key in ("psnr", "sharp")}}


@contextmanager
def worktree(commit: str, root: Path = ROOT) -> Iterator[Path]:
    """Check out a commit of the repository at `root` in a folder that is removed at the end of the block."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        subprocess.run(["git", "-C", root, "worktree", "add", "-q", "--detach", tree, commit], check=True)
        try:
            yield tree
        finally:
            subprocess.run(["git", "-C", root, "worktree", "remove", "--force", tree], check=True)


def measured(tree: Path, source: Path) -> dict[str, Any]:
    """`one` in a process that imports the services of a tree. Raises CalledProcessError where it fails."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, str(Path(__file__).resolve()), str(source)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=tree, env=environment)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def lines_of(name: str, new: Mapping[str, Any], old: Mapping[str, Any] | None = None) -> list[str]:
    """Lines of the table for a capture: its levels, then its bundles; with the ratio of CPU seconds where there is an
    old one."""
    before = old or new
    lines = []
    for level, figures in enumerate(new["levels"]):
        cells = [_seconds(*figures[stage], _cpu_of(before, level, stage) if old else None) for stage in STAGES]
        lines.append(f"| {name}, LOD {level} | {' | '.join(cells)} | | |")
    likeness = [
        " → ".join("" if each[key] is None else f"{each[key]:.2f}" for each in ([old, new] if old else [new]))
        for key in ("psnr", "sharp")
    ]
    # The last bundles are compared; those before them only where both commits publish as many.
    ratios = [f", × {each / was:.2f}" for each, was in zip(new["until"], before["until"], strict=False)]
    ratios = ratios if len(ratios) == len(new["until"]) else [f", × {new['until'][-1] / before['until'][-1]:.2f}"]
    ratios = [""] * (len(new["until"]) - len(ratios)) + ratios if old else [""] * len(new["until"])
    spent = [f"{each:.1f}{ratio}" for each, ratio in zip(new["until"], ratios, strict=True)]
    return [*lines, f"| {name}, CPU s to each bundle: {'; '.join(spent)} | | | | {' | '.join(likeness)} |"]


def _cpu_of(figures: Mapping[str, Any], level: int, stage: str) -> float:
    return float(figures["levels"][level][stage][1]) if level < len(figures["levels"]) else 0.0


def _seconds(seconds: float, cpu: float, before: float | None) -> str:
    return f"{seconds:.2f} ({cpu:.2f})" + (f", × {cpu / before:.2f}" if before else "")


def main(arguments: Sequence[str]) -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench texture", description=__doc__)
    parser.add_argument("words", nargs="*", help=f"only rows that contain all of these words; all: {'; '.join(ROWS)}")
    parser.add_argument("--old", metavar="COMMIT", help="a commit to compare with")
    options = parser.parse_args(arguments)
    print("| capture | unwrapping s (CPU s) | baking s (CPU s) | encoding s (CPU s) | held-out PSNR | sharpness |")
    print(f"|{'---|' * 6}")
    for name in (name for name in ROWS if all(word in name for word in options.words)):
        with tempfile.TemporaryDirectory() as folder:
            source = ROWS[name](Path(folder)).resolve()
            old = None
            if options.old:
                with worktree(options.old) as tree:
                    old = measured(tree, source)
            print("\n".join(lines_of(name, measured(ROOT, source), old)), flush=True)


if __name__ == "__main__":
    print(json.dumps(one(Path(sys.argv[1]))))
