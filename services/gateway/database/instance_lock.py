"""The gateway's persistent id, and a lock file that keeps a second gateway out of the same data folder.

Gateways that share a database server may share a data folder too, such as the volume of a scaled compose service: the
first works in the folder itself, each other one in a folder of its own within.
"""

from __future__ import annotations

import fcntl
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from capture2vr.process.atomic_write import atomic_write
from capture2vr.process.private_files import private_folder

_MOST_REPLICAS = 64  # with one data folder; more would rather be an endless restart


class FolderInUse(Exception):  # noqa: N818 - it reads as what it is
    """Another gateway uses this data folder."""


@dataclass(frozen=True, slots=True)
class Instance:
    """A running gateway: its id, which a restart keeps, and the folder that it works in."""

    id: str
    folder: Path


@contextmanager
def lock_replica(data_dir: Path) -> Iterator[Instance]:
    """Lock the data folder, or the first free one of its folders `replica-2`, `replica-3`, … Raises FolderInUse."""
    with ExitStack() as stack:
        for folder in (data_dir, *(data_dir / f"replica-{number}" for number in range(2, _MOST_REPLICAS + 1))):
            try:
                instance = stack.enter_context(lock_instance(folder))
            except FolderInUse:
                continue
            break
        else:
            raise FolderInUse(f"{_MOST_REPLICAS} gateways use {data_dir} and the folders in it: set GATEWAY_DATA_DIR")
        yield instance


@contextmanager
def lock_instance(data_dir: Path) -> Iterator[Instance]:
    """Lock the data folder and yield this gateway's instance. The kernel releases the lock when the process ends.

    Raises FolderInUse.
    """
    private_folder(data_dir)
    with (data_dir / "gateway.lock").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FolderInUse(f"another gateway uses {data_dir}: stop it, or set GATEWAY_DATA_DIR") from None
        yield Instance(_name(data_dir / "gateway.id"), data_dir)


def _name(path: Path) -> str:
    if not path.exists():
        with atomic_write(path) as fresh:
            fresh.write_text(f"gw_{uuid.uuid4().hex}")
    return path.read_text().strip()
