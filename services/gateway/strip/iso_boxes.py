"""Boxes of the ISO base media file format (ISO/IEC 14496-12), which mp4, mov and HEIF files are made of."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from services.gateway.uploads.cleaned import MOST_PARTS, Buffer, UnreadableError, blank


@dataclass(frozen=True, slots=True)
class Box:
    """`kind` is its four-character code; the content lies from `body` to `end`."""

    kind: bytes
    start: int
    body: int
    end: int


def boxes(data: Buffer, start: int, end: int) -> Iterator[Box]:
    """The boxes side by side in a range. Raises UnreadableError when one leaves it."""
    at = start
    for count in itertools.count():
        if at + 8 > end:
            return
        if count > MOST_PARTS:
            raise UnreadableError(f"the file has more than {MOST_PARTS:,} boxes side by side")
        size, kind = struct.unpack_from(">I4s", data, at)
        body = at + 8
        if size == 1:
            if at + 16 > end:
                raise UnreadableError(f"the file is cut short within its box {kind!r}")
            size = struct.unpack_from(">Q", data, body)[0]
            body = at + 16
        elif size == 0:  # to the end
            size = end - at
        if at + size < body or at + size > end:
            raise UnreadableError(
                f"the file is cut short: its box {kind!r} says {size:,} bytes, {end - at:,} are there"
            )
        yield Box(kind, at, body, at + size)
        at += size


def find(data: Buffer, box: Box, *path: bytes) -> Box | None:
    """The first box along a path of kinds below this one."""
    for kind in path:
        found = next((each for each in boxes(data, box.body, box.end) if each.kind == kind), None)
        if found is None:
            return None
        box = found
    return box


def release(data: Buffer, box: Box) -> None:
    """Make it free space: zeros, which every reader skips."""
    data[box.start + 4 : box.start + 8] = b"free"
    blank(data, box.body, box.end)
