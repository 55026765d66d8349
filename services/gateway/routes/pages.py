"""The capture page, the viewer, the page of a collection, and the modules that they are made of."""

from __future__ import annotations

import base64
import hashlib
import re
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

from fastapi import APIRouter, Query, Request, Response
from fastapi.staticfiles import StaticFiles
from starlette.types import Scope

from services.gateway.errors import Problem
from services.gateway.schemas import problems
from services.gateway.settings import GatewaySettings
from services.storage.catalogue import valid_key
from services.storage.store import Store

router = APIRouter(tags=["pages"])

WEB = Path(__file__).parents[1] / "web"

_INLINE_SCRIPT = re.compile(r"<script(?![^>]*\bsrc=)[^>]*>(.*?)</script>", re.DOTALL)
_VERSIONED = re.compile(r"-\d+\.\d+\.\d+\.")  # "three-0.187.0.module.js" will always be that
# It makes functions out of text. They stay in it: a worker has no page, and this one may ask nobody for anything.
_WORKER_POLICY = "default-src 'none'; script-src 'self' 'unsafe-eval'"
_FOREVER = "public, max-age=31536000, immutable"
_TOGETHER = 24  # assets in one scene: at 5,000 triangles each their coarsest levels leave most of a headset's budget
_HTML: dict[int | str, dict[str, Any]] = {200: {"content": {"text/html": {}}}}


@router.get("/", response_class=Response, responses=_HTML)
async def capture_page(request: Request) -> Response:
    """Where a phone makes its capture."""
    return _page("index.html", request)


@router.get("/view", response_class=Response, responses={**_HTML, **problems(404, 422)})
async def scene(
    request: Request,
    key: Annotated[list[str], Query(max_length=_TOGETHER, description="The assets' keys, each once.")],
) -> Response:
    """Where several assets are looked at side by side: `/view?key=a&key=b`."""
    _check(key)
    return _page("view.html", request)


@router.get("/view/{key}", response_class=Response, responses={**_HTML, **problems(404)})
async def viewer(key: str, request: Request) -> Response:
    """Where an asset is looked at, on a screen or in a headset."""
    _check([key])
    return _page("view.html", request)


@router.get("/browse/{name}", response_class=Response, responses={**_HTML, **problems(404)})
async def collection(name: str, request: Request) -> Response:
    """The pictures of all assets of a collection, to search and to choose from."""
    if not valid_key(name):
        raise Problem(404, "COLLECTION_INVALID", "that is no collection's name", hints=("check the address",))
    return _page("collection.html", request)


def _check(keys: list[str]) -> None:
    if not all(map(valid_key, keys)):
        raise Problem(404, "KEY_INVALID", "that is no asset key", hints=("check the address",))


class Web(StaticFiles):
    """The modules: those with a version in their name are kept for ever, the others are asked for every time."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = _FOREVER if _VERSIONED.search(path) else "no-cache"
        if Path(path).name == "sw.js":
            response.headers["Service-Worker-Allowed"] = "/"  # it serves the pages, which are above /web/
        if Path(path).name == "ktx2-worker.js":
            response.headers["Content-Security-Policy"] = _WORKER_POLICY
        return response


def _page(name: str, request: Request) -> Response:
    html = (WEB / name).read_text(encoding="utf-8")
    policy = _policy(html, _origins(request.app.state.store, request.app.state.settings))
    headers = {"Cache-Control": "no-cache", "Content-Security-Policy": policy}
    return Response(html, media_type="text/html", headers=headers)


def _policy(html: str, assets: str) -> str:
    """Only what is ours runs; assets may come from the CDN's origin. Inline scripts (import maps) are named by hash."""
    inline = " ".join(f"'sha256-{_digest(script)}'" for script in _INLINE_SCRIPT.findall(html))
    return "; ".join(
        part.strip()
        for part in (
            "default-src 'none'",
            f"script-src 'self' 'wasm-unsafe-eval' {inline}",  # mesh decoders are WebAssembly
            "worker-src 'self' blob:",
            "style-src 'self' 'unsafe-inline'",
            f"img-src 'self' data: blob: {assets}",
            f"connect-src 'self' data: blob: {assets}",
            "manifest-src 'self'",
            "base-uri 'none'",
            "form-action 'self'",
            "frame-ancestors 'none'",
        )
    )


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _origins(store: Store, settings: GatewaySettings) -> str:
    """Schemes and hosts that asset URLs may have: the CDN's, or this gateway's as the world calls it."""
    split = [urlsplit(url) for url in (store.url("assets/x"), settings.public_url)]
    return " ".join(dict.fromkeys(f"{parts.scheme}://{parts.netloc}" for parts in split if parts.netloc))
