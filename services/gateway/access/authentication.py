"""Authenticate requests: an access key in the `Authorization` header, or a browser's session cookie.

What the database says of a key is cached for `CACHE_S` seconds, so that a key costs a request almost nothing. A revoked
key is refused by every gateway once that has passed.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from cachetools import TTLCache
from itsdangerous import BadSignature, URLSafeTimedSerializer
from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.access.api_key import ENDED, KEY_PATTERN, ApiKey, hash_of
from capture2vr.gateway.access.caller import ALL_SCOPES, Caller
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.errors import Problem
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import DEFAULT_TENANT

CACHE_S = 15.0
"""Seconds for which a key's state is cached: the longest that a revoked key goes on."""
SESSION_S = 30 * 86_400
"""Seconds that a browser's session lasts at most."""
_CACHED_KEYS = 20_000
_THREADS = 2  # queries of the database: a query by a key's hash takes a fraction of a millisecond
_USE_S = 60.0  # between two writes of when keys were used last
_SESSION_SECRET = "session"  # noqa: S105 - the name of the secret, not the secret

_NOT_CACHED = object()  # None is what is cached of a key that does not exist

_T = TypeVar("_T")

_log = logging.getLogger(__name__)

ANONYMOUS = Caller(DEFAULT_TENANT, frozenset(), "anonymous")
_EVERYBODY = Caller(DEFAULT_TENANT, ALL_SCOPES, "open")


