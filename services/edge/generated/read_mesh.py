"""Read a generator's GLB in a child process with limits, by the reader of uploaded meshes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Tick
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.generated.server import failed
from capture2vr.process.child_start import python_command
from capture2vr.sentences.documents import with_sentences
from capture2vr.sentences.sentence import say

POSITIONS, COLOURS, FAILURE = "xyz.npy", "rgb.npy", "failure.json"
"""Files that the child writes: (N,3) float64; (N,3) uint8 sRGB if the mesh has colours; why it cannot be read."""
_CHILD_BYTES = 4 << 30  # of address space, of which the libraries take 1 GiB; three million triangles take under 3
_CHILD_SECONDS = 120.0


def read_generated(glb: Path, folder: Path, tick: Tick) -> Capture:
    """Read points on the surface of a GLB, in its frame: Y up. folder: for the child's files

    Raises EdgeError GENERATOR_FAILED for what is no mesh, or costs too much, and what `tick` raises.
    """
    module = "capture2vr.edge.generated.mesh_child"
    command = python_command("-m", module, str(glb.resolve()), str(folder), str(_CHILD_BYTES))
    try:
        run_child(command, "the reader of meshes", folder / "log", tick, most_seconds=_CHILD_SECONDS)
    except ChildError:
        raise failed(say("generator_mesh_costly")) from None
    if (folder / FAILURE).exists():
        why = with_sentences(json.loads((folder / FAILURE).read_text()))["why"]
        raise failed(say("generator_mesh_unreadable", why=why))
    colours = folder / COLOURS
    cloud = Cloud(np.load(folder / POSITIONS), np.load(colours) if colours.exists() else None)
    return Capture("points", "glb", cloud=cloud, scale_confidence="metric", up=np.array([0.0, 1.0, 0.0]))
