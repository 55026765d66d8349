"""Where fits keep their checkpoints: beside the uploads of all workers that share a scratch, kept over their deaths.

One folder per job, one file per lease of it. Whoever runs the job under a newer fence takes the newest file over by
renaming it, so that a worker that was cut off, and does not know it yet, goes on writing to a name of its own.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

KEPT_S = 24 * 3600.0
"""Seconds after its last checkpoint that a job's folder stays: a worker that is down overnight finds its work again."""

_SUFFIX = ".checkpoint"


class Checkpoints:
    """Files under `root`, named by job and fence; a job has a plain name, which is checked on entry (requests.py)."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def take(self, job: str, fence: int) -> Path:
        """The file to write to under this lease; it exists where an earlier lease of the job left a checkpoint."""
        self._prune()
        folder = self._root / job
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        own = folder / f"{fence}{_SUFFIX}"
        older = sorted((each, path) for each, path in _files(folder) if each < fence and path.suffix == _SUFFIX)
        if older and not own.exists():
            # Its writer may be alive: it replaces files by renaming, so this one stays whole, and its next is its own.
            with suppress(FileNotFoundError):
                older[-1][1].replace(own)
        return own

    def drop(self, job: str, fence: int) -> None:
        """Remove what the job's leases up to this one wrote; a newer lease keeps what it has."""
        folder = self._root / job
        for each, path in _files(folder):
            if each <= fence:
                path.unlink(missing_ok=True)
        with suppress(OSError):  # a newer lease's file is in it
            folder.rmdir()

    def _prune(self) -> None:
        """Remove the folders in which nothing was written for long; a checkpoint is renamed in, which is writing."""
        for folder in self._root.glob("*"):
            with suppress(FileNotFoundError):
                if time.time() - folder.stat().st_mtime > KEPT_S:
                    shutil.rmtree(folder, ignore_errors=True)


def _files(folder: Path) -> Iterator[tuple[int, Path]]:
    """(fence, file) of every checkpoint in a job's folder, and of every half of one that a kill left."""
    for path in folder.glob("*"):
        fence = path.name.partition(".")[0]
        if fence.isdecimal():
            yield int(fence), path
