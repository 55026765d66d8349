"""Open share links: check their tokens and passwords, and what a visitor's cookies or header let it read.

A token is the share's id with a signature, so that it is stored nowhere and its link can be shown again. What the
database says of a share is cached for `CACHE_S` seconds: the longest that a revoked one goes on at another gateway.
"""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Mapping

from cachetools import TTLCache
from itsdangerous import BadSignature, Signer, URLSafeTimedSerializer

from capture2vr.gateway.access.authentication import CACHE_S, SESSION_S, Authentication, refused
from capture2vr.gateway.access.shares import SHARE_ID, Share, ShareStore
from capture2vr.gateway.errors import Problem
from capture2vr.sentences.sentence import say

COOKIE_PREFIX = "c2v_share_"
"""Prefix of the cookies of opened shares: each has one of its own, named by its id."""
SCHEME = "share"
"""Scheme of the `Authorization` header with a share's token, in lower case."""
_SECRET = "share"  # noqa: S105 - the name of the secret, not the secret
_CACHED = 20_000
_MOST_COOKIES = 20  # that are looked at: somebody with more shares has the newest ones
_TOKEN = re.compile(rf"(?P<id>{SHARE_ID})\.[A-Za-z0-9_-]{{43}}", re.ASCII)


class Sharing:
    """Opens share links. Used on the event loop only. store: all shares"""

    def __init__(self, store: ShareStore, authentication: Authentication) -> None:
        self.store = store
        self._authentication = authentication
        self._cached: TTLCache[str, Share] = TTLCache(_CACHED, CACHE_S)

    async def token(self, share: Share) -> str:
        """Return the token of a share, which its link ends with."""
        return (await self._signer()).sign(share.id).decode()

    async def share_of(self, token: str) -> Share:
        """Return the share of a token. Raises Problem SHARE_UNKNOWN, SHARE_REVOKED, SHARE_EXPIRED."""
        try:
            found = await self._share((await self._signer()).unsign(token).decode())
        except (BadSignature, UnicodeError):
            found = None
        if found is None:
            raise _unknown()
        return _accepted(found)

    async def open(self, token: str, password: str) -> tuple[Share, str, int]:
        """Open a share and count it; return it, the value of its cookie, and the seconds for which that is good.

        Raises Problem as `share_of`, SHARE_PASSWORD_MISSING, SHARE_PASSWORD_WRONG.
        """
        share = await self.share_of(token)
        if share.password and not password:
            raise _refused("SHARE_PASSWORD_MISSING", say("shared_with_password"))
        if share.password and not await self._authentication.run(lambda: share.has_password(password)):
            raise _refused("SHARE_PASSWORD_WRONG", say("password_wrong"))
        await self._authentication.run(lambda: self.store.count(share.id))
        seconds = SESSION_S if share.expires is None else min(SESSION_S, int(share.expires - time.time()) + 1)
        return share, str((await self._serializer()).dumps(share.id)), seconds

    async def shown(self, authorization: str | None, cookies: Mapping[str, str]) -> list[Share]:
        """Return the shares that a request shows, also ended ones: by its header, or by the cookies of opened ones.

        Raises Problem SHARE_UNKNOWN, SHARE_PASSWORD_MISSING for a header's token.
        """
        if authorization is not None and authorization.lower().startswith(f"{SCHEME} "):
            return [await self._of_header(authorization.partition(" ")[2].strip())]
        named = [value for name, value in cookies.items() if name.startswith(COOKIE_PREFIX)][:_MOST_COOKIES]
        found = [await self._of_cookie(value) for value in named]
        return [share for share in found if share is not None]

    def forget(self, share: Share) -> None:
        """Drop a share from the cache: it was changed here."""
        self._cached.pop(share.id, None)

    async def _of_header(self, token: str) -> Share:
        try:
            share = await self.share_of(token)
        except Problem as problem:
            raise refused(problem.code, problem.detail, say("ask_new_link")) from None
        if share.password:
            raise refused("SHARE_PASSWORD_MISSING", say("shared_with_password"), "POST /v1/shares/open takes it")
        return share

    async def _of_cookie(self, value: str) -> Share | None:
        try:
            return await self._share(str((await self._serializer()).loads(value, max_age=SESSION_S)))
        except BadSignature:
            return None

    async def _share(self, share_id: str) -> Share | None:
        found = self._cached.get(share_id)
        if found is None:
            found = await self._authentication.run(lambda: self.store.get(share_id))
            if found is not None:
                self._cached[share_id] = found
        return found

    async def _signer(self) -> Signer:
        return Signer(await self._authentication.secret(_SECRET), salt="capture2vr share", digest_method=hashlib.sha256)

    async def _serializer(self) -> URLSafeTimedSerializer:
        return URLSafeTimedSerializer(await self._authentication.secret(_SECRET), salt="capture2vr opened share")


def mask_shares(text: str) -> str:
    """Replace the signature of every share's token in a text, for logs."""
    return _TOKEN.sub(r"\g<id>.…", text)


def ended(share: Share) -> Problem | None:
    """Return the problem for a share that has been revoked or has expired; None for a good one."""
    why = share.refusal(time.time())
    if not why:
        return None
    detail = say("shared_link", why=say("taken_back") if why == "revoked" else say("has_expired"))
    return Problem(410, f"SHARE_{why.upper()}", detail, hints=(say("ask_whoever_shared_new_link"),))


def _accepted(share: Share) -> Share:
    if problem := ended(share):
        raise problem
    return share


def _refused(code: str, detail: str) -> Problem:
    return Problem(401, code, detail, hints=(say("type_password_came_with_link"),))


def _unknown() -> Problem:
    return Problem(404, "SHARE_UNKNOWN", say("no_such_share_link"), hints=(say("check_link_complete"),))
