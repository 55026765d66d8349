"""Scratch folder of a worker: one folder per upload or job, removed at its end, or at the next start after a crash."""

from __future__ import annotations

import fcntl
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import grpc

from capture2vr.edge.worker.checkpoint_files import CheckpointFiles
from capture2vr.edge.worker.job_request import RefusedError
from capture2vr.process.private_files import private_folder

_log = logging.getLogger(__name__)

_LOCK = ".lock"

HEADROOM = 3
"""Free bytes needed per byte of archive: the archive, its contents (phones' images barely deflate), and the bundle."""


class Scratch:
    """Scratch folders under a root that several workers may share: each locks a part of its own.

    Checkpoints are shared, so that any worker can resume a job that another one began.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._own = root
        self.checkpoints = CheckpointFiles(root / "checkpoints")

    @contextmanager
    def claim(self) -> Iterator[None]:
        """Create and lock this worker's part of the root for the block, and remove the parts of workers that died."""
        private_folder(self._root)
        # Under the root's lock: another worker could take the part for stale between its creation and its locking.
        with ExitStack() as claimed:
            with _lock(self._root):
                self._remove_stale()
                self._own = Path(tempfile.mkdtemp(dir=self._root, prefix="worker-"))
                claimed.enter_context(_lock(self._own))
            claimed.callback(self.drop, self._own)
            yield

    @contextmanager
    def with_temporary_files(self) -> Iterator[None]:
        """Let this process and its children keep their temporary files in this worker's part, during the block.

        /tmp may be in memory, as in containers; and what a killed worker leaves is removed with its part.
        """
        before = tempfile.tempdir, os.environ.get("TMPDIR")
        tempfile.tempdir = os.environ["TMPDIR"] = str(self._own)
        try:
            yield
        finally:
            tempfile.tempdir = before[0]
            if before[1] is None:
                del os.environ["TMPDIR"]
            else:
                os.environ["TMPDIR"] = before[1]

    def folder(self, capture_bytes: int) -> Path:
        """Create an empty folder for a capture of that size. Raises RefusedError where the disk has too little room."""
        with translate_disk_errors():
            free = shutil.disk_usage(self._own).free
            if free < HEADROOM * capture_bytes:
                raise _scratch_full(
                    f"the worker's disk has {free:,} bytes free, {HEADROOM * capture_bytes:,} are needed"
                )
            return Path(tempfile.mkdtemp(dir=self._own, prefix="job-"))

    def drop(self, folder: Path) -> None:
        """Remove a folder. Files that a stopped thread still writes there are removed when the worker ends."""
        shutil.rmtree(folder, ignore_errors=True)

    def _remove_stale(self) -> None:
        """Remove the parts that no living worker has locked."""
        for part in self._root.glob("worker-*"):
            try:
                with _lock(part, wait=False):
                    shutil.rmtree(part, ignore_errors=True)
            except BlockingIOError:
                continue


@contextmanager
def translate_disk_errors() -> Iterator[None]:
    """Turn an OSError of the block into RefusedError RESOURCE_EXHAUSTED: another worker's disk may have room."""
    try:
        yield
    except OSError as error:
        _log.error("the scratch folder cannot be written to", exc_info=error)
        raise _scratch_full("the worker cannot write to its disk") from None


def _scratch_full(message: str) -> RefusedError:
    return RefusedError(grpc.StatusCode.RESOURCE_EXHAUSTED, "SCRATCH_FULL", message)


@contextmanager
def _lock(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """Lock a folder for the block; the kernel releases the lock when the process ends, even if it is killed.

    wait  whether to wait for the lock; otherwise raises BlockingIOError when it is taken
    """
    descriptor = os.open(folder / _LOCK, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield
    finally:
        os.close(descriptor)
