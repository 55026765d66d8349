"""Who this gateway is: a name that survives restarts, and a lock that keeps a second one out of the same folder."""

from __future__ import annotations

import fcntl
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class FolderInUse(Exception):  # noqa: N818 - it reads as what it is
    """Another gateway works in this data folder."""


@contextmanager
def instance(data_dir: Path) -> Iterator[str]:
    """This gateway's name, while nobody else has it. The lock ends with the process, however that ends.

    Raises FolderInUse.
    """
    data_dir.mkdir(parents=True, exist_ok=True)
    with (data_dir / "gateway.lock").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FolderInUse(f"another gateway works in {data_dir}: stop it, or set GATEWAY_DATA_DIR") from None
        yield _name(data_dir / "gateway.id")


def _name(path: Path) -> str:
    if not path.exists():
        fresh = path.with_suffix(".new")
        fresh.write_text(f"gw_{uuid.uuid4().hex}")
        fresh.replace(path)  # a crash leaves no half a name
    return path.read_text().strip()
