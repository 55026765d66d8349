"""A file that holds some space of the data folder's disk, and is given up when the disk is full.

SQLite opens its write-ahead log and deletes rows only where it can write, so that without the reserve a gateway on a
full disk would not start, and nobody could delete what fills it.
"""

from __future__ import annotations

import asyncio
import logging
import os
import shutil
from contextlib import suppress
from pathlib import Path

RESERVE_BYTES = 16 << 20
"""A write-ahead log before its checkpoint has 4 MB, a catalogue that is written anew a few."""
_FULL_BYTES = RESERVE_BYTES // 4  # of free space, below which the reserve is given up
_SPARE_BYTES = 64 << 20  # that stay free besides, where the reserve is taken again
_EVERY_S = 60.0

_log = logging.getLogger(__name__)


class DiskReserve:
    """The reserve of one data folder. Nothing of it raises: where there is no space for it, there is none."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._path = folder / "gateway.reserve"

    def give_up_if_full(self) -> None:
        """Delete the reserve where the disk is full, so that rows can be deleted."""
        with suppress(OSError):
            if self._free() < _FULL_BYTES and self._path.exists():
                self._path.unlink()
                _log.warning("the disk of %s is full: gave up the reserve of %d MB", self._folder, RESERVE_BYTES >> 20)

    def hold(self) -> None:
        """Take the reserve, unless it is there, or little would be left."""
        with suppress(OSError):
            if self._path.exists() or self._free() < RESERVE_BYTES + _SPARE_BYTES:
                return
            try:
                with self._path.open("wb") as file:
                    os.posix_fallocate(file.fileno(), 0, RESERVE_BYTES)
            except OSError:
                self._path.unlink(missing_ok=True)

    async def keep(self) -> None:
        """Give the reserve up, or take it again, as the disk fills and is emptied, until cancelled."""
        while True:
            await asyncio.to_thread(self._adapt)
            await asyncio.sleep(_EVERY_S)

    def _adapt(self) -> None:
        self.give_up_if_full()
        self.hold()

    def _free(self) -> int:
        return shutil.disk_usage(self._folder).free
