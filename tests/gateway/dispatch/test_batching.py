"""Batches of a run's reports: none is lost, their order stays, and what comes together is stored together."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator

import pytest

from capture2vr.gateway.dispatch.batching import batch_reports
from capture2vr.gateway.jobs.reports import AnchorsFound, Report, RunFinished, VersionPublished
from tests.support.patience import PATIENCE_S

PUBLISHED = VersionPublished(1, "dress", 1, "refined", "m")


async def _told(*reports: Report) -> AsyncGenerator[Report, None]:
    for report in reports:
        yield report
        await asyncio.sleep(0)


async def test_the_last_version_and_the_end_of_the_run_are_one_batch() -> None:
    batches = [
        batch async for batch in batch_reports(_told(PUBLISHED, RunFinished(2)), gather_s=PATIENCE_S, interval_s=0)
    ]
    assert batches == [[PUBLISHED, RunFinished(2)]]


async def test_a_report_is_not_held_back_for_the_next_one() -> None:
    go_on = asyncio.Event()

    async def slow() -> AsyncGenerator[Report, None]:
        yield PUBLISHED
        await go_on.wait()
        yield RunFinished(2)

    batches = batch_reports(slow(), gather_s=0.001, interval_s=0)
    assert await anext(batches) == [PUBLISHED]
    go_on.set()
    assert [batch async for batch in batches] == [[RunFinished(2)]]


async def test_all_reports_arrive_in_order_and_then_the_streams_error() -> None:
    reports = [AnchorsFound(seq, (0.0, 0.0, 0.0), (1, 2, 3)) for seq in range(1, 8)]

    async def breaks() -> AsyncGenerator[Report, None]:
        async for report in _told(*reports):
            yield report
        raise ConnectionError("lost")

    seen: list[Report] = []

    async def read() -> None:
        async for batch in batch_reports(breaks(), gather_s=0.0, interval_s=0.0):
            seen.extend(batch)

    with pytest.raises(ConnectionError, match="lost"):
        await read()
    assert seen == reports
