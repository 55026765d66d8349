"""/v1/scenes/{scene}/events: follow a scene (server-sent events). /v1/scenes/{scene}/moving: tell where things are
while they are moved.
"""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import AsyncIterator
from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Query, Request
from sqlalchemy.exc import SQLAlchemyError
from sse_starlette import EventSourceResponse, ServerSentEvent

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.limits import limited
from capture2vr.gateway.access.readers import Thing
from capture2vr.gateway.errors import RETRY_S, Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.routes.access_rules import caller_of, needs
from capture2vr.gateway.routes.event_streams import (
    HEARTBEAT_S,
    RECONNECT_MS,
    LastEventId,
    known_event,
    stream_events,
)
from capture2vr.gateway.routes.read_rules import READS_SCENE, reading_of, still_reads_scene, unknown_scene
from capture2vr.gateway.routes.scenes import SceneId, view_of
from capture2vr.gateway.routes.store_access import store_problems
from capture2vr.gateway.scenes.listener import Listener
from capture2vr.gateway.scenes.moves import MovedItem, Moves
from capture2vr.gateway.schemas import problems
from capture2vr.gateway.waiting import happens_within
from capture2vr.sentences.sentence import say
from capture2vr.storage.scenes.scene import Scene

router = APIRouter(prefix="/v1", tags=["scenes"])

_MOST_STREAMS = 100  # of one share link, access key, or address without either: pages beyond them ask now and then
_MOVES_PAUSE_S = 0.05  # between two batches of moves to one listener, however many are sent

_log = logging.getLogger(__name__)


@router.get(
    "/scenes/{scene}/events",
    response_class=EventSourceResponse,
    dependencies=[READS_SCENE],
    responses={
        200: {
            "description": "Server-sent events with JSON data: `scene` (a new version, all of it; its `id` is the "
            "version), `moving` (where an object is while somebody moves it; nothing of that is stored), `deleted`, "
            "after which the stream ends, and `heartbeat`. It also ends once the reader may no longer read the scene",
            "content": {
                "text/event-stream": {
                    "schema": {"type": "string"},
                    "example": 'event: moving\r\ndata: {"sender": "k3v9", "id": "a", "position_m": [0.1, 0.0, -1.5], '
                    '"rotation": [0.0, 0.0, 0.0, 1.0], "scale": 1.0}\r\n\r\n',
                }
            },
        },
        **problems(404, 410, 422, 429, 503),
    },
)
async def follow_scene(
    scene: SceneId,
    request: Request,
    gateway: GatewayOf,
    after: Annotated[int | None, Query(ge=0, description="The version that is known: only newer ones.")] = None,
    last_event_id: LastEventId = "",
) -> EventSourceResponse:
    """Follow a scene as server-sent events: its newest version if that is not known, each later one, and what is moved.

    Of versions that were missed the newest is sent. A stream never ends by itself, unless the scene is deleted.
    """
    reading, news = reading_of(request), gateway.scenes.news
    await _read(reading.thing, request)  # an unknown scene is a 404, not an empty stream
    client = reading.by or (request.client.host if request.client else "")
    if news.streams_of(client) >= _MOST_STREAMS:
        detail = say("event_streams_scenes_open_already", count=_MOST_STREAMS)
        raise limited("STREAMS_LIMITED", detail, RETRY_S, hint="ask GET /v1/scenes/{scene} now and then instead")
    start = known_event(after, last_event_id)
    return stream_events(_event_stream(request, reading.thing, client, start), reading.cors_headers)


@router.post(
    "/scenes/{scene}/moving",
    status_code=204,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 415, 422, 429, 503),
)
async def post_moving(scene: SceneId, body: Moves, request: Request, gateway: GatewayOf) -> None:
    """Tell followers of an arrangement where objects are while they are moved. Nothing is stored; send ten a second."""
    thing = Thing(caller_of(request).tenant, "scene", scene)
    gateway.access.limits.spend_moves(thing.tenant, scene)
    await _read(thing, request)
    gateway.scenes.news.move(thing, body)


async def _event_stream(request: Request, thing: Thing, client: str, last: int) -> AsyncIterator[ServerSentEvent]:
    """Yield what happens in a scene that is known in version `last`, until it is deleted or may not be read."""
    look_at = 0.0
    news = gateway_of(request).scenes.news
    with news.listen(thing, client) as listener:
        if news.streams_of(client) > _MOST_STREAMS:  # many were asked for before the first of them had begun
            return
        while True:
            listener.news.clear()
            if listener.take_change() or time.monotonic() >= look_at:
                look_at = time.monotonic() + HEARTBEAT_S
                try:
                    found = await _look(request, thing)
                except FileNotFoundError:
                    yield ServerSentEvent("{}", event="deleted")
                    return
                except (Problem, SQLAlchemyError):  # a reader who asks again is told why
                    return
                if found is not None and found.version > last:
                    yield _scene_event(found, request)
                    last = found.version
            async for event in _moves_of(listener):
                yield event
            if not await happens_within(listener.news, max(0.0, look_at - time.monotonic())):
                yield ServerSentEvent("{}", event="heartbeat")


async def _look(request: Request, thing: Thing) -> Scene | None:
    """Return the scene for whoever still may read it; None where the store does not answer just now.

    Raises FileNotFoundError for a deleted one, Problem for who may no longer read it, SQLAlchemyError.
    """
    try:
        found = await gateway_of(request).scenes.reads.read(thing)
        await still_reads_scene(request)
    except FileNotFoundError:
        raise
    except OSError as error:
        _log.warning("those who follow %s wait for the store: %s", thing.name, error)
        return None
    return found


async def _moves_of(listener: Listener) -> AsyncIterator[ServerSentEvent]:
    """Yield where things were moved to, and pause: what comes meanwhile is sent at its newest place only."""
    moved = listener.take_moves()
    for sender, item in moved:
        yield _moving_event(sender, item)
    if moved:
        await asyncio.sleep(_MOVES_PAUSE_S)


async def _read(thing: Thing, request: Request) -> Scene:
    """Read a scene, as it was some seconds ago at most. Raises Problem."""
    try:
        with store_problems():
            return await gateway_of(request).scenes.reads.read(thing)
    except FileNotFoundError:
        raise unknown_scene(thing.name) from None


def _scene_event(scene: Scene, request: Request) -> ServerSentEvent:
    document = view_of(scene, request).model_dump_json()
    return ServerSentEvent(document, event="scene", id=str(scene.version), retry=RECONNECT_MS)


def _moving_event(sender: str, item: MovedItem) -> ServerSentEvent:
    return ServerSentEvent(json.dumps({"sender": sender, **asdict(item)}), event="moving")
