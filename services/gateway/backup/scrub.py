"""Scrub the store: read every file of every asset, and compare its hash with the one in its name.

A file that the disk cannot read is damaged too. Serving notices a file that was changed since it was written; only
reading notices what a disk has lost without a trace.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import json
import logging
import re
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from capture2vr.process.atomic_write import atomic_write
from capture2vr.storage.bundle import hash_in_name
from capture2vr.storage.store import Head, Store

_LOOK_S = 3600.0  # between two looks whether a scrub is due
_DAY_S = 86_400.0
_PAGE = 250  # objects after which the progress is written down; to list them takes some 20 ms
_READ_BYTES = 4 << 20
_READS_A_SECOND = 5  # in the background: 20 MB a second, so that nobody notices
_FILES = re.compile(r"(tenants/[^/]+/)?assets/")
_MOST_NAMED = 1_000  # damaged files whose names are kept

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class ScrubState:
    """How far a scrub is, written down after every page, so that a restart goes on.

    after    name of the last object that was checked, "" between two scrubs
    ended    seconds since the epoch of the last scrub's end, 0 for none
    checked  number of files of this scrub, or of the last
    damaged  names of those that are not what was published, or that the disk cannot read
    """

    after: str = ""
    ended: float = 0.0
    checked: int = 0
    damaged: list[str] = field(default_factory=list)


class Scrub:
    """Scrubs the store in the background, a whole round every so many days."""

    def __init__(self, store: Store, progress: Path, every_days: float) -> None:
        """progress: file of the progress; every_days: 0 for never"""
        self._store = store
        self._progress = progress
        self._every_s = every_days * _DAY_S
        self.state = _read(progress)

    async def run(self) -> None:
        """Scrub whenever it is due; goes on until it is cancelled."""
        while self._every_s:
            if self.state.after or time.time() - self.state.ended >= self._every_s:
                await self._round()
            await asyncio.sleep(_LOOK_S)

    async def _round(self) -> None:
        try:
            steps = self.steps()
            while await asyncio.to_thread(next, steps, None) is not None:
                await asyncio.sleep(1 / _READS_A_SECOND)
        except OSError as error:
            _log.warning("the store could not be scrubbed to the end: %s", error)

    def steps(self) -> Iterator[str]:
        """Continue a scrub, one read or one page of names at a time; yield after each step.

        Raises OSError where the store fails; the steps of another call then go on with the file that was not checked.
        """
        state = self.state
        if not state.after:
            state.checked, state.damaged = 0, []
        while heads := self._store.list("", after=state.after, limit=_PAGE):
            for head in heads:
                yield from self._check(head)
                state.after = head.name  # only now: a round that an error ends goes on with the file that it met
            self._write()
            yield state.after
        state.after, state.ended = "", time.time()
        self._write()

    def _check(self, head: Head) -> Iterator[str]:
        named = hash_in_name(head.name)
        if named is None or not _FILES.match(head.name):
            return
        digest, start = hashlib.sha256(), 0
        try:
            while block := self._store.get(head.name, start=start, length=_READ_BYTES):
                digest.update(block)
                start += len(block)
                yield head.name
        except FileNotFoundError:
            return  # deleted since it was listed
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            fault = f"the disk cannot read it from byte {start:,} on"
        else:
            fault = "" if digest.hexdigest() == named else f"its {start} bytes do not have the hash in its name"
        self.state.checked += 1
        if fault and len(self.state.damaged) < _MOST_NAMED:
            _log.error("%s is damaged: %s", head.name, fault)
            self.state.damaged.append(head.name)

    def _write(self) -> None:
        with atomic_write(self._progress, durable=False) as fresh:  # without it a round begins anew
            fresh.write_text(json.dumps(asdict(self.state)))


def _read(progress: Path) -> ScrubState:
    try:
        return ScrubState(**json.loads(progress.read_text()))
    except (FileNotFoundError, ValueError, TypeError):
        return ScrubState()  # begins anew
