"""The outbox: an event is one message for each webhook, however often it is told, is tried for a day, and not lost."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import pytest
from sqlalchemy.engine import Engine

from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.webhooks.outbox import DELAYS_S, EVENTS, KEEP_S, PLACES_A_TENANT, Delivery, Outbox, WebhookEvent
from capture2vr.gateway.webhooks.store import WebhookStore

LATE = time.time() + 1e6
EVENT = WebhookEvent("job.succeeded", "job_1 7", {"job": "job_1"})


@dataclass(frozen=True, slots=True)
class Box:
    engine: Engine
    outbox: Outbox
    hooks: WebhookStore

    def hook(self, tenant: str = "ada", *events: str) -> str:
        made = self.hooks.create(tenant, "https://example.com/", events, "", most=20)
        assert made is not None
        return made[0].id


@pytest.fixture
def box(url: str) -> Iterator[Box]:
    engine = open_engine(url)
    for tenant in ("ada", "bob"):
        AccessStore(engine).ensure_tenant(tenant)
    yield Box(engine, Outbox(engine), WebhookStore(engine))
    engine.dispose()


def test_an_event_that_is_told_twice_is_one_message(box: Box) -> None:
    hooks = {box.hook(), box.hook()}
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: box.outbox.enqueue("ada", EVENT), range(8)))
    claimed = box.outbox.claim(LATE, 10, set())
    assert {each.message.webhook for each in claimed} == hooks
    assert len({each.message.id for each in claimed}) == 2
    assert [box.hooks.page("ada", hook, limit=9, before=LATE)[0].type for hook in hooks] == ["job.succeeded"] * 2


def test_only_who_wants_an_event_and_is_of_its_tenant_is_told(box: Box) -> None:
    wanting, _, _ = box.hook("ada", "job.succeeded"), box.hook("ada", "asset.published"), box.hook("bob")
    box.outbox.enqueue("ada", EVENT)
    assert [each.message.webhook for each in box.outbox.claim(LATE, 10, set())] == [wanting]


def test_a_message_is_claimed_by_one_of_many_and_by_another_when_that_one_died(box: Box) -> None:
    box.hook()
    box.outbox.enqueue("ada", EVENT)
    now = time.time() + 1
    with ThreadPoolExecutor(4) as pool:
        claims = [each for some in pool.map(lambda _: box.outbox.claim(now, 10, set()), range(4)) for each in some]
    assert len(claims) == 1
    assert box.outbox.claim(now + 30, 10, set()) == []
    (again,) = box.outbox.claim(now + 61, 10, set())
    assert again.message.id == claims[0].message.id


def test_one_at_a_time_to_each_webhook_the_oldest_first(box: Box) -> None:
    one, two = box.hook(), box.hook()
    for number in range(3):
        box.outbox.enqueue("ada", WebhookEvent("job.failed", str(number), {"number": number}))
    claimed = box.outbox.claim(LATE, 10, set())
    assert {each.message.webhook for each in claimed} == {one, two}
    assert all('"number":0' in each.message.payload for each in claimed)
    assert [each.message.webhook for each in box.outbox.claim(LATE, 10, {one})] == [two]


def hooks_of(claimed: list[Delivery]) -> list[str]:
    return [each.message.webhook for each in claimed]


def test_of_several_webhooks_the_one_that_has_waited_longest_is_first(box: Box) -> None:
    kinds = {box.hook("ada", kind): kind for kind in EVENTS}
    order = sorted(kinds, reverse=True)  # against the order in which a database groups them
    for hook in order:
        box.outbox.enqueue("ada", WebhookEvent(kinds[hook], "x", {}))
    assert hooks_of(box.outbox.claim(LATE, 1, set())) == order[:1]
    assert hooks_of(box.outbox.claim(LATE, 3, {order[0]})) == order[1:4]


def test_a_tenant_with_many_dead_webhooks_leaves_places_to_others(box: Box) -> None:
    dead = {box.hook("ada") for _ in range(20)}
    for number in range(3):
        box.outbox.enqueue("ada", WebhookEvent("job.failed", str(number), {}))
    bobs = box.hook("bob")
    box.outbox.enqueue("bob", EVENT)
    claimed = hooks_of(box.outbox.claim(LATE, 16, set()))
    assert len(claimed) == PLACES_A_TENANT + 1
    assert {*claimed} - dead == {bobs}
    busy = {*claimed} & dead
    assert box.outbox.claim(LATE, 7, busy) == []
    busy.pop()
    (following,) = hooks_of(box.outbox.claim(LATE, 7, busy))
    assert following in dead - busy


def test_the_next_place_is_for_the_tenant_that_has_the_fewest(box: Box) -> None:
    """However many tenants have webhooks that do not answer, and however long their messages have waited."""
    two, one = sorted((box.hook("ada"), box.hook("ada")))
    for number in range(3):
        box.outbox.enqueue("ada", WebhookEvent("job.failed", str(number), {}))
    while (bobs := box.hook("bob")) < two:  # a database that groups by webhook would begin with the least
        box.hooks.delete("bob", bobs)
    box.outbox.enqueue("bob", EVENT)
    assert hooks_of(box.outbox.claim(LATE, 1, {one})) == [bobs]
    assert hooks_of(box.outbox.claim(LATE, 1, {one, bobs})) == [two]


def test_it_is_tried_for_a_day_and_then_given_up(box: Box) -> None:
    hook = box.hook()
    box.outbox.enqueue("ada", EVENT)
    began = now = time.time() + 1
    times = []
    while claimed := box.outbox.claim(now, 1, set()):
        times.append(now - began)
        box.outbox.failed(claimed[0].message, "500 no", now)
        now = box.outbox.next_due() or now
    assert len(times) == len(DELAYS_S) + 1 >= 9
    assert times[-1] >= 86_400
    (given_up,) = box.hooks.page("ada", hook, limit=9, before=LATE)
    assert (given_up.delivered, given_up.due, given_up.last_answer) == (False, None, "500 no")
    assert given_up.ended is not None
    again = box.hooks.redeliver("ada", hook, given_up.id)
    assert again is not None
    assert (again.id, again.attempts, again.ended) == (given_up.id, 0, None)
    assert box.hooks.redeliver("bob", hook, given_up.id) is None


def test_a_receiver_may_ask_for_more_time_but_not_for_less(box: Box) -> None:
    box.hook()
    box.outbox.enqueue("ada", EVENT)
    for wait_s, expected in ((900.0, 900.0), (1.0, DELAYS_S[1])):
        (claimed,) = box.outbox.claim(LATE, 1, set())
        box.outbox.failed(claimed.message, "429", 1_000.0, wait_s=wait_s)
        assert box.outbox.next_due() == 1_000.0 + expected


def test_a_disabled_webhook_keeps_its_messages_until_it_is_enabled(box: Box) -> None:
    hook = box.hook()
    box.outbox.enqueue("ada", EVENT)
    box.outbox.disable(hook, time.time())
    box.outbox.enqueue("ada", WebhookEvent("job.failed", "job_2 3", {}))
    assert box.outbox.claim(LATE, 9, set()) == []
    assert box.outbox.next_due() is None
    box.hooks.set_disabled("ada", hook, disabled=False)
    assert [each.message.type for each in box.outbox.claim(LATE, 9, set())] == ["job.succeeded"]


def test_what_was_delivered_is_kept_for_a_week(box: Box) -> None:
    hook = box.hook()
    box.outbox.enqueue("ada", EVENT)
    (claimed,) = box.outbox.claim(LATE, 1, set())
    box.outbox.delivered(claimed.message, "204", 1_000.0)
    assert box.outbox.remove_old(1_000.0 + KEEP_S - 1) == 0
    assert box.hooks.page("ada", hook, limit=9, before=LATE)[0].delivered
    assert box.outbox.remove_old(1_000.0 + KEEP_S + 1) == 1
    assert box.hooks.page("ada", hook, limit=9, before=LATE) == []


def test_the_old_secret_signs_for_a_day_more(box: Box) -> None:
    hook = box.hook()
    first = box.outbox
    new = box.hooks.rotate("ada", hook)
    box.outbox.enqueue("ada", EVENT)
    (claimed,) = first.claim(time.time() + 1, 1, set())
    assert claimed.secrets[0] == new
    assert len(claimed.secrets) == 2
    (later,) = first.claim(time.time() + 2 * 86_400, 1, set())
    assert later.secrets == (new,)


def test_a_deleted_webhook_takes_its_messages_along(box: Box) -> None:
    hook = box.hook()
    box.outbox.enqueue("ada", EVENT)
    box.hooks.delete("bob", hook)
    assert len(box.outbox.claim(LATE, 9, set())) == 1
    box.hooks.delete("ada", hook)
    assert box.hooks.all("ada") == []
    assert box.outbox.claim(2 * LATE, 9, set()) == []
