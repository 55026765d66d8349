"""A worker process with scripted work under the guard: `python -m tests.support.workers.guarded_worker FOLDER`.

FOLDER stands for the control group's: a test writes the kernel's counters there. With STORAGE_ROOT its jobs publish.
"""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path

from capture2vr.edge.worker.control_group import ControlGroup
from capture2vr.edge.worker.guard import run_guarded
from capture2vr.edge.worker.job_run import Work
from capture2vr.edge.worker.server import serve
from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.storage.local import LocalStore
from tests.support.workers.edge_client import Scripted
from tests.support.workers.scripted_work import Making


def children(pid: int) -> list[int]:
    """Process ids of a process's children."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def count_kills(folder: Path, count: int) -> None:
    """Write the counters of a control group of version 2, as the kernel does."""
    (folder / "memory.max").write_text("1073741824\n")
    (folder / "memory.events").write_text(f"low 0\nhigh 0\nmax 0\noom {count}\noom_kill {count}\n")


def _serve(out_of_memory: bool) -> int:
    root = os.environ.get("STORAGE_ROOT", "")
    work: Work = Making(LocalStore(Path(root))) if root else Scripted()
    return serve(EdgeSettings(), work, out_of_memory=out_of_memory)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(levelname)s %(message)s")
    sys.exit(run_guarded(_serve, ControlGroup((Path(sys.argv[1]),))))
