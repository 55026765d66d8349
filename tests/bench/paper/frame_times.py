"""The paper's Figure 8: milliseconds a frame of every level of detail, in a browser: `python -m tests.bench figure8`.

Headless Chromium draws in software on this machine's cores, so its milliseconds tell how the cost grows with triangles,
not what a headset takes. The estimate for Quest 3 is no measurement: Meta's guide for worlds names a million vertices a
frame at 72 Hz as the most; frames a second are taken to fall in proportion beyond that, and never to exceed 90.
"""

from __future__ import annotations

import argparse
import functools
import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.simplify import lods
from tests.bench.data_files import PICTURES
from tests.bench.delivery import LOADERS, MESHES, loaders
from tests.bench.paper.paper_figures import product_mesh
from tests.bench.published import SCENE, add_state
from tests.support.chromium import launch

QUEST_VERTICES, QUEST_HZ, QUEST_BUDGET_HZ = 1_000_000, 90.0, 72.0
"""Most vertices a frame at 72 Hz (Meta, Horizon Worlds: introduction to performance optimization), and the rate."""
PRINTED = 408_950, 58.5
"""Triangles and frames a second that the paper estimates for its own mesh; 58.0 to 58.3 for the others'."""
_FRAMES = 24
_PATIENCE_MS = 300_000


@dataclass(frozen=True, slots=True)
class Drawn:
    """A mesh that was drawn: its name, counts, and the median milliseconds a frame."""

    name: str
    vertices: int
    triangles: int
    frame_ms: float


def quest_fps(vertices: int) -> float:
    """Estimated frames a second on Quest 3 of a scene with so many vertices, both eyes drawn in one pass."""
    return min(QUEST_HZ, QUEST_BUDGET_HZ * QUEST_VERTICES / max(vertices, 1))


def main(arguments: list[str]) -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench figure8", description=__doc__)
    add_state(parser)
    parser.add_argument("--picture", type=Path, default=PICTURES / "figure8.png", help="where the picture goes")
    options = parser.parse_args(arguments)
    print("| mesh | vertices | triangles | ms a frame, Chromium in software | Quest 3, estimated frames a second |")
    print("|---|---|---|---|---|")
    drawn = []
    for each in measured(list(meshes(options.state))):
        print(
            f"| {each.name} | {each.vertices:,} | {each.triangles:,} | {each.frame_ms:.1f} "
            f"| {quest_fps(each.vertices):.0f} |",
            flush=True,
        )
        drawn.append(each)
    _draw(drawn, options.picture)
    print(f"\ndrawn: {options.picture.name}")


def meshes(state: Path) -> Iterator[tuple[str, Mesh]]:
    """The bench's meshes as they are, and their levels of detail."""
    known = {**{name: make() for name, make in MESHES.items()}, "lounge": product_mesh(SCENE, state)}
    for name, mesh in known.items():
        yield f"{name}, as extracted" if name == "lounge" else name, mesh
        for level, each in enumerate(lods(mesh)):
            yield f"{name}, LOD {level}", each


def measured(named: list[tuple[str, Mesh]]) -> Iterator[Drawn]:
    """Draw each mesh in a page, turning it, and wait for every frame's pixels."""
    with tempfile.TemporaryDirectory() as scratch, _site(Path(scratch)) as address, sync_playwright() as playwright:
        chromium = launch(playwright)
        page = chromium.new_page(viewport={"width": 1280, "height": 800})
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(f"{address}/frames.html")
        page.wait_for_function("() => window.measure")
        for name, mesh in named:
            (Path(scratch) / "mesh.glb").write_bytes(to_glb(mesh, "meshopt"))
            told: dict[str, Any] = page.evaluate("([file, times]) => measure(file, times)", ["mesh.glb", _FRAMES])
            yield Drawn(name, told["vertices"], told["triangles"], told["ms"])
        chromium.close()


@contextmanager
def _site(folder: Path) -> Iterator[str]:
    """A web site on loopback with the page and three.js."""
    shutil.copy(LOADERS / "frames.html", folder)
    (folder / "three").symlink_to(loaders() / "node_modules" / "three")
    handler = functools.partial(_Quiet, directory=str(folder))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


class _Quiet(SimpleHTTPRequestHandler):
    """Serves files without a line for each."""

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name is the library's
        pass


def _draw(drawn: list[Drawn], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    scenes = list(dict.fromkeys(each.name.split(",")[0] for each in drawn))
    for scene in scenes:
        found = sorted((each for each in drawn if each.name.split(",")[0] == scene), key=lambda each: each.triangles)
        triangles = [each.triangles for each in found]
        left.plot(triangles, [each.frame_ms for each in found], marker="o", label=scene)
        right.plot(triangles, [quest_fps(each.vertices) for each in found], marker="o", label=scene)
    left.set(xscale="log", yscale="log", xlabel="triangles", ylabel="ms a frame")
    left.set_title("Measured: headless Chromium, drawn in software", fontsize=10)
    right.set(xscale="log", xlabel="triangles", ylabel="frames a second", ylim=(0, 1.15 * QUEST_HZ))
    right.set_title("Estimated: Quest 3, from Meta's vertex budget", fontsize=10)
    right.scatter(*PRINTED, marker="x", color="black", label="the paper's estimate")
    for axis in (left, right):
        axis.legend(fontsize=8)
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=100)
    plt.close(figure)
