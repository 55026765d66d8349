"""The gateway's HTTP application (FastAPI): routes and middleware around a gateway, which is opened at startup."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

from fastapi import FastAPI
from fastapi.responses import JSONResponse
from starlette.middleware.cors import CORSMiddleware

import capture2vr
from capture2vr.gateway import errors
from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.compression import Compression
from capture2vr.gateway.gateway import keep_gateway
from capture2vr.gateway.middleware import RequestMiddleware
from capture2vr.gateway.opening import Equipment
from capture2vr.gateway.page_texts import WEB
from capture2vr.gateway.resumable import protocol
from capture2vr.gateway.routes import (
    access,
    assets,
    captures,
    collections,
    data,
    downloads,
    files,
    health,
    jobs,
    names,
    notes,
    pages,
    pictures,
    scene_events,
    scenes,
    service,
    shares,
    tenants,
    uploads,
    versions,
    visibility,
    webhooks,
)
from capture2vr.gateway.routes.access_rules import check_rules, describe_rules, needs
from capture2vr.gateway.running import running
from capture2vr.gateway.settings import GatewaySettings, read_metrics_token, worker_credentials
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.store import Store

# What pages of other origins may send and read, beside what uploads need.
_REQUEST_HEADERS = ("Authorization", "Content-Type", "Idempotency-Key", "If-Match", "Last-Event-ID")
_ANSWER_HEADERS = ("ETag", "Location", "RateLimit", "RateLimit-Policy", "Retry-After", "X-Request-ID")
_ROUTES = (
    *(captures, pictures, uploads, jobs, assets, versions, downloads, names, notes),
    *(collections, files, visibility, shares, scenes, scene_events),
    *(access, tenants, webhooks, data, health, service, pages),
)


def create_app(settings: GatewaySettings, store: Store, keys: Keys = NO_KEYS) -> FastAPI:
    """Build the app. Its gateway is opened at startup and closed at shutdown: `gateway_in` returns it in between.

    Raises SettingsError where the workers' certificate or token, or that of the metrics, cannot be used.
    """
    app = FastAPI(
        title="capture2vr",
        version=capture2vr.__version__,
        summary="Upload phone captures, reconstruct them as meshes, and download the assets for VR.",
        lifespan=_lifespan(
            Equipment(settings, store, keys, worker_credentials(settings), read_metrics_token(settings))
        ),
        docs_url=None,  # that page loads scripts from another host; the document itself is at /openapi.json
        redoc_url=None,
        openapi_url=None,  # the route below, which needs a key
    )
    errors.install_handlers(app)
    _add_routes(app)
    _add_middleware(app, settings)
    return app


def _lifespan(equipment: Equipment) -> Callable[[FastAPI], AbstractAsyncContextManager[None]]:
    """Return what runs the gateway as long as its app does."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with running(equipment) as gateway:
            keep_gateway(app, gateway)
            yield

    return lifespan


def _add_routes(app: FastAPI) -> None:
    for module in _ROUTES:
        check_rules(module.router.routes)
        app.include_router(module.router)
    _add_openapi(app)
    app.mount("/web", pages.WebFiles(directory=WEB), name="web")


def _add_middleware(app: FastAPI, settings: GatewaySettings) -> None:
    app.add_middleware(Compression)
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"],
            allow_headers=[*_REQUEST_HEADERS, *protocol.REQUEST_HEADERS],
            expose_headers=[*_ANSWER_HEADERS, *protocol.ANSWER_HEADERS],
        )
    app.add_middleware(RequestMiddleware, settings=settings)


def _add_openapi(app: FastAPI) -> None:
    """Serve the OpenAPI document, with the access rules, to operators."""
    make_document = app.openapi

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = make_document()
            for module in _ROUTES:
                describe_rules(module.router.routes, made)
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]

    @app.get("/openapi.json", include_in_schema=False, dependencies=[needs(Scope.OPERATE)])
    async def get_openapi() -> JSONResponse:
        return JSONResponse(document())
