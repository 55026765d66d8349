"""Reading numbers and texts out of bytes that anybody may have made: nothing beyond the end, nothing twice."""

from __future__ import annotations

import struct
from typing import Any


class Bounded:
    """Bytes with a name for the errors. Every fault is a ValueError that says where it is.

    A reader may follow references into the same bytes again and again. `spend` keeps what that can cost below what the
    bytes themselves are: without it a megabyte of arrays laid across each other unpacks to gigabytes.
    """

    def __init__(self, what: str, data: bytes) -> None:
        self.what = what
        self.size = len(data)
        self._data = data
        self._left = len(data)

    def unpack(self, layout: str, offset: int) -> tuple[Any, ...]:
        self.check(offset, struct.calcsize(layout))
        return struct.unpack_from(layout, self._data, offset)

    def count(self, offset: int) -> int:
        (count,) = self.unpack("<i", offset)
        if count < 0:
            raise ValueError(f"{self.what}: a count of {count} at {offset}")
        return int(count)

    def int32s(self, offset: int, count: int) -> tuple[int, ...]:
        if not 0 <= count <= self.size // 4:
            raise ValueError(f"{self.what}: {count} numbers at {offset} are not there ({self.size} bytes)")
        return self.unpack(f"<{count}i", offset)

    def take(self, offset: int, size: int) -> bytes:
        self.check(offset, size)
        return self._data[offset : offset + size]

    def text(self, offset: int, size: int, encoding: str) -> str:
        try:
            return self.take(offset, size).decode(encoding)
        except UnicodeDecodeError:
            raise ValueError(f"{self.what}: the {size} bytes at {offset} are no {encoding} text") from None

    def check(self, offset: int, size: int) -> None:
        if offset < 0 or not 0 <= size <= self.size - offset:
            raise ValueError(f"{self.what}: {size} bytes at {offset} lie beyond the end ({self.size} bytes)")

    def spend(self, size: int, offset: int) -> None:
        """Account for `size` bytes that are kept. Raises ValueError when they add up to more than there are."""
        self._left -= size
        if self._left < 0:
            raise ValueError(f"{self.what}: what is at {offset} overlaps with what was read before")
