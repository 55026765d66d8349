"""Writer of Unity Addressables' binary catalogues for packages from 1.21.3: v1 until 1.29, v2 until 3.1, v3 from 4.0.

Records of little-endian uint32 refer to each other by their offset in the file. Arrays and strings are preceded by
their size in bytes; references point behind it. The versions differ in how types are named and in how strings may be
split into shared parts; this writer splits none, which all three allow.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Literal

from capture2vr.storage.unity.listing import (
    BUNDLE_OPTIONS,
    FILE_PROVIDER,
    INSTANCE_PROVIDER,
    PREFAB_PROVIDER,
    SCENE_PROVIDER,
    STRING,
    BundleOptions,
    Listing,
    Location,
    TypeName,
    assembly_name,
)

Version = Literal[1, 2, 3]

_MAGIC = 0x0DE38942
_NONE = 0xFFFFFFFF
_UTF16_FLAG = 0x80000000
_LIMIT = 0x3FFFFFFF  # bytes of a file: the two bits above are flags of string references
_HEADER = struct.Struct("<8I")
_REDIRECTS = 32  # what Unity writes for "no limit"
_NO_SEPARATOR = 0


def binary_catalogue(listing: Listing, *, version: Version) -> bytes:
    """Serialise a listing in a binary form. Equal listings give equal bytes.

    Locations must come after those that they depend on. Raises ValueError for more than 1 GiB.
    """
    file = _BinaryFile(version)
    header = file.reserve(_HEADER.size)
    keys = file.reserve(4 + 8 * len(listing.keys)) + 4
    document = (
        _MAGIC,
        version,
        keys,
        file.text(listing.locator_id),
        _provider(file, INSTANCE_PROVIDER),
        _provider(file, SCENE_PROVIDER),
        file.array(_provider(file, provider) for provider in (FILE_PROVIDER, PREFAB_PROVIDER)),
        file.text(""),
    )
    offsets = _locations(file, listing)
    pairs: list[int] = []
    for key, indices in listing.keys.items():
        pairs += _string_object(file, key), file.array(offsets[index] for index in indices)
    file.patch(header, _HEADER.pack(*document))
    file.patch(keys - 4, struct.pack(f"<{1 + len(pairs)}I", 4 * len(pairs), *pairs))
    return file.content()


class _BinaryFile:
    """A binary file under construction. Equal records and strings are written only once, because most repeat."""

    def __init__(self, version: Version) -> None:
        self.version = version
        self._data = bytearray()
        self._records: dict[bytes, int] = {}
        self._blocks: dict[bytes, int] = {}
        self._texts: dict[str, int] = {"": _NONE}  # empty strings are not stored: Unity's reader fails on size 0
        self._types: dict[TypeName, int] = {}

    def reserve(self, size: int) -> int:
        self._data += bytes(size)
        return len(self._data) - size

    def patch(self, offset: int, data: bytes) -> None:
        self._data[offset : offset + len(data)] = data

    def record(self, layout: str, *values: int | bytes) -> int:
        data = struct.pack(layout, *values)
        known = self._records.get(data)
        if known is None:
            known = self._records[data] = len(self._data)
            self._data += data
        return known

    def array(self, offsets: Iterable[int]) -> int:
        values = list(offsets)
        return self._block(struct.pack(f"<{len(values)}I", *values))

    def text(self, text: str) -> int:
        """Write a string, and return the reference to it."""
        known = self._texts.get(text)
        if known is None:
            encoding, flag = ("ascii", 0) if text.isascii() else ("utf-16-le", _UTF16_FLAG)
            known = self._texts[text] = self._block(text.encode(encoding)) | flag
        return known

    def type(self, type_name: TypeName) -> int:
        """Write a type's name, and return its offset.

        v3 has short assembly names, and none for the core library, because it supports other runtimes than Mono too.
        """
        known = self._types.get(type_name)
        if known is None:
            assembly = type_name.assembly if self.version == 3 else assembly_name(type_name)
            known = self._types[type_name] = self.record("<2I", self.text(assembly), self.text(type_name.name))
        return known

    def content(self) -> bytes:
        if len(self._data) > _LIMIT:
            raise ValueError(f"the catalogue has {len(self._data)} bytes; Unity reads at most {_LIMIT}")
        return bytes(self._data)

    def _block(self, data: bytes) -> int:
        known = self._blocks.get(data)
        if known is None:
            self._data += struct.pack("<I", len(data))
            known = self._blocks[data] = len(self._data)
            self._data += data
        return known


def _locations(file: _BinaryFile, listing: Listing) -> list[int]:
    """Write the locations, and return their offsets. Files come before the assets that refer to their offsets."""
    offsets: list[int] = []
    for location in listing.locations:
        dependencies = file.array(offsets[each] for each in location.dependencies) if location.dependencies else _NONE
        offsets.append(
            file.record(
                "<4Ii2I",
                file.text(location.key),
                file.text(location.internal_id),
                file.text(location.provider),
                dependencies,
                0,  # hash of the dependencies: Unity uses their offset instead
                _data(file, location),
                file.type(location.type),
            )
        )
    return offsets


def _data(file: _BinaryFile, location: Location) -> int:
    if location.data is None:
        return _NONE
    if isinstance(location.data, str):
        return _string_object(file, location.data)
    return file.record("<2I", file.type(BUNDLE_OPTIONS), _options(file, location.data))


def _options(file: _BinaryFile, options: BundleOptions) -> int:
    transfer = file.record("<hBBi", 0, _REDIRECTS, 0, 0)  # timeout, redirects, retries, flags: Unity's defaults
    content_hash = file.record("<16s", bytes.fromhex(options.hash))
    return file.record("<5I", content_hash, file.text(options.name), options.crc, options.size, transfer)


def _string_object(file: _BinaryFile, text: str) -> int:
    string = file.record("<IH2x", file.text(text), _NO_SEPARATOR) if text else _NONE
    return file.record("<2I", file.type(STRING), string)


def _provider(file: _BinaryFile, provider: TypeName) -> int:
    return file.record("<3I", file.text(provider.name), file.type(provider), file.text(""))
