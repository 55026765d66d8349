"""Conditional and range requests (RFC 9110, 13 and 14), as far as immutable files need them."""

from __future__ import annotations

import re

_RANGE = re.compile(r"bytes\s*=\s*([0-9]{0,18})\s*-\s*([0-9]{0,18})", re.IGNORECASE)  # 18 digits: below 2^63
_TAG = re.compile(r'(?:W/)?"([^"]*)"')


class UnsatisfiableError(ValueError):
    """The range begins behind the end."""


def matches(if_none_match: str | None, etag: str) -> bool:
    """Whether the client has the representation of this (unquoted) etag already: 304."""
    if if_none_match is None:
        return False
    return if_none_match.strip() == "*" or etag in _TAG.findall(if_none_match)


def wanted_range(header: str | None, if_range: str | None, etag: str, size: int) -> tuple[int, int] | None:
    """First and end byte of a single range, or None where the whole is to be sent.

    So it is for several ranges, for what is no range, and when `if_range` names another representation (a date does).
    Raises UnsatisfiableError.
    """
    found = _RANGE.fullmatch(header.strip()) if header else None
    if found is None or (if_range is not None and if_range.strip() != f'"{etag}"'):
        return None
    first, last = found.groups()
    if not first and not last:
        return None
    if not first:  # the last so many
        start, end = max(0, size - int(last)), size
    else:
        start, end = int(first), min(size, int(last) + 1) if last else size
        if last and int(last) < int(first):
            return None
    if start >= end:
        raise UnsatisfiableError(f"the file has {size} bytes")
    return start, end
