"""What a stream says within a moment, together: a talkative run then costs a few synced commits a second."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import aclosing

from services.gateway.jobs.reports import Report, coalesced


async def batched(reports: AsyncGenerator[Report, None], *, apart_s: float) -> AsyncGenerator[list[Report], None]:
    """All that the stream says, coalesced, in batches at least `apart_s` apart; then raises what the stream raises."""
    queue: asyncio.Queue[Report | None] = asyncio.Queue()
    pump = asyncio.create_task(_pump(reports, queue))
    try:
        while (first := await queue.get()) is not None:
            batch: list[Report | None] = [first]
            while not queue.empty():
                batch.append(queue.get_nowait())
            yield coalesced(report for report in batch if report is not None)
            if batch[-1] is None:
                break
            await asyncio.wait([pump], timeout=apart_s)
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
