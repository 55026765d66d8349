"""Access rules of routes that read one asset, collection, scene or file: its tenant may, and others as its visibility
and shares allow.

The rule finds out whose thing a request names and refuses who may not read it; the handler then asks `reading_of`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Query, Request

from capture2vr.gateway.access.authentication import ANONYMOUS
from capture2vr.gateway.access.caller import Caller, Scope
from capture2vr.gateway.access.readers import Kind, Readers, ReadersCache, Thing
from capture2vr.gateway.access.shares import Share
from capture2vr.gateway.access.sharing import SCHEME, ended
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import gateway_of
from capture2vr.gateway.routes.access_rules import Rule, authenticate, caller_of, missing_scope
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.visibility import Visibility, is_open
from capture2vr.storage.store import NO_CACHE
from capture2vr.storage.tenant_store import TENANT_PATTERN, tenant_of

ANY_ORIGIN = {"Access-Control-Allow-Origin": "*", "Access-Control-Expose-Headers": "ETag, Content-Range, Accept-Ranges"}
"""CORS headers of answers that pages of any origin may read."""
_PRIVATE_FILE = "private, no-cache"  # kept by the browser alone, which asks before every use whether it still may

TenantQuery = Annotated[
    str,
    Query(pattern=rf"^({TENANT_PATTERN})?$", description="Whose it is, for readers of others; empty: the caller's."),
]


@dataclass(frozen=True, slots=True)
class Reading:
    """What a request reads, and how.

    visibility   the one that holds
    is_own       whether it is of the caller's own tenant
    collections  those that list an asset and that the caller may read
    may_place    whether the viewer lets the caller move it about
    by           id of the share or of the access key that opens it; "" where neither does
    """

    thing: Thing
    visibility: Visibility
    is_own: bool
    collections: tuple[str, ...] = ()
    may_place: bool = True
    by: str = ""

    @property
    def cors_headers(self) -> dict[str, str]:
        """The CORS headers of the answer: only of what is public may other sites' pages read anything."""
        return dict(ANY_ORIGIN) if self.visibility is Visibility.PUBLIC else {}

    def cache_control(self, control: str) -> str:
        """Return the answer's Cache-Control: `control` where others may read it too."""
        if is_open(self.visibility):
            return control
        return f"private, {NO_CACHE}" if control == NO_CACHE else _PRIVATE_FILE


class _ReadRule(Rule):
    """A dependency that authenticates the request and checks whether the caller may read what it names."""

    def __init__(self, unknown: Callable[[str], Problem]) -> None:
        super().__init__(frozenset({Scope.READ}))
        self._unknown = unknown

    async def _check(self, request: Request, thing_for: Callable[[str], Thing]) -> None:
        """Check the caller against the thing, which `thing_for` returns for the caller's tenant. Raises Problem."""
        caller, refusal = await _caller_or_refusal(request)
        request.state.rate_limit = await gateway_of(request).access.limits.spend(caller)
        request.state.reading = await self._reading(request, thing_for(caller.tenant), caller, refusal)

    async def check_again(self, request: Request) -> None:
        """Check whether who began to read something still may, and how. Raises Problem."""
        caller, refusal = await _caller_or_refusal(request)
        request.state.reading = await self._reading(request, reading_of(request).thing, caller, refusal)

    async def _reading(self, request: Request, thing: Thing, caller: Caller, refusal: Problem | None) -> Reading:
        """Return what the request reads. refusal: of the caller's key or session. Raises Problem."""
        readers = gateway_of(request).access.readers
        found = await readers.of(thing)
        is_own = thing.tenant == caller.tenant and Scope.READ in caller.scopes
        by_default = Visibility.PUBLIC if caller.via == "open" and is_own else Visibility.PRIVATE
        visibility = found.visibility or by_default
        share = None
        if not is_own and not is_open(visibility):
            share = await self._share_of(request, thing, found)
            if share is None:
                raise refusal or self._refusal(caller, thing)
        collections = found.collections if is_own else await _readable(readers, thing, found, share)
        may_place = share is None or share.mode == "place"
        return Reading(thing, visibility, is_own, collections, may_place, by=share.id if share else caller.key)

    async def _share_of(self, request: Request, thing: Thing, found: Readers) -> Share | None:
        """Return a share that opens the thing for this request. Raises Problem for one that did until it ended."""
        access = gateway_of(request).access
        shown = await access.sharing.shown(request.headers.get("authorization"), request.cookies)
        opening = [share for share in shown if await _opens(share, thing, found, access.readers)]
        problems = [ended(share) for share in opening]
        for share, problem in zip(opening, problems, strict=True):
            if problem is None:
                return share
        if problems and problems[0]:
            raise problems[0]
        return None

    def _refusal(self, caller: Caller, thing: Thing) -> Problem:
        """Return the problem for somebody who may not read a thing, whether it exists or not."""
        if caller.via == "anonymous" or thing.tenant == caller.tenant:
            return missing_scope(caller, self.scopes)
        return self._unknown(thing.name)


def reading_of(request: Request) -> Reading:
    """Return what a request reads, whose route has one of the rules below."""
    reading: Reading = request.state.reading
    return reading


def reads_tenant(request: Request) -> str:
    """Return the tenant whose things a request reads or changes."""
    reading: Reading | None = getattr(request.state, "reading", None)
    return reading.thing.tenant if reading else caller_of(request).tenant


