"""Bounds-checked reading of numbers and strings from untrusted bytes."""

from __future__ import annotations

import struct
from typing import Any


class BoundedReader:
    """Untrusted bytes, and a name for error messages. Every error is a ValueError with the offset.

    `spend` limits how much is read in total to the size of the bytes. Without it, a hostile file of one megabyte whose
    arrays overlap each other would unpack to gigabytes.
    """

    def __init__(self, what: str, data: bytes) -> None:
        self.what = what
        self.size = len(data)
        self._data = data
        self._bytes_left = len(data)

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
            raise ValueError(f"{self.what}: {count} numbers at {offset} lie beyond the end ({self.size} bytes)")
        return self.unpack(f"<{count}i", offset)

    def take(self, offset: int, size: int) -> bytes:
        self.check(offset, size)
        return self._data[offset : offset + size]

    def text(self, offset: int, size: int, encoding: str) -> str:
        try:
            return self.take(offset, size).decode(encoding)
        except UnicodeDecodeError:
            raise ValueError(f"{self.what}: the {size} bytes at {offset} are not {encoding} text") from None

    def check(self, offset: int, size: int) -> None:
        if offset < 0 or not 0 <= size <= self.size - offset:
            raise ValueError(f"{self.what}: {size} bytes at {offset} lie beyond the end ({self.size} bytes)")

    def spend(self, size: int, offset: int) -> None:
        """Count `size` more bytes as read. Raises ValueError when the sum exceeds the size of the data."""
        self._bytes_left -= size
        if self._bytes_left < 0:
            raise ValueError(f"{self.what}: the data at {offset} overlaps with data that was read before")
