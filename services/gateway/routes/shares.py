"""/v1/shares: share an asset, a collection or a scene by a link, list links, revoke, open one. /s/TOKEN: its page."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Annotated, Any
from urllib.parse import urljoin

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.readers import Kind, Thing
from capture2vr.gateway.access.shares import SHARE_ID, Mode, Share
from capture2vr.gateway.access.sharing import COOKIE_PREFIX
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.qr_code import qr_svg
from capture2vr.gateway.routes.access import Days, utc, utc_or_none
from capture2vr.gateway.routes.access_rules import ANYONE, caller_of, needs
from capture2vr.gateway.routes.read_rules import unknown_asset, unknown_collection, unknown_scene
from capture2vr.gateway.routes.store_access import gateway_url, in_thread, path_of_tenant, store_of
from capture2vr.gateway.schemas import Label, StrictBody, problems
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.entry import entry_name, valid_key
from capture2vr.storage.catalogue.root import index_name
from capture2vr.storage.scenes.scene_documents import scene_name

router = APIRouter(prefix="/v1", tags=["shares"])

_DAY_S = 86_400.0
_DEFAULT_DAYS = 30
_PAGES: Mapping[Kind, str] = {"asset": "view", "collection": "browse", "scene": "scene"}
"""First part of the path of a thing's page."""

_DOCUMENTS: Mapping[Kind, tuple[Callable[[str], str], Callable[[str], Problem]]] = {
    "asset": (entry_name, unknown_asset),
    "collection": (index_name, unknown_collection),
    "scene": (scene_name, unknown_scene),
}
"""The object that a thing has, and the problem where there is none."""

ShareId = Annotated[str, Path(max_length=40, pattern=f"^{SHARE_ID}$", description="Id of a share.")]
KeyOrEmpty = Annotated[str, Field(max_length=100)]


class ShareRequest(StrictBody):
    """What is shared: one of `asset`, `collection` and `scene`; a scene's link opens the assets that stand in it, too.
    mode `place`: its visitors may move it about. Without `expires_days` (null) the link works until it is revoked.
    """

    asset: KeyOrEmpty = ""
    collection: KeyOrEmpty = ""
    scene: KeyOrEmpty = ""
    mode: Mode = "read"
    label: Label = ""
    expires_days: Days | None = _DEFAULT_DAYS
    password: Annotated[str, Field(max_length=200, description="Visitors have to type it; empty: none.")] = ""


class ShareView(BaseModel):
    """A share link: `url` is the link. `opened`: how often; `ended`: "", revoked or expired."""

    id: str
    kind: Kind
    name: str
    mode: Mode
    label: str
    has_password: bool
    created: datetime
    expires: datetime | None
    revoked: datetime | None
    ended: str
    opened: int
    last_opened: datetime | None
    url: str


class SharePage(BaseModel):
    """A page of shares, oldest first. `next` is the value of `after` for the next page; null on the last page."""

    shares: list[ShareView]
    next: str | None


class OpenRequest(StrictBody):
    """The end of a share link, and the password that came with it."""

    token: Annotated[str, Field(max_length=200)]
    password: Annotated[str, Field(max_length=200)] = ""


class OpenedShareView(BaseModel):
    """What a link opens: `view` is the path of its page, `tenant` whose it is."""

    tenant: str
    kind: Kind
    name: str
    mode: Mode
    label: str
    view: str


@router.post(
    "/shares",
    status_code=201,
    response_model=ShareView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 415, 422, 503),
)
async def create_share(body: ShareRequest, request: Request, gateway: GatewayOf) -> ShareView:
    """Share an asset, a collection or a scene by a link, which needs no login."""
    thing = await _existing_thing(body, request)
    expires = time.time() + body.expires_days * _DAY_S if body.expires_days else None
    store = gateway.access.sharing.store
    share = await gateway.access.authentication.run(
        lambda: store.create(thing, mode=body.mode, label=body.label, expires=expires, password=body.password)
    )
    return await _view(share, request)


@router.get("/shares", response_model=SharePage, dependencies=[needs(Scope.MANAGE)], responses=problems(422))
async def list_shares(
    request: Request,
    gateway: GatewayOf,
    asset: Annotated[str, Query(max_length=100, description="Only of this asset.")] = "",
    collection: Annotated[str, Query(max_length=100, description="Only of this collection.")] = "",
    scene: Annotated[str, Query(max_length=100, description="Only of this scene.")] = "",
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    after: Annotated[str, Query(pattern=f"^({SHARE_ID})?$", description="`next` of the previous page.")] = "",
) -> SharePage:
    """List share links, the oldest first, with those that have ended."""
    store, tenant = gateway.access.sharing.store, caller_of(request).tenant
    kind: Kind | None = "asset" if asset else "collection" if collection else "scene" if scene else None
    found = await gateway.access.authentication.run(
        lambda: store.page(tenant, limit=limit + 1, after=after, kind=kind, name=asset or collection or scene)
    )
    views = [await _view(share, request) for share in found[:limit]]
    return SharePage(shares=views, next=views[-1].id if len(found) > limit else None)


