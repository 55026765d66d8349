"""Share links on the command line: open one, and read what it shares."""

from __future__ import annotations

import os
from dataclasses import dataclass
from urllib.parse import urlsplit

import httpx

from capture2vr.client.answers import parse_answer
from capture2vr.errors import BadInput

PASSWORD_VARIABLE = "CAPTURE2VR_SHARE_PASSWORD"  # noqa: S105 - the name of the variable
"""Environment variable of a share's password: on a command line everybody on the machine could read it."""


@dataclass(frozen=True, slots=True)
class SharedThing:
    """What a link opened: an asset, a collection or a scene of a tenant."""

    tenant: str
    kind: str
    name: str


def split_link(link: str) -> tuple[str, str]:
    """Return the gateway's URL and the token of a share link. Raises BadInput."""
    try:
        parts = urlsplit(link)
    except ValueError:  # a bracket that is not closed
        parts = urlsplit("")
    path, _, token = parts.path.rpartition("/")
    if parts.scheme not in ("http", "https") or not parts.netloc or not path.endswith("/s") or not token:
        raise BadInput(f"'{link}' is not a share link: it reads https://…/s/shr_…")
    return f"{parts.scheme}://{parts.netloc}{path.removesuffix('/s')}", token


def open_link(client: httpx.Client, token: str) -> SharedThing:
    """Open a share link at its gateway; the client's cookies then let it read what is shared. Raises BadInput."""
    body = {"token": token, "password": os.environ.get(PASSWORD_VARIABLE, "")}
    opened = parse_answer(client.post("/v1/shares/open", json=body))
    return SharedThing(str(opened["tenant"]), str(opened["kind"]), str(opened["name"]))
