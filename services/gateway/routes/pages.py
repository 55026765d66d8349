"""HTML pages (capture, viewer, edit, collection, login, pairing, operator's) and the static files that they load."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

from fastapi import APIRouter, Query, Request, Response
from fastapi.staticfiles import StaticFiles
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.types import Scope

from capture2vr.gateway.browser_permissions import CAMERA_PAGE
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.languages import LANGUAGES, preferred_language
from capture2vr.gateway.page_modules import name_modules
from capture2vr.gateway.page_texts import TEXTS, WEB, sentences_address, stored_sentences, translate_page
from capture2vr.gateway.routes.access_rules import ANYONE
from capture2vr.gateway.schemas import problems
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.entry import valid_key
from capture2vr.storage.scenes.scene import SCENE_ID
from capture2vr.storage.store import PresigningStore, Store

router = APIRouter(tags=["pages"])

_INLINE_SCRIPT = re.compile(r"<script(?![^>]*\bsrc=|[^>]*application/json)[^>]*>(.*?)</script>", re.DOTALL)
_VERSIONED = re.compile(r"-\d+\.\d+\.\d+\.")  # a file whose name has its version, such as three-0.187.0.module.js
# The KTX2 decoder makes functions from text (eval). That is safe in a web worker, which has no page and, with this
# policy, no network access.
_WORKER_POLICY = "default-src 'none'; script-src 'self' 'unsafe-eval'"
_IMMUTABLE = "public, max-age=31536000, immutable"
_START_GUARD = re.compile(r'<script src="/web/shared/start-guard\.js"([^>]*)></script>')
_SHELL_PAGES = {
    "/": "capture/index.html",
    "/browse/default": "collection/collection.html",
    "/view/any": "viewer/view.html",
    f"/scene/scn_{'0' * 24}": "viewer/view.html",
    "/wardrobe/default": "viewer/view.html",
}
# Pages that need the server in any case.
_ONLINE = {WEB / name for name in ("admin", "edit", "login", "pair", "share")}
_ONLINE_LIBRARY = "tus-js-client-"  # uploads
_SHELL_SUFFIXES = {".css", ".js", ".svg", ".wasm"}
_MOST_ASSETS = 24  # in one scene: with 5,000 triangles each, their coarsest levels leave most of a headset's budget
_HTML: dict[int | str, dict[str, Any]] = {200: {"content": {"text/html": {}}}}


@router.get("/", response_class=Response, dependencies=[ANYONE], responses=_HTML)
async def capture_page(request: Request) -> Response:
    """The capture page: take photos or a video with a phone, or upload files. The only page that may use the camera."""
    page = _page("capture/index.html", request)
    page.headers["Permissions-Policy"] = CAMERA_PAGE
    return page


@router.get("/login", response_class=Response, dependencies=[ANYONE], responses=_HTML)
async def login_page(request: Request) -> Response:
    """The login page: an access key, or ten digits that another screen shows."""
    return _page("login/login.html", request)


@router.get("/pair", response_class=Response, dependencies=[ANYONE], responses=_HTML)
async def pairing_page(request: Request) -> Response:
    """The pairing page: shows a QR code and ten digits, and logs in the phone that scans the code."""
    return _page("pair/pair.html", request)


@router.get("/admin", response_class=Response, dependencies=[ANYONE], responses=_HTML)
async def admin_page(request: Request) -> Response:
    """The operator's page: tenants, keys, limits, queue, workers, stores, failures, disks. Its figures need a key.

    It is in English alone, as the runbook and the logs are.
    """
    return _page("admin/admin.html", request, languages=LANGUAGES[:1])


@router.get("/s/{token}", response_class=Response, dependencies=[ANYONE], responses={**_HTML, **problems(404, 410)})
async def share_page(token: str, request: Request, gateway: GatewayOf) -> Response:
    """The page of a share link: asks for a password where there is one, and leads to what is shared."""
    status = 200
    try:
        await gateway.access.sharing.share_of(token)
    except Problem as problem:
        status = problem.status
        if "text/html" not in request.headers.get("accept", ""):
            raise
    return _page("share/share.html", request, status)


@router.get("/view", response_class=Response, dependencies=[ANYONE], responses={**_HTML, **problems(404, 422)})
async def view_assets(
    request: Request,
    key: Annotated[list[str], Query(max_length=_MOST_ASSETS, description="The assets' keys, each once.")],
) -> Response:
    """The viewer page with several assets side by side: `/view?key=a&key=b`."""
    _check_keys(key)
    return _page("viewer/view.html", request)


@router.get("/view/{key}", response_class=Response, dependencies=[ANYONE], responses={**_HTML, **problems(404)})
async def view_asset(key: str, request: Request) -> Response:
    """The viewer page of an asset, for a screen or a headset."""
    _check_keys([key])
    return _page("viewer/view.html", request)


@router.get("/scene/{scene}", response_class=Response, dependencies=[ANYONE], responses={**_HTML, **problems(404)})
async def view_scene(scene: str, request: Request) -> Response:
    """The viewer page of an arrangement: its objects where they were put, for a screen or a headset."""
    if not re.fullmatch(SCENE_ID, scene):
        raise Problem(404, "SCENE_INVALID", say("not_valid_scene_id"), hints=(say("check_id_in_url"),))
    return _page("viewer/view.html", request)


@router.get("/wardrobe/{name}", response_class=Response, dependencies=[ANYONE], responses={**_HTML, **problems(404)})
async def view_wardrobe(name: str, request: Request) -> Response:
    """The viewer page of a collection's garments: those of a season, one after the other on a dress dummy."""
    _check_collection(name)
    return _page("viewer/view.html", request)


