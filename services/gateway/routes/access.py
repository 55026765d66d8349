"""/v1/session, /v1/pairings, /v1/api-keys: log in, pair devices, create and revoke access keys."""

from __future__ import annotations

import time
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Annotated, Any
from urllib.parse import urljoin

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field

from capture2vr.gateway.access.api_key import ENDED, ApiKey, hash_of
from capture2vr.gateway.access.authentication import Authentication
from capture2vr.gateway.access.caller import Caller, Scope, scope_names
from capture2vr.gateway.access.pairing import CODE_DIGITS, Pairing
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import GatewayOf, gateway_of
from capture2vr.gateway.qr_code import qr_svg
from capture2vr.gateway.routes.access_rules import (
    ANYONE,
    SESSION_COOKIE,
    TENANT_COOKIE,
    authenticate,
    caller_of,
    needs,
)
from capture2vr.gateway.routes.store_access import gateway_url
from capture2vr.gateway.schemas import Label, StrictBody, TenantName, problems
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import TENANT_PATTERN

router = APIRouter(prefix="/v1", tags=["access"])

_DAY_S = 86_400.0
_MOST_DAYS = 3_650
_DEVICE_DAYS = 90  # after which a paired device is paired again

Scopes = Annotated[list[Scope], Field(min_length=1, max_length=len(Scope))]
Days = Annotated[int, Field(strict=True, ge=1, le=_MOST_DAYS)]
KeyId = Annotated[str, Path(max_length=64, pattern=r"^key_[0-9a-f]+$", description="Id of an access key.")]
PairingId = Annotated[str, Path(max_length=64, pattern=r"^pair_[0-9a-f]+$", description="Id of a pairing.")]


class LoginRequest(StrictBody):
    """An access key, typed or pasted into the login page."""

    key: Annotated[str, Field(max_length=200, description="An access key, c2v_TENANT_…")]


class SessionView(BaseModel):
    """Who makes this request. `via`: open (no keys are asked for), key, session or anonymous; `key` is the key's id."""

    tenant: str
    scopes: list[Scope]
    via: str
    key: str

    @classmethod
    def of(cls, caller: Caller) -> SessionView:
        """Convert a caller."""
        return cls(tenant=caller.tenant, scopes=_sorted(caller.scopes), via=caller.via, key=caller.key)


class PairingRequest(StrictBody):
    """A device to be logged in: what it may do, a name for it, and the days after which it has to be paired again."""

    scopes: Scopes
    label: Label = ""
    expires_days: Days = _DEVICE_DAYS


class PairingView(BaseModel):
    """A pairing: `claimed` tells whether a device has used it, before it expires a few minutes after its creation."""

    id: str
    label: str
    scopes: list[Scope]
    expires: datetime
    claimed: bool


class NewPairingView(PairingView):
    """A new pairing: the device opens `url`, which `qr` shows as a QR code (SVG), or types `code` at `/login`."""

    code: str
    url: str
    qr: str


class ClaimRequest(StrictBody):
    """What a device shows to be logged in: the token from the QR code, or the ten digits."""

    token: Annotated[str, Field(max_length=100)] = ""
    code: Annotated[str, Field(pattern=rf"^([0-9]{{{CODE_DIGITS}}})?$")] = ""


class KeyRequest(StrictBody):
    """A new access key. `tenant`: whose, for operators; null: the caller's. `expires_days` null: it never expires."""

    scopes: Scopes
    label: Label = ""
    expires_days: Days | None = None
    tenant: TenantName | None = None


class RotationRequest(StrictBody):
    """How long the old key goes on beside the new one."""

    grace_days: Annotated[int, Field(strict=True, ge=0, le=_MOST_DAYS)] = 1


class KeyView(BaseModel):
    """An access key, without its secret. `last_used` is known to within a minute."""

    id: str
    tenant: str
    label: str
    scopes: list[Scope]
    created: datetime
    expires: datetime | None
    last_used: datetime | None
    revoked: datetime | None

    @classmethod
    def of(cls, key: ApiKey) -> KeyView:
        """Convert a stored access key to the API's answer, without its secret."""
        return cls(**_key_fields(key))


class NewKeyView(KeyView):
    """A new access key with its `secret`, which is shown this once."""

    secret: str


