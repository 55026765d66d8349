"""The gateway's persistent id, and a lock file that keeps a second gateway out of the same data folder."""

from __future__ import annotations

import fcntl
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.atomic_write import atomic_write


class FolderInUse(Exception):  # noqa: N818 - it reads as what it is
    """Another gateway uses this data folder."""


@contextmanager
def lock_instance(data_dir: Path) -> Iterator[str]:
    """Lock the data folder and yield this gateway's id. The kernel releases the lock when the process ends.

    Raises FolderInUse.
    """
    data_dir.mkdir(parents=True, exist_ok=True)
    with (data_dir / "gateway.lock").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FolderInUse(f"another gateway uses {data_dir}: stop it, or set GATEWAY_DATA_DIR") from None
        yield _name(data_dir / "gateway.id")


def _name(path: Path) -> str:
    if not path.exists():
        with atomic_write(path) as fresh:
            fresh.write_text(f"gw_{uuid.uuid4().hex}")
    return path.read_text().strip()
