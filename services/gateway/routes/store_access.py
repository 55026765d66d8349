"""What the routes that serve the store's objects share: the store, its failures, and the addresses of its objects."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar
from urllib.parse import urljoin

import anyio.to_thread
from fastapi import Request

from services.gateway.errors import Problem
from services.storage.faults import CatalogueFault
from services.storage.store import Store

ANYBODY = {"Access-Control-Allow-Origin": "*", "Access-Control-Expose-Headers": "ETag, Content-Range, Accept-Ranges"}
"""Headers of what pages of any origin may read."""

_T = TypeVar("_T")


async def in_thread(work: Callable[[], _T]) -> _T:
    """Off the event loop, with the store's failures told as problems. Raises Problem, FileNotFoundError."""
    try:
        return await anyio.to_thread.run_sync(work)
    except FileNotFoundError:
        raise
    except CatalogueFault as fault:
        hints = (fault.hint,) if fault.hint else ()
        title = "The collection cannot be used"
        raise Problem(503, fault.code, f"{fault.name}: {fault.message}", title=title, hints=hints) from fault
    except OSError as error:
        raise Problem(503, "STORE_UNAVAILABLE", "the store does not answer", retryable=True) from error


def store_of(request: Request) -> Store:
    """The gateway's store."""
    store: Store = request.app.state.store
    return store


def home_of(request: Request) -> str:
    """How clients reach this gateway, with a slash at the end."""
    public: str = request.app.state.settings.public_url
    return (public or str(request.base_url)).rstrip("/") + "/"


def url_of(request: Request, name: str) -> str:
    """The whole address of an object: a local store gives only a path."""
    return urljoin(home_of(request), store_of(request).url(name))
