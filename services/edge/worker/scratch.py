"""The worker's scratch: one folder per upload or job, gone with it; what a crash left goes with the next start."""

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

from services.edge.checkpoints import Checkpoints
from services.edge.requests import RefusedError

_log = logging.getLogger(__name__)

_LOCK = ".lock"

HEADROOM = 3
"""Free bytes wanted per byte of archive: the archive, its contents (phones' images barely deflate), and the bundle."""


class Scratch:
    """Folders under a root that several workers may share: each keeps to a part of its own and holds its lock.

    Checkpoints belong to the jobs instead, so that any of the workers may go on with what another began.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._own = root
        self.checkpoints = Checkpoints(root / "checkpoints")

    @contextmanager
    def held(self) -> Iterator[None]:
        """Own a part of the root for the life of the worker; the parts of workers that died are removed first."""
        self._root.mkdir(parents=True, exist_ok=True, mode=0o700)
        # Under the root's lock, so that nobody takes a part for stale between its creation and its locking.
        with ExitStack() as held:
            with _lock(self._root):
                self._remove_stale()
                self._own = Path(tempfile.mkdtemp(dir=self._root, prefix="worker-"))
                held.enter_context(_lock(self._own))
            held.callback(self.drop, self._own)
            yield

    def folder(self, capture_bytes: int) -> Path:
        """A new empty folder for a capture of that size. Raises RefusedError where the disk cannot take it."""
        with writing():
            free = shutil.disk_usage(self._own).free
            if free < HEADROOM * capture_bytes:
                raise _full(f"{free:,} bytes are free, {HEADROOM * capture_bytes:,} wanted")
            return Path(tempfile.mkdtemp(dir=self._own, prefix="job-"))

    def drop(self, folder: Path) -> None:
        """Remove a folder, even one that a stopped thread still writes to: what stays goes with the worker."""
        shutil.rmtree(folder, ignore_errors=True)

    def _remove_stale(self) -> None:
        for part in self._root.glob("worker-*"):
            try:
                with _lock(part, wait=False):
                    shutil.rmtree(part, ignore_errors=True)
            except BlockingIOError:
                continue


@contextmanager
def writing() -> Iterator[None]:
    """Around writes on behalf of a caller: a failing disk is RefusedError (RESOURCE_EXHAUSTED), for another may do."""
    try:
        yield
    except OSError as error:
        _log.error("the scratch cannot be written to", exc_info=error)
        raise _full("the worker's disk takes no more") from None


def _full(message: str) -> RefusedError:
    return RefusedError(grpc.StatusCode.RESOURCE_EXHAUSTED, "SCRATCH_FULL", message)


@contextmanager
def _lock(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold a folder's lock, which the kernel drops with the process, even a killed one. BlockingIOError when taken."""
    descriptor = os.open(folder / _LOCK, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield
    finally:
        os.close(descriptor)