class KeyPage(BaseModel):
    """A page of access keys, oldest first. `next` is the value of `after` for the next page; null on the last page."""

    keys: list[KeyView]
    next: str | None


@router.get("/session", response_model=SessionView, dependencies=[ANYONE], responses=problems(401))
async def get_session(request: Request) -> SessionView:
    """Return who makes this request: tenant, scopes, and whether by a key, a session, or without either."""
    return SessionView.of(await authenticate(request))


@router.post("/session", response_model=SessionView, dependencies=[ANYONE], responses=problems(401, 415, 422))
async def log_in(body: LoginRequest, request: Request, gateway: GatewayOf, response: Response) -> SessionView:
    """Log a browser in with an access key: it gets a session cookie, which scripts cannot read."""
    key = await gateway.access.authentication.check_secret(body.key)
    return SessionView.of(await _set_session(key, request, response))


@router.delete("/session", status_code=204, dependencies=[ANYONE])
async def log_out(request: Request, gateway: GatewayOf) -> Response:
    """Log a browser out: copies of its cookie are refused, too. Its key stays good elsewhere."""
    if cookie := request.cookies.get(SESSION_COOKIE):
        await gateway.access.authentication.end_session(cookie)
    response = Response(status_code=204)
    response.delete_cookie(SESSION_COOKIE, path="/", httponly=True, samesite="lax")
    response.delete_cookie(TENANT_COOKIE, path="/", samesite="lax")
    return response


@router.post(
    "/pairings",
    status_code=201,
    response_model=NewPairingView,
    dependencies=[needs(*Scope)],
    responses=problems(403, 409, 415, 422),
)
async def create_pairing(body: PairingRequest, request: Request, gateway: GatewayOf) -> NewPairingView:
    """Start to pair a device: it gets a key of its own, with scopes that the caller has."""
    caller, authentication = caller_of(request), gateway.access.authentication
    _require_keys(caller)
    _require_own_scopes(caller, body.scopes)
    expires = await _latest(authentication, caller, time.time() + body.expires_days * _DAY_S)
    store, label = authentication.store, body.label or "paired device"
    pairing, token = await authentication.run(
        lambda: store.create_pairing(caller.tenant, body.scopes, label=label, key_expires=expires, parent=caller.key)
    )
    # In the fragment, which browsers send to no server: it stands in no log.
    url = urljoin(gateway_url(request), f"pair#{token}")
    return NewPairingView(**_pairing_fields(pairing), code=pairing.code, url=url, qr=qr_svg(url).decode())


@router.get(
    "/pairings/{pairing}", response_model=PairingView, dependencies=[needs(*Scope)], responses=problems(404, 422)
)
async def get_pairing(pairing: PairingId, request: Request, gateway: GatewayOf) -> PairingView:
    """Get a pairing, to see whether the device has used it."""
    authentication, tenant = gateway.access.authentication, caller_of(request).tenant
    found = await authentication.run(lambda: authentication.store.pairing(pairing, tenant))
    if found is None:
        raise Problem(404, "PAIRING_UNKNOWN", say("no_pairing", pairing=pairing), hints=(say("start_new"),))
    return PairingView(**_pairing_fields(found))


@router.post(
    "/pairings/claim", response_model=SessionView, dependencies=[ANYONE], responses=problems(404, 415, 422, 429)
)
async def claim_pairing(body: ClaimRequest, request: Request, gateway: GatewayOf, response: Response) -> SessionView:
    """Log this device in by a pairing's token or code. Each works once, for a few minutes."""
    if bool(body.token) == bool(body.code):
        raise Problem(422, "REQUEST_INVALID", "send either `token` or `code`", hints=(say("open_link_again"),))
    authentication = gateway.access.authentication
    if body.code:
        gateway.access.code_guesses.spend(request)
    claimed = await authentication.run(lambda: authentication.store.claim_pairing(token=body.token, code=body.code))
    if claimed is None:
        detail = say("code_wrong_used_has_expired")
        raise Problem(404, "PAIRING_UNKNOWN", detail, hints=(say("show_new_code_on_other"),))
    key, _ = claimed
    return SessionView.of(await _set_session(key, request, response))


