"""What a gateway answers before it is open: while it migrates its database, or waits for one that it can work with.

Orchestrators kill what does not answer /livez, and start again what has ended: a migration would never come to its end,
and a database of a newer gateway would make a restart without end. So the process lives, says that it is not ready, and
looks again.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import uvicorn
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from capture2vr.gateway.database.schema import SchemaNewer
from capture2vr.gateway.errors import RETRY_S, Problem
from capture2vr.sentences.sentence import say

_MOMENT_S = 2.0  # a usual start is shorter; clients then wait for it instead of being refused
_LOOK_S = 5.0  # between two looks whether the database has become one that this gateway works with

_RETRY = {"Retry-After": str(RETRY_S)}

_log = logging.getLogger(__name__)


class StartingApp:
    """The ASGI app of a gateway that starts: /livez is answered, and everything else is refused for the moment.

    problem  the answer; `wait_for_schema` replaces it
    """

    def __init__(self) -> None:
        self.problem = Problem(503, "GATEWAY_STARTING", say("gateway_is_starting"), retryable=True, headers=_RETRY)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return
        is_alive = scope["path"] == "/livez"
        response = PlainTextResponse("ok\n") if is_alive else self.problem.response()
        await response(scope, receive, send)


def wait_for_schema(prepare: Callable[[], None], app: StartingApp) -> None:
    """Call `prepare` until the database is one that this gateway works with; says once in the log why it waits."""
    is_told = False
    while True:
        try:
            return prepare()
        except SchemaNewer as newer:
            detail = say("database_is_of_newer_gateway")
            app.problem = Problem(503, "SCHEMA_NEWER", detail, retryable=True, headers=_RETRY)
            if not is_told:
                _log.error("waiting, and answering 503: %s", newer)
                is_told = True
        time.sleep(_LOOK_S)


@contextmanager
def answered_meanwhile(server: uvicorn.Server, serve: Callable[[uvicorn.Server], None]) -> Iterator[None]:
    """Serve in a thread while the block runs, if that takes longer than a moment.

    serve  runs the server on a listening socket of its own, until it should exit
    """
    thread = threading.Timer(_MOMENT_S, serve, (server,))
    thread.daemon = True
    thread.start()
    try:
        yield
    finally:
        thread.cancel()
        server.should_exit = True
        thread.join()
