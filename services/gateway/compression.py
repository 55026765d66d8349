"""Compress answers that are text: pages, scripts, style sheets and JSON; in one place, whatever proxy stands before.

Streams of events are not compressed, because an event must not wait for more of them; nor what has its own compression,
such as pictures, meshes and archives. An answer that may be fetched in parts (Accept-Ranges) loses that and its strong
ETag once it is compressed: bytes of two encodings must not be joined.

Compressed lengths can tell a secret that stands beside text of an attacker's choice (BREACH). Here none does: new keys
and links are answers to POST, which are not compressed; an error repeats names of the request, but holds no secret; and
the session's cookie (SameSite) does not come with what other sites' pages load.
"""

from __future__ import annotations

from starlette.datastructures import MutableHeaders
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_LEVEL = 6  # scripts become four times smaller; 9 takes three times as long for a hundredth of the bytes
_LEAST_BYTES = 500
_COMPRESSED_ALREADY = (
    *DEFAULT_EXCLUDED_CONTENT_TYPES,
    "application/octet-stream",
    "image/heic",
    "image/ktx2",
    "image/tiff",
    "model/*",
)


class Compression:
    """Compresses answers to GET, for clients that accept gzip."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._compressing = GZipMiddleware(
            app, _LEAST_BYTES, compresslevel=_LEVEL, exclude_content_types=_COMPRESSED_ALREADY
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_whole(message: Message) -> None:
            if message["type"] == "http.response.start":
                _forbid_parts(MutableHeaders(scope=message))
            await send(message)

        if scope["type"] == "http" and scope["method"] == "GET":
            await self._compressing(scope, receive, send_whole)
        else:
            await self._app(scope, receive, send)


def _forbid_parts(headers: MutableHeaders) -> None:
    """Take from a compressed answer what invites a client to fetch the rest of it later."""
    if "content-encoding" not in headers or "accept-ranges" not in headers:
        return
    del headers["accept-ranges"]
    if (etag := headers.get("etag", "")).startswith('"'):
        headers["etag"] = f"W/{etag}"