@router.post(
    "/api-keys",
    status_code=201,
    response_model=NewKeyView,
    dependencies=[needs(Scope.MANAGE, Scope.OPERATE)],
    responses=problems(403, 404, 409, 415, 422),
)
async def create_key(body: KeyRequest, request: Request, gateway: GatewayOf) -> NewKeyView:
    """Create an access key. Its secret is in this answer and nowhere else."""
    caller, authentication = caller_of(request), gateway.access.authentication
    _require_keys(caller)
    tenant = _tenant_for(caller, body.tenant)
    _require_own_scopes(caller, body.scopes)
    if await authentication.run(lambda: authentication.store.tenant(tenant)) is None:
        raise Problem(404, "TENANT_UNKNOWN", say("no_tenant", tenant=tenant), hints=("POST /v1/tenants creates it",))
    wanted = time.time() + body.expires_days * _DAY_S if body.expires_days else None
    expires = await _latest(authentication, caller, wanted)
    return await _new_key(authentication, tenant, body.scopes, body.label, expires)


@router.get(
    "/api-keys",
    response_model=KeyPage,
    dependencies=[needs(Scope.MANAGE, Scope.OPERATE)],
    responses=problems(403, 422),
)
async def list_keys(
    request: Request,
    gateway: GatewayOf,
    tenant: Annotated[
        str, Query(pattern=rf"^(\*|{TENANT_PATTERN})?$", description="Whose, for operators; * for all; empty: own.")
    ] = "",
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    after: Annotated[str, Query(pattern=r"^(key_[0-9a-f]{1,60})?$", description="`next` of the previous page.")] = "",
) -> KeyPage:
    """List access keys, the oldest first, with those that were revoked or have expired."""
    caller, authentication = caller_of(request), gateway.access.authentication
    wanted = None if tenant == "*" and Scope.OPERATE in caller.scopes else _tenant_for(caller, tenant or None)
    found = await authentication.run(lambda: authentication.store.list_keys(wanted, limit=limit + 1, after=after))
    keys = [KeyView.of(key) for key in found[:limit]]
    return KeyPage(keys=keys, next=keys[-1].id if len(found) > limit else None)


@router.post(
    "/api-keys/{key}/revoke",
    response_model=KeyView,
    dependencies=[needs(Scope.MANAGE, Scope.OPERATE)],
    responses=problems(404, 422),
)
async def revoke_key(key: KeyId, request: Request, gateway: GatewayOf) -> KeyView:
    """Revoke an access key that allows no more than the caller's own: within a minute it is refused everywhere, its
    browser sessions and open streams end, and so do the devices that were paired with it."""
    caller, authentication = caller_of(request), gateway.access.authentication
    await _key_to_end(authentication, caller, key)
    revoked = await authentication.run(lambda: authentication.store.revoke_key(key, _reach(caller)))
    if revoked is None:
        raise _unknown_key(key)
    authentication.forget(revoked)
    return KeyView.of(revoked)


@router.post(
    "/api-keys/{key}/rotate",
    status_code=201,
    response_model=NewKeyView,
    dependencies=[needs(Scope.MANAGE, Scope.OPERATE)],
    responses=problems(403, 404, 409, 415, 422),
)
async def rotate_key(key: KeyId, body: RotationRequest, request: Request, gateway: GatewayOf) -> NewKeyView:
    """Replace an access key by a new one with the same scopes; the old one goes on for the days of grace."""
    caller, authentication = caller_of(request), gateway.access.authentication
    store = authentication.store
    old = await _key_to_end(authentication, caller, key)
    if why := old.refusal(time.time()):
        raise Problem(
            409, f"KEY_{why.upper()}", say("key_has_ended", key=key, why=ENDED[why]), hints=(say("create_new_key"),)
        )
    expires = await _latest(authentication, caller, old.expires)
    new = await _new_key(authentication, old.tenant, old.scopes, old.label, expires, replaces=old)
    await authentication.run(lambda: store.expire_key(key, old.tenant, time.time() + body.grace_days * _DAY_S))
    authentication.forget(old)
    return new


async def _new_key(
    authentication: Authentication,
    tenant: str,
    scopes: Iterable[Scope],
    label: str,
    expires: float | None,
    replaces: ApiKey | None = None,
) -> NewKeyView:
    key, secret = await authentication.run(
        lambda: authentication.store.create_key(tenant, scopes, label=label, expires=expires, replaces=replaces)
    )
    return NewKeyView(**_key_fields(key), secret=secret)


