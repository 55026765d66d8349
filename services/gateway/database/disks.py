"""Disks that a gateway writes to, and the space on them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store


@dataclass(frozen=True, slots=True)
class Disk:
    """A disk of a gateway. holds: what lies on it: database and staging, or the objects of a local store"""

    holds: str
    free_bytes: int
    total_bytes: int


def disks_of(data_dir: Path, store: Store) -> list[Disk]:
    """Return the disks of the data folder and of a local store, where that is another one. Raises OSError."""
    folders = {"database and staging": data_dir}
    if isinstance(store, LocalStore) and store.root.stat().st_dev != data_dir.stat().st_dev:
        folders["objects"] = store.root
    elif isinstance(store, LocalStore):
        folders = {"database, staging and objects": data_dir}
    usage = {holds: shutil.disk_usage(folder) for holds, folder in folders.items()}
    return [Disk(holds, found.free, found.total) for holds, found in usage.items()]
