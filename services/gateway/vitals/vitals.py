"""Checks every few seconds what the gateway depends on, for its metrics and its log: a scrape waits for none of it."""

from __future__ import annotations

import asyncio
import logging

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.database.disks import disks_of
from capture2vr.gateway.gateway import Gateway
from capture2vr.gateway.schemas import Check
from capture2vr.gateway.vitals.checks import timed_checks

_EVERY_S = 15.0  # as often as Prometheus asks

_log = logging.getLogger(__name__)


class Vitals:
    """Keeps the gateway's gauges of checks, disks, workers and copies up to date, and logs what is no longer ready."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._gauges = gateway.metrics.vitals
        self._failing: set[str] = set()

    async def run(self) -> None:
        """Look again and again, until cancelled."""
        while True:
            try:
                await self.look()
            except (OSError, SQLAlchemyError) as error:
                _log.warning("disks or backups could not be looked at: %s", error)
            await asyncio.sleep(_EVERY_S)

    async def look(self) -> None:
        """Look once. Raises OSError, SQLAlchemyError for what no check has told."""
        gateway = self._gateway
        found = await timed_checks(gateway)
        self._gauges.show_checks({name: (check.ok, seconds) for name, (check, seconds) in found.items()})
        for name, (check, _) in found.items():
            self._log_change(name, check)
        workers = gateway.workers
        answering = [address for address in workers.addresses if workers.last_status(address) is not None]
        self._gauges.show_workers(len(workers.addresses), len(answering))
        self._gauges.show_disks(await asyncio.to_thread(disks_of, gateway.settings.data_dir, gateway.store))
        if found["database"][0].ok:
            await self._look_at_copies()

    async def _look_at_copies(self) -> None:
        snapshots = self._gateway.upkeep.snapshots
        backups = await asyncio.to_thread(self._gateway.upkeep.backups.times)
        self._gauges.show_copy("backup", backups.made or 0.0)
        self._gauges.show_copy("drill", backups.proven or 0.0)
        if snapshots.are_taken:
            self._gauges.show_copy("snapshot", snapshots.newest or 0.0)

    def _log_change(self, name: str, check: Check) -> None:
        """Log the first failure of a check, and that it is passed again; probes are not logged."""
        if not check.ok and name not in self._failing:
            self._failing.add(name)
            _log.warning("not ready: %s: %s", name, check.detail)
        elif check.ok and name in self._failing:
            self._failing.discard(name)
            _log.info("ready again: %s: %s", name, check.detail)