async def _set_session(key: ApiKey, request: Request, response: Response) -> Caller:
    """Give the browser a session cookie; return who it is from now on, also for the audit log."""
    cookie, seconds = await gateway_of(request).access.authentication.sign_session(key)
    secure = gateway_url(request).startswith("https:")
    response.set_cookie(
        SESSION_COOKIE,
        cookie,
        max_age=seconds,
        path="/",
        secure=secure,
        httponly=True,
        samesite="lax",  # not strict: the link in a QR code is opened from elsewhere
    )
    # Pages name their caches by it, also without the server. It grants nothing.
    response.set_cookie(TENANT_COOKIE, key.tenant, max_age=seconds, path="/", secure=secure, samesite="lax")
    request.state.caller = caller = Caller(key.tenant, key.scopes, "session", key.id, hash_of(cookie))
    return caller


async def _latest(authentication: Authentication, caller: Caller, wanted: float | None) -> float | None:
    """Return the expiry of a key that a caller creates: not after that of its own key, unless it may operate."""
    own = await authentication.run(lambda: authentication.store.key(caller.key)) if caller.key else None
    if Scope.OPERATE in caller.scopes or own is None or own.expires is None:
        return wanted
    return own.expires if wanted is None else min(wanted, own.expires)


def _tenant_for(caller: Caller, wanted: str | None) -> str:
    """Return the tenant that a caller names, or its own. Raises Problem for another's, unless the caller operates."""
    if wanted is None or wanted == caller.tenant or Scope.OPERATE in caller.scopes:
        return wanted or caller.tenant
    detail = say("another_tenant_keys_callers")
    raise Problem(403, "SCOPE_MISSING", detail, hints=("leave `tenant` out",))


def _reach(caller: Caller) -> str | None:
    """Return the tenant whose keys the caller manages; None: all."""
    return None if Scope.OPERATE in caller.scopes else caller.tenant


async def _key_to_end(authentication: Authentication, caller: Caller, key: str) -> ApiKey:
    """Return a key that the caller may revoke or replace. Raises Problem where there is none, or it allows more."""
    found = await authentication.run(lambda: authentication.store.key(key))
    if found is None or _reach(caller) not in (None, found.tenant):
        raise _unknown_key(key)
    _require_own_scopes(caller, found.scopes)
    return found


def _require_own_scopes(caller: Caller, scopes: Iterable[Scope]) -> None:
    """Raises Problem where a key would allow more than the caller's own."""
    if Scope.OPERATE in caller.scopes:
        return
    if beyond := set(scopes) - caller.scopes:
        detail = say("new_key_cannot_have_scope", scope=", ".join(scope_names(beyond)))
        raise Problem(403, "SCOPE_MISSING", detail, hints=(say("ask_fewer_scopes"),))


def _require_keys(caller: Caller) -> None:
    """Raises Problem at a gateway that is open: the first key closes it, and must not be lost in an answer."""
    if caller.via == "open":
        detail = say("gateway_asks_no_keys_yet")
        raise Problem(409, "GATEWAY_OPEN", detail, hints=("run `capture2vr keys create` there",))


def _unknown_key(key: str) -> Problem:
    return Problem(404, "KEY_ID_UNKNOWN", say("no_access_key", key=key), hints=("GET /v1/api-keys lists them",))


def _key_fields(key: ApiKey) -> dict[str, Any]:
    return {
        "id": key.id,
        "tenant": key.tenant,
        "label": key.label,
        "scopes": _sorted(key.scopes),
        "created": utc(key.created),
        "expires": utc_or_none(key.expires),
        "last_used": utc_or_none(key.last_used),
        "revoked": utc_or_none(key.revoked),
    }


def _pairing_fields(pairing: Pairing) -> dict[str, Any]:
    return {
        "id": pairing.id,
        "label": pairing.label,
        "scopes": _sorted(pairing.scopes),
        "expires": utc(pairing.expires),
        "claimed": bool(pairing.key),
    }


def _sorted(scopes: Iterable[Scope]) -> list[Scope]:
    return [Scope(name) for name in scope_names(scopes)]


def utc(seconds: float) -> datetime:
    """Convert seconds since the epoch."""
    return datetime.fromtimestamp(seconds, UTC)


def utc_or_none(seconds: float | None) -> datetime | None:
    """Convert seconds since the epoch; None stays None."""
    return None if seconds is None else utc(seconds)