@router.get("/edit/{key}", response_class=Response, dependencies=[ANYONE], responses={**_HTML, **problems(404)})
async def edit_asset(key: str, request: Request) -> Response:
    """The edit page of an asset: crop box, planes, up and true size of a stored capture; its versions, compared."""
    _check_keys([key])
    return _page("edit/edit.html", request)


@router.get("/browse/{name}", response_class=Response, dependencies=[ANYONE], responses={**_HTML, **problems(404)})
async def browse_collection(name: str, request: Request) -> Response:
    """The page of a collection: pictures of all its assets, with a search."""
    _check_collection(name)
    return _page("collection/collection.html", request)


class Shell(BaseModel):
    """What the service worker caches: the addresses of the pages that open without the server, and of all files that
    they load. `version` changes with any of them.
    """

    version: str
    files: list[str]


@router.get("/web/shell.json", response_model=Shell, dependencies=[ANYONE])
def list_shell(request: Request, response: Response) -> Shell:
    """List the pages that open without the server, each for all of its kind, and all files that they load."""
    files = [path for path in sorted(WEB.rglob("*")) if path.suffix in _SHELL_SUFFIXES]
    files = [path for path in files if path.parent not in _ONLINE and not path.name.startswith(_ONLINE_LIBRARY)]
    digest = hashlib.sha256(b"".join(hashlib.sha256(_html(name).encode()).digest() for name in _SHELL_PAGES.values()))
    for path in [*files, TEXTS]:
        found = path.stat()
        digest.update(_file_digest(path, found.st_mtime_ns, found.st_size))
    addresses = [f"/web/{path.relative_to(WEB).as_posix()}" for path in files]
    language = preferred_language(request.headers.get("accept-language", ""))
    if language != LANGUAGES[0]:
        addresses.append(sentences_address(language))
        digest.update(addresses[-1].encode())
    response.headers.update({"Cache-Control": "no-cache", "Vary": "Accept-Language"})
    return Shell(version=digest.hexdigest()[:16], files=[*_SHELL_PAGES, *addresses])


