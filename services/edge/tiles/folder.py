"""Files of a scene that is meshed by tiles, in a folder of their own: what is finished survives a killed process.

scene.json           what the files were made from: other points or settings, and all of them are made anew
raw/2-0-1.bin        captured points of a tile, in the order in which they were read
points/2-0-1.npz     the same, thinned to one per cell
mesh/2-0-1.npz       mesh of the tile and a strip around it
welded/2-0-1.npz     its own faces, joined to those of its neighbours
level/0-2-0-1.*      the tile as it is delivered, and its coarser ancestors: .npz mesh, .glb, .json figures

Every file but `raw` is written to another name and renamed, so a file that is there is whole.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.process.atomic_write import atomic_write

RAW = np.dtype([("xyz", "<f4", (3,)), ("rgb", "u1", (3,))])
"""Record of a captured point: its place in cells from its tile's corner, and sRGB."""

SUFFIX = ".tiles"
"""Of the folder's name, beside the checkpoint file of its job."""

_SCENE, _FILLED = "scene.json", "raw.json"
_ROOMS = ("raw", "points", "mesh", "welded", "level")


def tiles_folder(checkpoint: Path) -> Path:
    """The folder of a job's tiles, beside its checkpoint file: it is taken over and removed with that."""
    return checkpoint.with_suffix(SUFFIX)


@dataclass(frozen=True, slots=True)
class SceneFolder:
    """The folder of one scene."""

    root: Path

    def begin(self, scene: Mapping[str, Any]) -> None:
        """Prepare the folder: keep the tiles that an earlier run finished of this scene, delete those of others."""
        path = self.root / _SCENE
        if not (path.exists() and json.loads(path.read_text()) == json.loads(json.dumps(scene))):
            shutil.rmtree(self.root, ignore_errors=True)
        for room in _ROOMS:
            (self.root / room).mkdir(parents=True, exist_ok=True, mode=0o700)
        with atomic_write(path, durable=False) as part:
            part.write_text(json.dumps(scene))

    def path(self, room: str, name: str, suffix: str = ".npz") -> Path:
        """Path of a file in one of the rooms."""
        return self.root / room / f"{name}{suffix}"

    @property
    def tiles(self) -> Mapping[str, int] | None:
        """The points of each tile by its name, once all are read; None before."""
        path = self.root / _FILLED
        counts: Mapping[str, int] | None = json.loads(path.read_text()) if path.exists() else None
        return counts

    def empty_raw(self) -> None:
        """Remove the captured points that a reading left which did not come to its end."""
        shutil.rmtree(self.root / "raw", ignore_errors=True)
        (self.root / "raw").mkdir(mode=0o700)

    def set_tiles(self, counts: Mapping[str, int]) -> None:
        """Record that all points are read, and how many each tile has."""
        with atomic_write(self.root / _FILLED, durable=False) as part:
            part.write_text(json.dumps(counts))

    def save_points(self, name: str, cells: Floats, rgb: Bytes) -> None:
        """Write a tile's thinned points: cells (N,3), rgb (N,3) or (0,3) where the capture has no colours."""
        self._save("points", name, cells=cells, rgb=rgb)

    def load_points(self, name: str) -> tuple[Floats, Bytes]:
        """Read a tile's thinned points: cells (N,3) and rgb."""
        with np.load(self.path("points", name)) as arrays:
            return arrays["cells"], arrays["rgb"]

    def save_mesh(self, room: str, name: str, mesh: Mesh) -> None:
        """Write a mesh; its vertices keep every bit."""
        rgb = np.empty((0, 3), np.uint8) if mesh.rgb is None else mesh.rgb
        self._save(room, name, vertices=mesh.vertices, faces=mesh.faces.astype(np.int32), rgb=rgb)

    def load_mesh(self, room: str, name: str) -> Mesh:
        """Read a mesh."""
        with np.load(self.path(room, name)) as arrays:
            rgb = arrays["rgb"]
            return Mesh(arrays["vertices"], arrays["faces"].astype(np.int64), rgb if len(rgb) else None)

    def _save(self, room: str, name: str, **arrays: Any) -> None:
        with atomic_write(self.path(room, name), durable=False) as part, part.open("wb") as stream:
            np.savez(stream, **arrays)
