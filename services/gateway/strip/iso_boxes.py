"""Parser of boxes of the ISO base media file format (ISO/IEC 14496-12): mp4, mov and HEIF files."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from capture2vr.gateway.strip.in_place import MOST_PARTS, Buffer, UnreadableError, blank
from capture2vr.sentences.sentence import say


@dataclass(frozen=True, slots=True)
class Box:
    """A box. kind: its four-character code; its content lies from byte `body` to `end`."""

    kind: bytes
    start: int
    body: int
    end: int


def boxes(data: Buffer, start: int, end: int) -> Iterator[Box]:
    """Yield the consecutive boxes in a range. Raises UnreadableError when one exceeds it."""
    at = start
    for count in itertools.count():
        if at + 8 > end:
            return
        if count > MOST_PARTS:
            raise UnreadableError(say("file_has_too_many_boxes", most=MOST_PARTS))
        size, kind = struct.unpack_from(">I4s", data, at)
        body = at + 8
        if size == 1:
            if at + 16 > end:
                raise UnreadableError(say("file_cut_short_within_box", kind=repr(kind)))
            size = struct.unpack_from(">Q", data, body)[0]
            body = at + 16
        elif size == 0:  # the box extends to the end
            size = end - at
        if at + size < body or at + size > end:
            raise UnreadableError(say("file_cut_short_box_should", kind=repr(kind), size=size, left=end - at))
        yield Box(kind, at, body, at + size)
        at += size


def find(data: Buffer, box: Box, *path: bytes) -> Box | None:
    """Return the first box at a path of kinds below this box, or None."""
    for kind in path:
        found = next((each for each in boxes(data, box.body, box.end) if each.kind == kind), None)
        if found is None:
            return None
        box = found
    return box


def free_box(data: Buffer, box: Box) -> None:
    """Turn a box into a `free` box of zeros, which every reader skips."""
    data[box.start + 4 : box.start + 8] = b"free"
    blank(data, box.body, box.end)
