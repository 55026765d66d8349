"""HTTP conditional and range requests (RFC 9110, sections 13 and 14), as far as immutable files need them."""

from __future__ import annotations

import re
from collections.abc import Mapping, MutableMapping

from capture2vr.gateway.errors import Problem

_RANGE = re.compile(r"bytes\s*=\s*([0-9]{0,18})\s*-\s*([0-9]{0,18})", re.IGNORECASE)  # 18 digits: below 2^63
_TAG = re.compile(r'(?:W/)?"([^"]*)"')


class UnsatisfiableError(ValueError):
    """The range begins behind the end of the file."""


def etag_matches(if_none_match: str | None, etag: str) -> bool:
    """Return whether If-None-Match contains this (unquoted) etag, so that the answer is 304."""
    if if_none_match is None:
        return False
    return if_none_match.strip() == "*" or etag in _TAG.findall(if_none_match)


def parse_range(header: str | None, if_range: str | None, etag: str, size: int) -> tuple[int, int] | None:
    """Parse a Range header into its first and end byte; None where the whole file must be sent.

    That is so for several ranges, for an invalid header, and when `if_range` is another etag or a date. Raises
    UnsatisfiableError.
    """
    found = _RANGE.fullmatch(header.strip()) if header else None
    if found is None or (if_range is not None and if_range.strip() != f'"{etag}"'):
        return None
    first, last = found.groups()
    if not first and not last:
        return None
    if not first:  # a suffix range: the last so many bytes
        start, end = max(0, size - int(last)), size
    else:
        start, end = int(first), min(size, int(last) + 1) if last else size
        if last and int(last) < int(first):
            return None
    if start >= end:
        raise UnsatisfiableError(f"the file has {size} bytes")
    return start, end


def take_range(
    asked: Mapping[str, str], etag: str, size: int, headers: MutableMapping[str, str], always: Mapping[str, str]
) -> tuple[int, int, int]:
    """Return the first and the end byte that a request wants of a file, and the status; describe them in `headers`.

    asked   the request's headers
    always  headers that a refusal has too

    Raises Problem RANGE_UNSATISFIABLE.
    """
    try:
        part = parse_range(asked.get("range"), asked.get("if-range"), etag, size)
    except UnsatisfiableError as error:
        told = {"Content-Range": f"bytes */{size}", **always}
        hints = (f"ask for a range that begins below byte {size}",)
        raise Problem(416, "RANGE_UNSATISFIABLE", str(error), hints=hints, headers=told) from None
    start, end = part or (0, size)
    headers["Content-Length"] = str(end - start)
    if part:
        headers["Content-Range"] = f"bytes {start}-{end - 1}/{size}"
    return start, end, 206 if part else 200
