"""Atomic file write: write to a temporary file, sync it to the disk, then rename it over the old file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: Path, *, temporary: Path | None = None, durable: bool = True) -> Iterator[Path]:
    """Replace the file at `path` atomically: yield a temporary file to write, which is renamed when the block ends.

    temporary  path of the temporary file, on the same disk; None: `path` with .part behind it. Where several processes
               may write the same file at once, each needs a name of its own
    durable    whether the new file must survive a power cut: the file and its folder are then synced to the disk

    If the block raises, the file at `path` stays as it was and the temporary one is removed. If the process is killed,
    the temporary one stays. Raises OSError where the file cannot be written.
    """
    temporary = temporary or path.with_name(path.name + ".part")
    try:
        yield temporary
        if durable:
            sync(temporary)
        # A crash before this line leaves the old file; after it, the new one, once the folder is synced.
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    if durable:
        sync(path.parent)


def sync(path: Path) -> None:
    """Flush a file's bytes, or a folder's entries, to the disk and wait for it (fsync). Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
