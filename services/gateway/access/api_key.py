"""Access keys: `c2v_<tenant>_<secret>`, of which only the SHA-256 is stored.

A fast hash suffices: the secret is 256 random bits, which nobody can search for, unlike a password.
"""

from __future__ import annotations

import hashlib
import re
import secrets
from dataclasses import dataclass

from capture2vr.gateway.access.caller import Scope
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import TENANT_PATTERN

_SECRET_BYTES = 32
KEY_PATTERN = re.compile(rf"c2v_(?P<tenant>{TENANT_PATTERN})_[A-Za-z0-9_-]{{43}}", re.ASCII)
"""A whole key. It begins with the product's name, so that scanners of leaked secrets find it."""


ENDED = {"revoked": say("word_revoked"), "expired": say("word_expired")}
"""Words for why a key is refused, by `ApiKey.refusal`."""


@dataclass(frozen=True, slots=True)
class ApiKey:
    """What is stored of a key. Times are seconds since the epoch.

    expires    the key is refused from then on; None: never
    last_used  to within a minute; None: never
    revoked    when it was revoked, or None
    parent     id of the key that the device was paired with, which ends this one too; None: of a key of its own
    """

    id: str
    tenant: str
    label: str
    sha256: str
    scopes: frozenset[Scope]
    created: float
    expires: float | None = None
    last_used: float | None = None
    revoked: float | None = None
    parent: str | None = None

    def refusal(self, now: float) -> str:
        """Return why the key is refused now: "revoked" or "expired"; "" where it is good."""
        if self.revoked is not None:
            return "revoked"
        return "expired" if self.expires is not None and self.expires <= now else ""


def new_secret(tenant: str) -> str:
    """Make a new key for a tenant."""
    return f"c2v_{tenant}_{secrets.token_urlsafe(_SECRET_BYTES)}"


def hash_of(secret: str) -> str:
    """Return the hash under which a key, or a pairing's token, is stored."""
    return hashlib.sha256(secret.encode()).hexdigest()


def mask_keys(text: str) -> str:
    """Replace every access key in a text, for logs."""
    return KEY_PATTERN.sub(lambda found: f"c2v_{found['tenant']}_…", text)