@router.get(
    "/shares/{share}/qr.svg",
    response_class=Response,
    dependencies=[needs(Scope.MANAGE)],
    responses={200: {"content": {"image/svg+xml": {}}}, **problems(404, 422)},
)
async def get_qr_code_of_share(share: ShareId, request: Request, gateway: GatewayOf) -> Response:
    """Get a share link as a QR code (SVG)."""
    found = await gateway.access.authentication.run(lambda: gateway.access.sharing.store.get(share))
    if found is None or found.thing.tenant != caller_of(request).tenant:
        raise _unknown(share)
    return Response(qr_svg((await _view(found, request)).url), media_type="image/svg+xml")


@router.delete(
    "/shares/{share}", response_model=ShareView, dependencies=[needs(Scope.MANAGE)], responses=problems(404, 422)
)
async def revoke_share(share: ShareId, request: Request, gateway: GatewayOf) -> ShareView:
    """Revoke a share link: at once at this gateway, and within a minute everywhere, the CDN included."""
    sharing, tenant = gateway.access.sharing, caller_of(request).tenant
    revoked = await gateway.access.authentication.run(lambda: sharing.store.revoke(share, tenant))
    if revoked is None:
        raise _unknown(share)
    sharing.forget(revoked)
    return await _view(revoked, request)


@router.post(
    "/shares/open",
    response_model=OpenedShareView,
    dependencies=[ANYONE],
    responses=problems(401, 404, 410, 415, 422, 429),
)
async def open_share(body: OpenRequest, request: Request, gateway: GatewayOf, response: Response) -> OpenedShareView:
    """Open a share link: the browser gets a cookie for what it shares."""
    sharing = gateway.access.sharing
    if body.password:
        gateway.access.password_guesses.spend(request, (await sharing.share_of(body.token)).id)
    share, cookie, seconds = await sharing.open(body.token, body.password)
    response.set_cookie(
        COOKIE_PREFIX + share.id,
        cookie,
        max_age=seconds,
        path="/",
        secure=gateway_url(request).startswith("https:"),
        httponly=True,
        samesite="lax",
    )
    thing = share.thing
    view = path_of_tenant(thing.tenant, f"/{_PAGES[thing.kind]}/{thing.name}")
    return OpenedShareView(
        tenant=thing.tenant, kind=thing.kind, name=thing.name, mode=share.mode, label=share.label, view=view
    )


async def _existing_thing(body: ShareRequest, request: Request) -> Thing:
    """Return what is to be shared. Raises Problem where there is no such thing."""
    names: dict[Kind, str] = {"asset": body.asset, "collection": body.collection, "scene": body.scene}
    named = [(kind, name) for kind, name in names.items() if name]
    if len(named) != 1:
        hints = ("send one of them",)
        raise Problem(422, "REQUEST_INVALID", "send either `asset`, `collection` or `scene`", hints=hints)
    ((kind, name),) = named
    store = store_of(request)
    object_name, unknown = _DOCUMENTS[kind]
    try:
        if not valid_key(name):
            raise FileNotFoundError(name)
        await in_thread(lambda: store.head(object_name(name)))
    except FileNotFoundError:
        raise unknown(name) from None
    return Thing(caller_of(request).tenant, kind, name)


async def _view(share: Share, request: Request) -> ShareView:
    token = await gateway_of(request).access.sharing.token(share)
    facts: dict[str, Any] = {name: getattr(share, name) for name in ("id", "mode", "label", "opened")}
    return ShareView(
        **facts,
        kind=share.thing.kind,
        name=share.thing.name,
        has_password=bool(share.password),
        created=utc(share.created),
        expires=utc_or_none(share.expires),
        revoked=utc_or_none(share.revoked),
        ended=share.refusal(time.time()),
        last_opened=utc_or_none(share.last_opened),
        url=urljoin(gateway_url(request), f"s/{token}"),
    )


def _unknown(share: str) -> Problem:
    return Problem(404, "SHARE_ID_UNKNOWN", say("no_share", share=share), hints=("GET /v1/shares lists them",))