@router.get("/web/sentences/{name}", response_class=Response, dependencies=[ANYONE], responses=problems(404))
def stored_sentences_of(name: str) -> Response:
    """Get what gateway and worker say, in the language that the name begins with, by the sentences' codes."""
    language = name.partition("-")[0]
    if language not in LANGUAGES[1:] or f"/web/sentences/{name}" != sentences_address(language):
        raise HTTPException(404)
    headers = {"Cache-Control": _IMMUTABLE}
    return Response(stored_sentences(language), media_type="application/json", headers=headers)


@lru_cache(maxsize=256)
def _file_digest(path: Path, modified_ns: int, size: int) -> bytes:
    """Hash a file, again only when it has changed: every visit asks for the shell, and its files are 3 MB."""
    return hashlib.sha256(path.read_bytes()).digest()


def _check_collection(name: str) -> None:
    if not valid_key(name):
        detail = say("not_valid_collection_name")
        raise Problem(404, "COLLECTION_INVALID", detail, hints=(say("check_name_in_url"),))


def _check_keys(keys: list[str]) -> None:
    if not all(map(valid_key, keys)):
        raise Problem(404, "KEY_INVALID", say("not_valid_asset_key"), hints=(say("check_key_in_url"),))


class WebFiles(StaticFiles):
    """Static files of the pages. Files with a version in their name are cached for ever, others are revalidated.
    Type declarations (.d.ts) are not served.
    """

    async def get_response(self, path: str, scope: Scope) -> Response:
        if path.endswith(".d.ts"):
            raise HTTPException(404)  # types, which only the TypeScript compiler reads
        response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = _IMMUTABLE if _VERSIONED.search(path) else "no-cache"
        if Path(path).name == "service-worker.js":
            response.headers["Service-Worker-Allowed"] = "/"  # its scope includes the pages, which are not below /web/
        if Path(path).name == "ktx2-worker.js":
            response.headers["Content-Security-Policy"] = _WORKER_POLICY
        return response


def _page(name: str, request: Request, status: int = 200, languages: tuple[str, ...] = LANGUAGES) -> Response:
    language = preferred_language(request.headers.get("accept-language", ""), languages)
    html = translate_page(_html(name), language)
    gateway = gateway_of(request)
    policy = _content_security_policy(html, _origins(gateway.store, gateway.settings))
    headers = {
        "Cache-Control": "no-cache",
        "Content-Language": language,
        "Content-Security-Policy": policy,
        "Vary": "Accept-Language",
    }
    return Response(html, status, media_type="text/html", headers=headers)


def _html(name: str) -> str:
    """Return a page's text: with all its modules named, and with the script that guards its start inline, as a file it
    might fail to load as well.
    """
    guard = (WEB / "shared" / "start-guard.js").read_text(encoding="utf-8")
    html = name_modules((WEB / name).read_text(encoding="utf-8"), WEB)
    return _START_GUARD.sub(lambda found: f"<script{found[1]}>\n{guard}</script>", html)


def _content_security_policy(html: str, assets: str) -> str:
    """Return the Content-Security-Policy: only our own scripts run; assets may come from the CDN's origin.

    Inline scripts (import maps) are allowed by hash.
    """
    inline = " ".join(f"'sha256-{_digest(script)}'" for script in _INLINE_SCRIPT.findall(html))
    return "; ".join(
        part.strip()
        for part in (
            "default-src 'none'",
            f"script-src 'self' 'wasm-unsafe-eval' {inline}",  # mesh decoders are WebAssembly
            "worker-src 'self' blob:",
            "style-src 'self' 'unsafe-inline'",
            f"img-src 'self' data: blob: {assets}",
            "media-src 'self'",  # films of a capture, on the edit page
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
    """Return the origins that asset URLs may have or lead to: the CDN's or the bucket's, this gateway's public URL."""
    presigned = store.presigned_url("assets/x") if isinstance(store, PresigningStore) else ""
    split = [urlsplit(url) for url in (store.url("assets/x"), presigned, settings.public_url)]
    return " ".join(dict.fromkeys(f"{parts.scheme}://{parts.netloc}" for parts in split if parts.netloc))
