"""Child process that unwraps one mesh with xatlas: `python unwrap_child.py FOLDER`. It imports no other module of ours.

xatlas runs in a child process, because its native code cannot be interrupted, and may crash over an unusual mesh.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
from pathlib import Path

import numpy as np
import xatlas

_PR_SET_PDEATHSIG = 1  # of Linux's prctl(2)
_MOST_BYTES = 4 << 30  # of address space, without that of threads: 50,000 triangles take 250 MB
_THREAD_BYTES = 80 << 20  # that a thread reserves for its stack and its heap; there is one for each processor
# Larger charts than with the default of 2: a chart then ends where it bends too far; they are a tenth fewer.
_MAX_COST = 8.0


def main(folder: Path) -> None:
    """Read problem.npz from the folder, unwrap its mesh, write answer.npz. A failure ends in a non-zero exit status
    with the reason on stderr."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    most_bytes = _MOST_BYTES + _THREAD_BYTES * (os.cpu_count() or 1)
    resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))
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
    # The destructor of xatlas joins its threads, and a wake-up that one of them misses would keep it waiting for ever.
    os._exit(0)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
