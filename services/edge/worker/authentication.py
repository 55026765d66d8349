"""Token authentication of a worker's gRPC calls. Health checks need no token, because they start and stop nothing."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from typing import Any, TypeVar

import grpc

_OPEN_METHODS = "/grpc.health.v1.Health/"

DRAIN_S = 2.0
DRAIN_NEXT_S = 0.1
"""Seconds, in all and until each next message, that the messages of a refused call are read and discarded."""

_WRONG = "TOKEN_WRONG: the token is not this worker's; give both sides the same EDGE_TOKEN"
_MISSING = "TOKEN_MISSING: this worker needs a token: set GATEWAY_EDGE_TOKEN, or EDGE_CENTRAL_TOKEN at a worker"

_Request = TypeVar("_Request")
_Response = TypeVar("_Response")


class TokenAuthentication(grpc.aio.ServerInterceptor):
    """Refuses calls without `authorization: Bearer <token>` as UNAUTHENTICATED."""

    def __init__(self, token: str) -> None:
        self._expected = f"Bearer {token}".encode()

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[grpc.RpcMethodHandler[_Request, _Response] | None]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> grpc.RpcMethodHandler[_Request, _Response] | None:
        details: Any = handler_call_details
        if details.method.startswith(_OPEN_METHODS):
            return await continuation(handler_call_details)
        authorization = dict(details.invocation_metadata or ()).get("authorization")
        if authorization is None:
            return _refusing_handler(_MISSING)
        # In constant time: otherwise the time taken would show how many characters of a guess are right.
        if not hmac.compare_digest(str(authorization).encode(), self._expected):
            return _refusing_handler(_WRONG)
        return await continuation(handler_call_details)


async def drain_messages(messages: AsyncIterator[Any]) -> None:
    """Read and discard the messages of a call that will be refused, as long as they come without a pause.

    grpc.aio's client reports INTERNAL instead of the status when the status overtakes one of its writes.
    """
    with suppress(TimeoutError):
        async with asyncio.timeout(DRAIN_S):
            while await _read_next(messages):
                pass


async def _read_next(messages: AsyncIterator[Any]) -> bool:
    """Read the next message; return whether there was one. Raises TimeoutError where none comes soon."""
    async with asyncio.timeout(DRAIN_NEXT_S):
        return await anext(messages, None) is not None


def _refusing_handler(why: str) -> grpc.RpcMethodHandler[_Request, _Response]:
    """A handler that refuses any kind of call: on the wire the kinds differ only in the number of messages."""

    async def refuse(requests: AsyncIterator[Any], context: grpc.aio.ServicerContext[Any, Any]) -> AsyncIterator[Any]:
        await drain_messages(requests)
        await context.abort(grpc.StatusCode.UNAUTHENTICATED, why)
        yield  # never reached: it makes this function a generator, which a streaming answer must be

    handler: grpc.RpcMethodHandler[_Request, _Response] = grpc.stream_stream_rpc_method_handler(refuse)
    return handler
