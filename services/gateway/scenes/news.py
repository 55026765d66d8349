"""Tells those who watch a scene what happens in it: here at once, at other gateways by NOTIFY where there is Postgres.

A scene is a document of the store, which tells nobody of changes. Whoever watches therefore also looks at it now and
then: news that are lost, or that nobody told, come late and are not missed.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.access.readers import ReadersCache, Thing
from capture2vr.gateway.database.postgres_notify import can_notify, notify
from capture2vr.gateway.scenes.listener import Listener
from capture2vr.gateway.scenes.moves import Moves, moves_as_json, moves_from_json
from capture2vr.gateway.scenes.reads import SceneReads

CHANNEL = "capture2vr_scenes"
"""Where gateways tell each other."""
_MOST_WAITING = 64  # texts for other gateways: a second's moves of six hands

_log = logging.getLogger(__name__)


class SceneNews:
    """Wakes listeners of scenes: `with news.listen(scene, client) as listener: await listener.news.wait()`.

    Event loop only. engine: the database, by which other gateways are told
    """

    def __init__(self, engine: Engine, reads: SceneReads, readers: ReadersCache) -> None:
        self._engine = engine.execution_options(isolation_level="AUTOCOMMIT")
        self._reads = reads
        self._readers = readers
        self._origin = secrets.token_hex(8)  # in what is sent from here
        self._listeners: defaultdict[Thing, set[Listener]] = defaultdict(set)
        self._streams = Counter[str]()
        self._outbox: asyncio.Queue[str] = asyncio.Queue(_MOST_WAITING)

    @contextmanager
    def listen(self, scene: Thing, client: str) -> Iterator[Listener]:
        """Yield what there is to tell of a scene; clear its `news` before taking what it has."""
        listener = Listener(client)
        self._listeners[scene].add(listener)
        self._streams[client] += 1
        try:
            yield listener
        finally:
            self._listeners[scene].discard(listener)
            if not self._listeners[scene]:
                del self._listeners[scene]
            self._streams[client] -= 1
            if not self._streams[client]:
                del self._streams[client]

    def streams_of(self, client: str) -> int:
        """Return how many streams a client has."""
        return self._streams[client]

    @property
    def listener_count(self) -> int:
        """Number of listeners, over all scenes."""
        return self._streams.total()

    def change(self, scene: Thing) -> None:
        """Broadcast that an arrangement was replaced or deleted here."""
        self._change(scene)
        self._tell_others(scene, "")

    def move(self, scene: Thing, moves: Moves) -> None:
        """Broadcast where the moved objects of an arrangement are just now."""
        self._move(scene, moves)
        self._tell_others(scene, moves_as_json(moves))

    def hear(self, text: str) -> None:
        """Pass a notification from another gateway on to the listeners here."""
        if text.startswith(f"{self._origin} "):
            return
        try:
            _, tenant, name, what = text.split(" ", 3)
            moves = moves_from_json(what) if what else None
        except ValueError as error:
            _log.warning("another gateway says what this one does not understand: %s", error)
            return
        scene = Thing(tenant, "scene", name)
        if moves is None:
            self._change(scene)
        else:
            self._move(scene, moves)

    def look_again(self) -> None:
        """Refresh all listeners after a reconnect: notifications sent while disconnected were lost."""
        for scene in tuple(self._listeners):
            self._change(scene)

    async def tell(self) -> None:
        """Send notifications to the other gateways, one after the other, until cancelled."""
        while True:
            text = await self._outbox.get()
            try:
                await asyncio.to_thread(self._notify, text)
            except SQLAlchemyError as error:
                _log.warning("other gateways hear late of a scene's change: %s", error.__cause__ or error)

    def _change(self, scene: Thing) -> None:
        self._readers.forget_all(scene.tenant)
        self._reads.forget(scene)
        for listener in self._listeners.get(scene, ()):
            listener.change()

    def _move(self, scene: Thing, moves: Moves) -> None:
        for listener in self._listeners.get(scene, ()):
            listener.move(moves)

    def _tell_others(self, scene: Thing, what: str) -> None:
        if not can_notify(self._engine):
            return
        try:
            self._outbox.put_nowait(f"{self._origin} {scene.tenant} {scene.name} {what}")
        except asyncio.QueueFull:
            if not what:  # of what moves the next report, a tenth of a second later, has the newest place
                _log.warning("the database takes so long that other gateways hear late of %s", scene.name)

    def _notify(self, text: str) -> None:
        with self._engine.connect() as db:
            notify(db, CHANNEL, text)
