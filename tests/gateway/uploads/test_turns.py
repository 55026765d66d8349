"""Uploads are checked a few at once: no tenant makes others wait for all that it has sent, or spends without an end."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.uploads import turns as module
from capture2vr.gateway.uploads.turns import _AT_ONCE, _MOST_AT_ONCE, Spend, Turns, _Budget

SHORT_S = 0.05


class Clock:
    """A clock that a test moves."""

    now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(module, "time", made)
    return made


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_WAIT_S", SHORT_S)


@asynccontextmanager
async def holding(turns: Turns, *tenants: str) -> AsyncIterator[list[Spend]]:
    """Turns of these tenants, who hold them until the end."""
    async with AsyncExitStack() as stack:
        yield [await stack.enter_async_context(turns.turn(tenant, 0)) for tenant in tenants]


class Waiter:
    """An upload that waits for its turn, and notes when it has it."""

    def __init__(self, turns: Turns, tenant: str, order: list[str]) -> None:
        self.release = asyncio.Event()
        self._turns, self._tenant, self._order = turns, tenant, order
        self.task = asyncio.create_task(self._run())

    async def _run(self) -> None:
        async with self._turns.turn(self._tenant, 0):
            self._order.append(self._tenant)
            await self.release.wait()


async def test_another_tenant_starts_at_once_beside_one_that_has_taken_all() -> None:
    turns = Turns()
    async with holding(turns, *["ada"] * _AT_ONCE), asyncio.timeout(SHORT_S), turns.turn("bob", 0):
        pass


async def test_many_tenants_start_no_more_than_the_machine_bears(impatient: None) -> None:
    turns = Turns()
    async with holding(turns, *map(str, range(_MOST_AT_ONCE))):
        with pytest.raises(Problem) as caught:
            async with turns.turn("bob", 0):
                pass
    assert (caught.value.status, caught.value.code) == (503, "UPLOADS_BUSY")
    assert caught.value.headers["Retry-After"]


async def test_a_refusal_tells_how_many_are_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    turns, order = Turns(), list[str]()
    async with holding(turns, *["ada"] * _AT_ONCE):
        before = [Waiter(turns, "ada", order) for _ in range(2)]
        await asyncio.sleep(0)
        monkeypatch.setattr(module, "_WAIT_S", SHORT_S)
        with pytest.raises(Problem, match="2 wait"):
            await Waiter(turns, "ada", order).task
        for each in before:
            each.task.cancel()
        await asyncio.gather(*(each.task for each in before), return_exceptions=True)
    assert not order


async def test_tenants_take_turns_and_each_tenants_own_are_in_order() -> None:
    turns, order = Turns(), list[str]()
    async with holding(turns, *map(str, range(_MOST_AT_ONCE))):
        waiters = [Waiter(turns, tenant, order) for tenant in ("ada", "ada", "ada", "bob", "cyd", "bob")]
        await asyncio.sleep(0)
    for each in waiters:
        each.release.set()
    await asyncio.gather(*(each.task for each in waiters))
    assert sorted(order[:3]) == ["ada", "bob", "cyd"]
    assert order[3:] in (["ada", "bob", "ada"], ["bob", "ada", "ada"])


async def test_who_leaves_the_line_takes_no_turn() -> None:
    turns, order = Turns(), list[str]()
    async with holding(turns, *["ada"] * _AT_ONCE):
        leaving, staying = Waiter(turns, "ada", order), Waiter(turns, "ada", order)
        await asyncio.sleep(0)
        leaving.task.cancel()
        await asyncio.gather(leaving.task, return_exceptions=True)
    staying.release.set()
    await staying.task
    async with holding(turns, *["ada"] * _AT_ONCE), asyncio.timeout(SHORT_S):
        assert order == ["ada"]


async def test_a_tenant_that_has_spent_its_minute_waits_and_no_other_does(clock: Clock) -> None:
    turns = Turns()
    async with turns.turn("ada", 60) as spend:
        spend(180.0)
    with pytest.raises(Problem) as caught:
        async with turns.turn("ada", 60):
            pass
    assert (caught.value.status, caught.value.code) == (429, "PROCESSOR_LIMITED")
    assert caught.value.headers["Retry-After"] == "120"
    async with turns.turn("bob", 60):
        pass
    clock.now += 121.0
    async with turns.turn("ada", 60):
        pass


async def test_a_turn_comes_by_itself_once_the_budget_allows_it() -> None:
    turns = Turns()
    async with turns.turn("ada", 6_000) as spend:
        spend(6_010.0)  # a tenth of a second too much
    async with asyncio.timeout(module._WAIT_S / 2), turns.turn("ada", 6_000):
        pass


@given(
    st.lists(st.tuples(st.floats(0, 50), st.floats(0, 100)), max_size=30),
    st.floats(1, 1_000),
)
def test_nobody_spends_more_than_the_limit_over_time(steps: list[tuple[float, float]], most_s: float) -> None:
    """Whoever starts only when nothing is to be waited for spends the limit of each minute, and one upload more."""
    budget, now, spent, begun = _Budget(0.0, 0.0), 0.0, 0.0, 0.0
    largest = max((seconds for _, seconds in steps), default=0.0)
    for pause, seconds in steps:
        now += pause
        if budget.wait_s(most_s, now) == 0.0:
            budget = _Budget(budget.left_over(most_s, now) + seconds, now)
            spent += seconds
    assert spent <= most_s * (1.0 + (now - begun) / 60.0) + largest + 1e-6
