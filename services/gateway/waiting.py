"""Wait for an event, but not longer than so many seconds."""

from __future__ import annotations

import asyncio


async def happens_within(event: asyncio.Event, seconds: float) -> bool:
    """Return whether an event happens within so many seconds.

    Not by `asyncio.wait_for`, which loses a cancellation that comes together with the event: until Python 3.12, whoever
    waited so in a loop would never end, and neither would the gateway's shutdown.
    """
    try:
        async with asyncio.timeout(seconds):
            return await event.wait()
    except TimeoutError:
        return False
