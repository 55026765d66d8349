"""Groups a run's reports into batches, so that a chatty run causes only a few synced commits per second."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import aclosing

from capture2vr.gateway.jobs.reports import Report, coalesce


async def batch_reports(
    reports: AsyncGenerator[Report, None], *, gather_s: float, interval_s: float
) -> AsyncGenerator[list[Report], None]:
    """Yield the stream's reports, coalesced, in batches at least `interval_s` apart; raise what the stream raises.

    gather_s  for which a batch waits for reports behind its first one; the end of the stream ends both waits
    """
    queue: asyncio.Queue[Report | None] = asyncio.Queue()
    pump = asyncio.create_task(_pump(reports, queue))
    try:
        while (first := await queue.get()) is not None:
            await asyncio.wait([pump], timeout=gather_s)
            batch: list[Report | None] = [first]
            while not queue.empty():
                batch.append(queue.get_nowait())
            yield coalesce(report for report in batch if report is not None)
            if batch[-1] is None:
                break
            await asyncio.wait([pump], timeout=interval_s)
        await pump
    finally:
        pump.cancel()
        await asyncio.wait([pump])


async def _pump(reports: AsyncGenerator[Report, None], queue: asyncio.Queue[Report | None]) -> None:
    try:
        async with aclosing(reports):
            async for report in reports:
                queue.put_nowait(report)
    finally:
        queue.put_nowait(None)