def unknown_asset(key: str) -> Problem:
    """Return the problem for an asset that there is not, or not for this caller."""
    hints = (say("check_key"), say("first_job_may_still"))
    return Problem(404, "ASSET_UNKNOWN", say("no_asset", key=key), hints=hints)


def unknown_collection(name: str) -> Problem:
    """Return the problem for a collection that there is not, or not for this caller."""
    hints = (say("check_name"), say("publishing_first_asset_creates"))
    return Problem(404, "COLLECTION_UNKNOWN", say("no_collection", name=name), hints=hints)


def unknown_scene(scene: str) -> Problem:
    """Return the problem for a scene that there is not, or not for this caller."""
    hints = (say("check_id"), say("may_have_been_deleted"))
    return Problem(404, "SCENE_UNKNOWN", say("no_scene", scene=scene), hints=hints)


def unknown_file(_: str = "") -> Problem:
    """Return the problem for a file that there is not, or not for this caller."""
    hints = ("GET /v1/assets/{key} lists the URLs of an asset's files",)
    return Problem(404, "FILE_UNKNOWN", say("no_such_file"), hints=hints)


def thing_of_file(name: str) -> Thing:
    """Return the asset or the collection that an object of the whole store belongs to.

    Raises Problem FILE_UNKNOWN for one that no reader ever gets: captures show people's rooms, and of entries
    /v1/assets returns the public part.
    """
    try:
        tenant, own_name = tenant_of(name)
    except ValueError:
        raise unknown_file() from None
    folder, _, rest = own_name.partition("/")
    key, _, file = rest.partition("/")
    if folder not in ("assets", "collections") or not file:
        raise unknown_file()
    return Thing(tenant, "asset" if folder == "assets" else "collection", key)


async def _caller_or_refusal(request: Request) -> tuple[Caller, Problem | None]:
    """Return the caller; for a key or a session that is refused nobody, and the refusal: public things are for all."""
    if request.headers.get("authorization", "").lower().startswith(f"{SCHEME} "):
        return ANONYMOUS, None
    try:
        return await authenticate(request), None
    except Problem as refusal:
        request.state.caller = ANONYMOUS
        return ANONYMOUS, refusal


async def _readable(readers: ReadersCache, thing: Thing, found: Readers, share: Share | None) -> tuple[str, ...]:
    """Return those of an asset's collections that a visitor may read too."""
    named = {name: await readers.of(Thing(thing.tenant, "collection", name)) for name in found.collections}
    shared = share.thing.name if share and share.thing.kind == "collection" else ""
    return tuple(name for name, each in named.items() if is_open(each.visibility) or name == shared)


async def _opens(share: Share, thing: Thing, found: Readers, readers: ReadersCache) -> bool:
    """Return whether a share is one of the thing, of a scene that it stands in, or of a collection that lists it."""
    if share.thing == thing:
        return True
    if share.thing.tenant != thing.tenant or share.thing.kind == "asset" or thing.kind != "asset":
        return False
    if share.thing.kind == "scene":
        return thing.name in (await readers.of(share.thing)).assets
    # An open collection does not list what is private.
    return share.thing.name in found.collections and not is_open((await readers.of(share.thing)).visibility)


class _NamedRule(_ReadRule):
    """Of a route whose path names an asset, a collection or a scene of the caller's tenant, or of the query's."""

    def __init__(self, kind: Kind, parameter: str, unknown: Callable[[str], Problem]) -> None:
        super().__init__(unknown)
        self._kind = kind
        self._parameter = parameter

    async def __call__(self, request: Request, tenant: TenantQuery = "") -> None:
        name = request.path_params[self._parameter]
        await self._check(request, lambda own_tenant: Thing(tenant or own_tenant, self._kind, name))


class _FileRule(_ReadRule):
    """Of a route whose path names an object of the whole store, and with it the tenant."""

    async def __call__(self, request: Request) -> None:
        await self._check(request, lambda _: thing_of_file(request.path_params["name"]))


class _FolderRule(_ReadRule):
    """Of the route that a proxy asks before it answers by itself: every refusal is 401, which nginx passes on."""

    async def __call__(self, request: Request) -> None:
        try:
            await self._check(request, lambda _: thing_of_file(f"{request.path_params['folder']}/x"))
        except Problem as problem:
            if problem.status == 429:
                raise
            headers = {"WWW-Authenticate": 'Bearer realm="capture2vr"'}
            raise Problem(401, problem.code, problem.detail, hints=problem.hints, headers=headers) from None


READS_ASSET: Any = Depends(_NamedRule("asset", "key", unknown_asset))
"""The dependency of a route that reads the asset `key`."""
READS_COLLECTION: Any = Depends(_NamedRule("collection", "name", unknown_collection))
"""The dependency of a route that reads the collection `name`."""
_SCENE_RULE = _NamedRule("scene", "scene", unknown_scene)
READS_SCENE: Any = Depends(_SCENE_RULE)
"""The dependency of a route that reads the scene `scene`."""
still_reads_scene = _SCENE_RULE.check_again
"""Check whether who began to read a scene still may: await it with the request. Raises Problem."""
READS_FILE: Any = Depends(_FileRule(unknown_file))
"""The dependency of a route that reads the object `name` of the whole store."""
READS_FOLDER: Any = Depends(_FolderRule(unknown_file))
"""The dependency of a route that tells whether the objects in `folder` of the whole store may be read."""