class Authentication:
    """Finds out who makes a request. Used on the event loop only.

    told_open  let everybody in, whatever keys there are: the operator has said so
    may_open   let everybody in until the first key is created: only this machine can reach the gateway
    store      tenants and keys
    """

    def __init__(self, store: AccessStore, *, told_open: bool, may_open: bool) -> None:
        self.store = store
        self._told_open = told_open
        self._may_open = may_open
        self._threads = ThreadPoolExecutor(_THREADS, "access")
        self._by_hash: TTLCache[str, ApiKey | None] = TTLCache(_CACHED_KEYS, CACHE_S)
        self._by_id: TTLCache[str, ApiKey | None] = TTLCache(_CACHED_KEYS, CACHE_S)
        self._ended: TTLCache[str, bool] = TTLCache(_CACHED_KEYS, CACHE_S)
        self._keyless_until = 0.0
        self._last_used: dict[str, float] = {}
        self._secrets: dict[str, str] = {}

    async def run(self, work: Callable[[], _T]) -> _T:
        """Run a blocking call of the access store on a thread."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, work)

    async def secret(self, name: str) -> str:
        """Return a secret that all gateways share. It is read once: it never changes."""
        if name not in self._secrets:
            self._secrets[name] = await self.run(lambda: self.store.secret(name))
        return self._secrets[name]

    async def caller(self, authorization: str | None, cookie: str | None) -> Caller:
        """Return who makes a request with this `Authorization` header and session cookie.

        Raises Problem KEY_MALFORMED, KEY_UNKNOWN, KEY_EXPIRED, KEY_REVOKED, SESSION_INVALID, SESSION_ENDED.
        """
        if authorization is not None:
            key = await self._key_of(authorization)
            return self._used(key, Caller(key.tenant, key.scopes, "key", key.id))
        if cookie:
            key = await self._session_key(cookie)
            return self._used(key, Caller(key.tenant, key.scopes, "session", key.id, hash_of(cookie)))
        return _EVERYBODY if await self.is_open() else ANONYMOUS

    async def is_still(self, caller: Caller) -> bool:
        """Return whether who began a long answer, or a long body, may still go on."""
        if not caller.key:
            return True
        if caller.session and await self._has_ended(caller.session):
            return False
        key = await self._cached(self._by_id, caller.key, self.store.key)
        return key is not None and not key.refusal(time.time())

    async def end_session(self, cookie: str) -> None:
        """End the session of a cookie, of which there may be copies."""
        try:
            (await self._serializer()).loads(cookie, max_age=SESSION_S)
        except BadSignature:
            return  # it is none, and is not kept
        sha256 = hash_of(cookie)
        await self.run(lambda: self.store.sessions.end(sha256, time.time() + SESSION_S))
        self._ended[sha256] = True

    async def is_open(self) -> bool:
        """Return whether everybody is let in without a key."""
        if self._told_open or not self._may_open:
            return self._told_open
        now = time.monotonic()
        if now >= self._keyless_until:
            if await self.run(self.store.has_keys):
                self._may_open = False
                _log.info("there are access keys now: from here on this gateway asks for them")
                return False
            self._keyless_until = now + CACHE_S
        return True

    async def sign_session(self, key: ApiKey) -> tuple[str, int]:
        """Return a session cookie for a key, and the seconds for which it is good."""
        seconds = SESSION_S if key.expires is None else min(SESSION_S, int(key.expires - time.time()))
        return str((await self._serializer()).dumps(key.id)), max(0, seconds)

    async def check_secret(self, secret: str) -> ApiKey:
        """Return the key of a secret that somebody typed. Raises Problem as `caller`."""
        return await self._key_of(f"Bearer {secret}")

    def forget(self, key: ApiKey) -> None:
        """Drop a key from the cache: it was changed here, and need not wait for the cache of this gateway."""
        self._by_hash.pop(key.sha256, None)
        self._by_id.pop(key.id, None)

    def created(self) -> None:
        """Invalidate the cached answer to whether there are keys: one was created here."""
        self._keyless_until = 0.0

    async def store_use(self) -> None:
        """Store now and then when keys were used last, until cancelled."""
        while True:
            await asyncio.sleep(_USE_S)
            await self._flush_use()

    async def close(self) -> None:
        """Store when keys were used last, and end the threads."""
        await self._flush_use()
        self._threads.shutdown()

    async def _flush_use(self) -> None:
        used, self._last_used = self._last_used, {}
        if not used:
            return
        try:
            await self.run(lambda: self.store.note_use(used))
        except SQLAlchemyError as error:
            _log.warning("when access keys were used last could not be stored: %s", error)
            self._last_used = {**used, **self._last_used}

    def _used(self, key: ApiKey, caller: Caller) -> Caller:
        self._last_used[key.id] = time.time()
        return caller

    async def _key_of(self, authorization: str) -> ApiKey:
        scheme, _, secret = authorization.partition(" ")
        if scheme.lower() != "bearer" or not KEY_PATTERN.fullmatch(secret.strip()):
            detail = "the Authorization header has no access key: it reads 'Bearer c2v_TENANT_…'"
            raise refused("KEY_MALFORMED", detail)
        sha256 = hash_of(secret.strip())
        return _accepted(await self._cached(self._by_hash, sha256, self.store.key_by_hash))

    async def _session_key(self, cookie: str) -> ApiKey:
        try:
            key_id = str((await self._serializer()).loads(cookie, max_age=SESSION_S))
        except BadSignature:  # altered, signed by another service, or too old
            raise refused("SESSION_INVALID", say("session_cookie_not_valid"), say("log_in_again")) from None
        if await self._has_ended(hash_of(cookie)):
            raise refused("SESSION_ENDED", say("session_was_logged_out"), say("log_in_again"))
        found = await self._cached(self._by_id, key_id, self.store.key)
        try:
            return _accepted(found)
        except Problem as problem:
            raise refused("SESSION_ENDED", say("session_has_ended", why=problem.detail), say("log_in_again")) from None

    async def _has_ended(self, sha256: str) -> bool:
        ended = self._ended.get(sha256)
        if ended is None:
            ended = self._ended[sha256] = await self.run(lambda: self.store.sessions.has_ended(sha256))
        return ended

    async def _cached(
        self, cache: TTLCache[str, ApiKey | None], name: str, read: Callable[[str], ApiKey | None]
    ) -> ApiKey | None:
        found = cache.get(name, _NOT_CACHED)
        if isinstance(found, ApiKey) or found is None:
            return found
        cache[name] = key = await self.run(lambda: read(name))
        return key

    async def _serializer(self) -> URLSafeTimedSerializer:
        return URLSafeTimedSerializer(await self.secret(_SESSION_SECRET), salt="capture2vr session")


def refused(code: str, detail: str, hint: str = "") -> Problem:
    """Return the problem for a request that is not authenticated."""
    hints = (hint or say("operator_makes_keys_with_capture2vr"),)
    return Problem(401, code, detail, hints=hints, headers={"WWW-Authenticate": 'Bearer realm="capture2vr"'})


def _accepted(key: ApiKey | None) -> ApiKey:
    """Return the key if it is good now. Raises Problem."""
    if key is None:
        raise refused("KEY_UNKNOWN", say("access_key_not_known_here"))
    if why := key.refusal(time.time()):
        ended = ENDED[why]
        raise refused(
            f"KEY_{why.upper()}",
            say("access_key", why=say("been_why", why=ended) if why == "revoked" else ended),
        )
    return key
