"""The process that unwraps one mesh: `python unwrap_child.py FOLDER`, a program of its own that loads nothing of ours.

xatlas runs in a child, because its native code cannot be interrupted, and may end the process over a mesh it dislikes.
"""

from __future__ import annotations

import ctypes
import resource
import signal
import sys
from pathlib import Path

import numpy as np
import xatlas

_PR_SET_PDEATHSIG = 1  # of Linux's prctl(2)
_MOST_BYTES = 4 << 30  # of address space, most of it the threads' own: 50,000 triangles take 250 MB
# Larger charts than by default (2): where they end is decided by how far they bend, and there are a tenth fewer.
_MAX_COST = 8.0


def main(folder: Path) -> None:
    """Unwrap the problem in the folder; every failure is a non-zero exit with its reason on stderr."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))
    with np.load(folder / "problem.npz") as problem:
        arrays = {name: problem[name] for name in problem.files}
    atlas = xatlas.Atlas()
    parts = []
    for part in np.split(arrays["faces"][arrays["order"]], arrays["ends"][:-1]):
        used, local = np.unique(part, return_inverse=True)
        atlas.add_mesh(arrays["vertices"][used], local.reshape(-1, 3).astype(np.uint32))
        parts.append(used)
    chart, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    chart.max_cost = _MAX_COST
    pack.resolution, pack.padding = int(arrays["side"]), int(arrays["padding"])
    atlas.generate(chart, pack)
    was, faces, texel, start = [], [], [], 0
    for number, used in enumerate(parts):
        mapping, corners, uv = atlas.get_mesh(number)
        was.append(used[mapping])
        faces.append(corners.astype(np.int64) + start)
        texel.append(uv * np.array([atlas.width, atlas.height]))
        start += len(mapping)
    np.savez(
        folder / "answer.npz",
        was=np.concatenate(was),
        faces=np.concatenate(faces),
        texel=np.concatenate(texel),
        size=np.array([atlas.width, atlas.height]),
        charts=np.array(atlas.chart_count),
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
