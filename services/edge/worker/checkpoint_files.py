"""Checkpoint files of fits, in the scratch folder that several workers share; they survive the death of a worker.

One folder per job, one file per lease of the job, or a folder where a scene is made by tiles. The lease with a newer
fence takes the newest of each over by renaming it, so that a worker that has lost its lease, and does not know it yet,
writes to another name.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

KEEP_S = 24 * 3600.0
"""Seconds that a job's folder is kept after its last checkpoint: a worker that was down overnight can still resume."""

_SUFFIX = ".checkpoint"
_TILES = ".tiles"  # suffix of a folder


class CheckpointFiles:
    """Checkpoint files under `root`, named by job and fence. job_request.py has checked that a job's name is plain."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def take(self, job: str, fence: int) -> Path:
        """Take over the job's checkpoint file for this lease; it exists if an earlier lease left a checkpoint."""
        self._prune()
        folder = self._root / job
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        own = folder / f"{fence}{_SUFFIX}"
        for suffix in (_SUFFIX, _TILES):
            older = sorted((each, path) for each, path in _files(folder) if each < fence and path.suffix == suffix)
            if older and not own.with_suffix(suffix).exists():
                # Its writer may still be alive. It writes atomically by renaming, so this file stays complete, and the
                # writer's next checkpoint gets the old name; files of tiles it can write no more.
                with suppress(FileNotFoundError):
                    older[-1][1].replace(own.with_suffix(suffix))
        return own

    def exists(self, job: str, fence: int) -> bool:
        """Whether this lease of the job has written a checkpoint, or taken one over."""
        own = self._root / job / f"{fence}{_SUFFIX}"
        return own.exists() or own.with_suffix(_TILES).exists()

    def drop(self, job: str, fence: int) -> None:
        """Remove the files of the job's leases up to this one; those of a newer lease stay."""
        folder = self._root / job
        for each, path in _files(folder):
            if each <= fence and path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif each <= fence:
                path.unlink(missing_ok=True)
        with suppress(OSError):  # not empty: a newer lease's file is in it
            folder.rmdir()

    def _prune(self) -> None:
        """Remove the folders that are older than KEEP_S by their mtime, which every file renamed in updates."""
        for folder in self._root.glob("*"):
            with suppress(FileNotFoundError):
                if time.time() - max(each.stat().st_mtime for each in (folder, *folder.glob(f"*{_TILES}/*"))) > KEEP_S:
                    shutil.rmtree(folder, ignore_errors=True)


def _files(folder: Path) -> Iterator[tuple[int, Path]]:
    """(fence, file) of every file in a job's folder: checkpoints, saved points, and partial files that a kill left."""
    for path in folder.glob("*"):
        fence = path.name.partition(".")[0]
        if fence.isdecimal():
            yield int(fence), path
