"""What is told of scenes: to slow listeners the newest only, to other gateways by NOTIFY."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy.engine import Engine

from capture2vr.gateway.access.readers import ReadersCache, Thing
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.routes import scene_events
from capture2vr.gateway.scenes.listener import Listener
from capture2vr.gateway.scenes.moves import MOST_MOVED, MovedItem, Moves, moves_as_json, moves_from_json
from capture2vr.gateway.scenes.news import SceneNews
from capture2vr.gateway.scenes.reads import SceneReads
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.scenes.scene import MOST_ITEMS
from capture2vr.storage.scenes.scene_documents import create_scene, replace_scene
from tests.gateway.routes.test_scene_events import THERE, Told, following, following_event, move, replaced, saved
from tests.support.in_process_gateway import gateway, memory
from tests.support.patience import PATIENCE_S

SCENE = Thing("ada", "scene", "scn_" + "0" * 24)


def moved(name: str = "a", x: float = 0.0) -> Moves:
    return Moves("me", (MovedItem(name, (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 1.0),))


def news_of(engine: Engine) -> SceneNews:
    store = memory()
    return SceneNews(engine, SceneReads(store), ReadersCache(store))


@pytest.fixture
async def news(tmp_path: Path) -> AsyncIterator[SceneNews]:
    """Of a gateway that has nobody beside it."""
    engine = open_engine(f"sqlite:///{tmp_path / 'gateway.db'}")
    yield news_of(engine)
    engine.dispose()


async def test_of_what_a_slow_listener_has_missed_it_gets_the_newest(news: SceneNews) -> None:
    with news.listen(SCENE, "me") as listener, news.listen(Thing("bob", "scene", SCENE.name), "me") as foreign:
        assert listener.take_change(), "at first everything is new"
        assert not listener.take_change()
        for x in (1.0, 2.0, 3.0):
            news.move(SCENE, moved(x=x))
        news.move(SCENE, moved("b"))
        assert listener.news.is_set()
        assert [(item.id, item.position_m[0]) for _, item in listener.take_moves()] == [("a", 3), ("b", 0)]
        assert listener.take_moves() == []
        assert not foreign.news.is_set()
        assert (news.streams_of("me"), news.listener_count) == (2, 2)
    assert (news.streams_of("me"), news.listener_count) == (0, 0)


def test_things_that_no_scene_can_have_take_no_memory() -> None:
    listener = Listener("me")
    for number in range(10 * MOST_ITEMS):
        listener.move(moved(f"made-up-{number}"))
    listener.move(moved("made-up-0", x=1.0))
    kept = listener.take_moves()
    assert len(kept) == MOST_ITEMS
    assert kept[0][1].position_m[0] == 1, "what is known goes on"


def test_a_report_of_what_moves_fits_into_a_notification() -> None:
    third = 100 / 3
    item = MovedItem("i" * 40, (-third, -third, -third), (1 / 3, 2 / 3, -2 / 3, 1e-17 / 3), 1 / 3)
    report = Moves("s" * 40, (item,) * MOST_MOVED)
    text = moves_as_json(report)
    assert len(text) < 7_500
    assert moves_from_json(text) == report


async def test_one_read_serves_all_who_ask_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    store = MemoryStore()
    scene = create_scene(store, "Room", ())
    thing, reads = Thing("default", "scene", scene.id), SceneReads(store)
    found = await asyncio.gather(*(reads.read(thing) for _ in range(20)))
    assert all(each is found[0] for each in found)
    changed = replace_scene(store, scene.id, 1, "Hall", ())
    assert await reads.read(thing) is found[0]
    reads.forget(thing)
    assert await reads.read(thing) == changed
    with pytest.raises(FileNotFoundError):
        await reads.read(SCENE)


async def test_what_another_version_of_the_gateway_says_is_left_out(
    news: SceneNews, caplog: pytest.LogCaptureFixture
) -> None:
    with news.listen(SCENE, "me") as listener:
        listener.take_change()
        news.hear(f'other ada {SCENE.name} {{"sender": "x", "colour": "red"}}')
        assert not listener.news.is_set()
        news.hear("of another form")
        assert caplog.text.count("does not understand") == 2
        news.hear(f"other ada {SCENE.name} ")
        assert listener.take_change()


async def event_of(kind: str, told: Told) -> tuple[str, str, dict[str, Any]]:
    """The next event of a kind."""
    while (event := await following_event(told))[0] != kind:
        pass
    return event


async def test_gateways_on_one_database_tell_each_other(
    empty_postgres: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_events, "HEARTBEAT_S", 1e6)  # nobody looks without being told
    store = memory()
    async with (
        gateway(tmp_path / "one", store, database_url=empty_postgres) as one,
        gateway(tmp_path / "two", store, database_url=empty_postgres) as two,
    ):
        scene = await saved(one)
        async with following(one, scene) as here, following(two, scene) as there:
            for told in (here, there):
                assert (await following_event(told))[:2] == ("scene", "1")
            async with asyncio.timeout(PATIENCE_S):
                while there.empty():  # until it listens to the database
                    await move(one, scene)
                    await asyncio.sleep(0.05)
            assert await following_event(there) == ("moving", "", {"sender": "me", **THERE})
            changed = await replaced(two, scene, 1)
            for told in (here, there):
                assert await event_of("scene", told) == ("scene", "2", changed)
            await one.delete(scene)
            for told in (here, there):
                assert await event_of("deleted", told)
