"""Run a gateway: lock its data folder, open it, keep its background tasks going, and end it all in reverse order."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Coroutine
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager, suppress
from dataclasses import replace
from typing import Any

from capture2vr.gateway.database.disk_reserve import DiskReserve
from capture2vr.gateway.database.instance_lock import Instance, lock_instance, lock_replica
from capture2vr.gateway.gateway import Gateway
from capture2vr.gateway.jobs.other_gateways import OtherGateways
from capture2vr.gateway.opening import Equipment, open_gateway
from capture2vr.gateway.resumable.expiry import Expiry
from capture2vr.gateway.scenes.news import CHANNEL
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.gateway.vitals.vitals import Vitals

_log = logging.getLogger(__name__)


@asynccontextmanager
async def running(equipment: Equipment) -> AsyncIterator[Gateway]:
    """Run a gateway until the block is left. Raises FolderInUse, SQLAlchemyError, OSError where it cannot start."""
    async with AsyncExitStack() as stack:
        instance = stack.enter_context(lock_folder(equipment.settings))
        settings = equipment.settings.model_copy(update={"data_dir": instance.folder})
        DiskReserve(instance.folder).give_up_if_full()
        gateway = open_gateway(replace(equipment, settings=settings), instance.id, stack)
        for background in _background(gateway):
            task = asyncio.create_task(background)
            task.add_done_callback(_report_death)
            stack.push_async_callback(_stop, task)
        yield gateway


def lock_folder(settings: GatewaySettings) -> AbstractContextManager[Instance]:
    """Lock the data folder: for this gateway alone, or beside others that share a database server."""
    return (lock_instance if settings.database.startswith("sqlite") else lock_replica)(settings.data_dir)


def _background(gateway: Gateway) -> tuple[Coroutine[Any, Any, None], ...]:
    """Return what goes on as long as the gateway runs."""
    news = gateway.scenes.news
    others = OtherGateways(
        gateway.job_store,
        wake=gateway.dispatcher.wake,
        cancel=gateway.dispatcher.cancel,
        channels={CHANNEL: news.hear},
        on_connected=news.look_again,
    )
    return (
        gateway.dispatcher.run(),
        others.watch(),
        news.tell(),
        gateway.access.authentication.store_use(),
        gateway.webhooks.deliveries.run(),
        gateway.upkeep.snapshots.run(),
        gateway.upkeep.scrub.run(),
        gateway.upkeep.reserve.keep(),
        gateway.search.keep(),
        Vitals(gateway).run(),
        Expiry(gateway.captures.resumable, gateway.store, gateway.access.usage.add).run(),
        gateway.records.data.keep_retention(),
    )


async def _stop(task: asyncio.Task[None]) -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


def _report_death(task: asyncio.Task[None]) -> None:
    """Log an exception that ended a background task. These tasks should only end by being cancelled."""
    if not task.cancelled() and (error := task.exception()):
        _log.critical("a background task of the gateway ended with an error; restart the gateway", exc_info=error)
