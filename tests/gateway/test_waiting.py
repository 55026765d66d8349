"""Waiting for an event ends with the event, the time, or a cancellation, also where two of them come together."""

from __future__ import annotations

import asyncio

import pytest

from capture2vr.gateway.waiting import happens_within
from tests.support.patience import PATIENCE_S


async def test_an_event_and_the_time() -> None:
    event = asyncio.Event()
    assert not await happens_within(event, 0.01)
    event.set()
    assert await happens_within(event, PATIENCE_S)


@pytest.mark.parametrize("turns_later", range(4))
async def test_a_cancellation_that_comes_with_the_event_is_not_lost(turns_later: int) -> None:
    event = asyncio.Event()

    async def repeat() -> None:
        while True:
            event.clear()
            await happens_within(event, PATIENCE_S)

    task = asyncio.create_task(repeat())
    await asyncio.sleep(0)
    event.set()
    for _ in range(turns_later):  # of the loop, in which the news make their way
        await asyncio.sleep(0)
    task.cancel()
    async with asyncio.timeout(1.0):
        with pytest.raises(asyncio.CancelledError):
            await task
