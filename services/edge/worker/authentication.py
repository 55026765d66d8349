"""Who may call this worker: with a token set, whoever shows it. Health is for all: it starts and stops nothing."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from typing import Any, TypeVar

import grpc

_OPEN = "/grpc.health.v1.Health/"

HEAR_OUT_S = 2.0
HEAR_OUT_NEXT_S = 0.1
"""Seconds, in all and for each next message, that a refused caller is read to nowhere."""

_WRONG = "TOKEN_WRONG: the token is not this worker's; give both sides the same EDGE_TOKEN"
_MISSING = "TOKEN_MISSING: this worker asks for a token: set GATEWAY_EDGE_TOKEN, or EDGE_CENTRAL_TOKEN at a worker"

_Asked = TypeVar("_Asked")
_Told = TypeVar("_Told")


class TokenDoor(grpc.aio.ServerInterceptor):
    """Refuses calls without `authorization: Bearer <token>` as UNAUTHENTICATED."""

    def __init__(self, token: str) -> None:
        self._wanted = f"Bearer {token}".encode()

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[grpc.RpcMethodHandler[_Asked, _Told] | None]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> grpc.RpcMethodHandler[_Asked, _Told] | None:
        details: Any = handler_call_details
        if details.method.startswith(_OPEN):
            return await continuation(handler_call_details)
        shown = dict(details.invocation_metadata or ()).get("authorization")
        if shown is None:
            return _refusal(_MISSING)
        # In constant time, or the time taken would tell how far a guess is right.
        if not hmac.compare_digest(str(shown).encode(), self._wanted):
            return _refusal(_WRONG)
        return await continuation(handler_call_details)


async def heard_out(messages: AsyncIterator[Any]) -> None:
    """Read what a caller sends who is to be refused, while it comes at once.

    grpc.aio's client reports INTERNAL in place of the status when the status overtakes one of its writes.
    """
    with suppress(TimeoutError):
        async with asyncio.timeout(HEAR_OUT_S):
            while await _follows(messages):
                pass


async def _follows(messages: AsyncIterator[Any]) -> bool:
    """Whether another message comes at once."""
    async with asyncio.timeout(HEAR_OUT_NEXT_S):
        return await anext(messages, None) is not None


def _refusal(why: str) -> grpc.RpcMethodHandler[_Asked, _Told]:
    """A handler for any kind of call: on the wire they differ only in how many messages come."""

    async def refuse(requests: AsyncIterator[Any], context: grpc.aio.ServicerContext[Any, Any]) -> AsyncIterator[Any]:
        await heard_out(requests)
        await context.abort(grpc.StatusCode.UNAUTHENTICATED, why)
        yield  # never: it makes this the generator that a streaming answer is

    handler: grpc.RpcMethodHandler[_Asked, _Told] = grpc.stream_stream_rpc_method_handler(refuse)
    return handler
