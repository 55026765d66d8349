"""Headers of tus 1.0.0 (https://tus.io/protocols/resumable-upload): parsed, checked, and written.

The core protocol with the extensions creation, creation-with-upload, termination, checksum and expiration.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from email.utils import formatdate
from typing import Any

from starlette.datastructures import Headers

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.resumable.store import Upload
from capture2vr.order.one_line import one_line
from capture2vr.sentences.sentence import say

VERSION = "1.0.0"
EXTENSIONS = "creation,creation-with-upload,termination,checksum,expiration"
MEDIA_TYPE = "application/offset+octet-stream"
CAPTURE_HEADER = "Upload-Capture"
"""Our own header: the id of the capture that a finished upload became."""
REQUEST_HEADERS = (
    "Tus-Resumable",
    "Upload-Checksum",
    "Upload-Length",
    "Upload-Metadata",
    "Upload-Offset",
    "X-HTTP-Method-Override",
)
"""What a page of another origin may send."""
ANSWER_HEADERS = (
    "Tus-Checksum-Algorithm",
    "Tus-Extension",
    "Tus-Max-Size",
    "Tus-Resumable",
    "Tus-Version",
    CAPTURE_HEADER,
    "Upload-Expires",
    "Upload-Length",
    "Upload-Metadata",
    "Upload-Offset",
)
"""What a page of another origin may read."""

_ALGORITHMS = ("sha1", "sha256")
_METADATA_BYTES = 4096  # of the header
_METADATA_KEY = re.compile(r"[^\s,]{1,100}")
_CHECKSUM_MISMATCH = 460  # of tus' own; no number of HTTP's
_MOST_DIGITS = 18  # of a number of bytes: more than any disk holds


@dataclass(frozen=True, slots=True)
class Checksum:
    """The checksum that a client has told of a request's body."""

    algorithm: str
    digest: bytes

    def hasher(self) -> Any:
        """Return a new hash object of hashlib."""
        return hashlib.new(self.algorithm, usedforsecurity=False)

    def check(self, digest: bytes) -> None:
        """Raises Problem UPLOAD_CHECKSUM where the body has another one."""
        if digest != self.digest:
            detail = say("body_not_one_in_upload", algorithm=self.algorithm)
            title = "Checksum Mismatch"
            raise Problem(_CHECKSUM_MISMATCH, "UPLOAD_CHECKSUM", detail, retryable=True).titled(title)


def require_version(headers: Headers) -> None:
    """Raises Problem TUS_VERSION for a request that does not speak this version of tus."""
    if headers.get("tus-resumable") != VERSION:
        hints = (f"send Tus-Resumable: {VERSION}",)
        answer = {"Tus-Version": VERSION}
        raise Problem(412, "TUS_VERSION", "the header Tus-Resumable is missing or another", hints=hints, headers=answer)


def require_media_type(headers: Headers) -> None:
    """Raises Problem UPLOAD_MEDIA_TYPE for a body that is no part of an upload."""
    if headers.get("content-type", "").partition(";")[0].strip().lower() != MEDIA_TYPE:
        hints = (f"send Content-Type: {MEDIA_TYPE}",)
        raise Problem(415, "UPLOAD_MEDIA_TYPE", "the Content-Type is not that of a part of an upload", hints=hints)


def parse_bytes(headers: Headers, name: str) -> int:
    """Parse a header that is a number of bytes. Raises Problem UPLOAD_HEADER."""
    text = headers.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS):
        raise _bad_header(f"the header {name} must be a number of bytes")
    return int(text)


def parse_checksum(headers: Headers) -> Checksum | None:
    """Parse Upload-Checksum; None where there is none. Raises Problem UPLOAD_HEADER."""
    text = headers.get("upload-checksum")
    if text is None:
        return None
    algorithm, _, encoded = text.strip().partition(" ")
    if algorithm not in _ALGORITHMS:
        raise _bad_header(f"the algorithm of Upload-Checksum must be one of {', '.join(_ALGORITHMS)}")
    digest = _decode(encoded.strip(), "Upload-Checksum")
    if len(digest) != hashlib.new(algorithm, usedforsecurity=False).digest_size:
        raise _bad_header(f"Upload-Checksum is no {algorithm} in Base64")
    return Checksum(algorithm, digest)


def parse_metadata(headers: Headers) -> dict[str, str]:
    """Parse Upload-Metadata: pairs of a name and a value in Base64. Raises Problem UPLOAD_HEADER."""
    text = headers.get("upload-metadata", "")
    if len(text) > _METADATA_BYTES:
        raise _bad_header(f"the header Upload-Metadata has more than {_METADATA_BYTES:,} bytes")
    found: dict[str, str] = {}
    for pair in filter(None, map(str.strip, text.split(","))):
        name, _, encoded = pair.partition(" ")
        if not _METADATA_KEY.fullmatch(name) or not name.isascii() or name in found:
            raise _bad_header("Upload-Metadata has a name that is not valid, or the same name twice")
        found[name] = _text(name, _decode(encoded.strip(), "Upload-Metadata"))
    return found


def format_metadata(metadata: Mapping[str, str]) -> str:
    """Return the header Upload-Metadata."""
    return ",".join(f"{name} {base64.b64encode(value.encode()).decode()}".strip() for name, value in metadata.items())


def state_headers(upload: Upload) -> dict[str, str]:
    """Return the headers that say how far an upload is, and until when it can go on."""
    if upload.finished:
        return {"Upload-Offset": str(upload.received), CAPTURE_HEADER: upload.capture}
    return {"Upload-Offset": str(upload.received), "Upload-Expires": formatdate(upload.expires, usegmt=True)}


def option_headers(max_size: int) -> dict[str, str]:
    """Return the headers that say what of tus this service speaks."""
    return {
        "Tus-Version": VERSION,
        "Tus-Extension": EXTENSIONS,
        "Tus-Max-Size": str(max_size),
        "Tus-Checksum-Algorithm": ",".join(_ALGORITHMS),
    }


def _decode(encoded: str, header: str) -> bytes:
    try:
        return base64.b64decode(encoded, validate=True)
    except binascii.Error:
        raise _bad_header(f"the header {header} has a value that is not in Base64") from None


def _text(name: str, value: bytes) -> str:
    try:
        return one_line(value.decode())
    except ValueError:  # not UTF-8 either
        raise _bad_header(f"the value of {name[:40]} in Upload-Metadata is not one line of text in UTF-8") from None


def _bad_header(detail: str) -> Problem:
    return Problem(400, "UPLOAD_HEADER", detail, hints=("send the header as tus 1.0.0 has it",))
