"""Helpers of routes that serve objects of the store: run store calls in threads, translate errors, build URLs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar
from urllib.parse import urljoin

import anyio.to_thread
from fastapi import Request

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import gateway_of
from capture2vr.gateway.routes.read_rules import reads_tenant
from capture2vr.sentences.sentence import in_row, say
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import DEFAULT_TENANT, store_of_tenant

_T = TypeVar("_T")


async def in_thread(work: Callable[[], _T]) -> _T:
    """Run blocking store calls in a thread, and turn the store's errors into problems.

    Raises Problem, FileNotFoundError.
    """
    with store_problems():
        return await anyio.to_thread.run_sync(work)


@contextmanager
def store_problems() -> Iterator[None]:
    """Turn the store's errors into problems. Raises Problem, FileNotFoundError."""
    try:
        yield
    except FileNotFoundError:
        raise
    except CatalogueFault as fault:
        hints = (fault.hint,) if fault.hint else ()
        title = say("catalogue_cannot_be_used")
        raise Problem(503, fault.code, in_row(": ", (fault.name, fault.message)), hints=hints).titled(title) from fault
    except OSError as error:
        raise Problem(503, "STORE_UNAVAILABLE", say("store_does_not_answer"), retryable=True) from error


def store_of(request: Request) -> Store:
    """Return the store of the tenant whose things a request reads or changes."""
    return store_of_tenant(gateway_of(request).store, reads_tenant(request))


def gateway_url(request: Request) -> str:
    """Return the URL by which clients reach this gateway, with a slash at the end."""
    public = gateway_of(request).settings.public_url
    return (public or str(request.base_url)).rstrip("/") + "/"


def page_path(request: Request, path: str) -> str:
    """Return the path of a page that shows something of the tenant whose things a request reads, for anybody."""
    return path_of_tenant(reads_tenant(request), path)


def path_of_tenant(tenant: str, path: str) -> str:
    """Return the path of a page that shows something of a tenant, for anybody."""
    return path if tenant == DEFAULT_TENANT else f"{path}?tenant={tenant}"


def object_url(request: Request, name: str) -> str:
    """Return the absolute URL of an object (a local store gives only a path)."""
    return urljoin(gateway_url(request), store_of(request).url(name))
