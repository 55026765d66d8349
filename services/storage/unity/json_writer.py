"""Writer of Unity Addressables' JSON catalogue (ContentCatalogData): default of packages up to 1.29, optional later.

Four tables of little-endian int32 in base64: keys as typed objects, a bucket of locations for each key, seven numbers
for each location, and the locations' data. They refer to strings and types, which are JSON arrays, by index.
"""

from __future__ import annotations

import json
import struct
import zlib
from base64 import b64encode
from typing import Any

from capture2vr.storage.unity.listing import (
    BUNDLE_OPTIONS,
    FILE_PROVIDER,
    INSTANCE_PROVIDER,
    PREFAB_PROVIDER,
    SCENE_PROVIDER,
    BundleOptions,
    Listing,
    Location,
    TypeName,
    assembly_name,
)

_ASCII, _UTF16, _INT32, _JSON = b"\0", b"\1", b"\4", b"\7"  # type codes of serialised objects
_NONE = -1
# Created once, because creating the encoder takes longer than using it.
_encode = json.JSONEncoder(ensure_ascii=False, separators=(",", ":")).encode
_OPTIONS = _JSON + b"".join(
    bytes([len(name)]) + name.encode() for name in (assembly_name(BUNDLE_OPTIONS), BUNDLE_OPTIONS.name)
)

_Buckets = list[tuple[str | int, tuple[int, ...]]]


def json_catalogue(listing: Listing) -> bytes:
    """Serialise a listing as UTF-8 JSON. Equal listings give equal bytes."""
    providers = list(dict.fromkeys(location.provider for location in listing.locations))
    types = list(dict.fromkeys(location.type for location in listing.locations))
    buckets = _buckets(listing)
    data, data_offsets = _data_table(listing)
    document = {
        "m_LocatorId": listing.locator_id,
        "m_BuildResultHash": "",
        "m_InstanceProviderData": _provider(INSTANCE_PROVIDER),
        "m_SceneProviderData": _provider(SCENE_PROVIDER),
        "m_ResourceProviderData": [_provider(FILE_PROVIDER), _provider(PREFAB_PROVIDER)],
        "m_ProviderIds": providers,
        "m_InternalIds": [location.internal_id for location in listing.locations],
        **_key_tables(buckets),
        "m_EntryDataString": _base64(_entry_table(listing, buckets, providers, types, data_offsets)),
        "m_ExtraDataString": _base64(data),
        "m_resourceTypes": [_type(each) for each in types],
        "m_InternalIdPrefixes": [],
    }
    return _encode(document).encode()


def _buckets(listing: Listing) -> _Buckets:
    """Return the keys with their locations, plus one extra key for each location with several dependencies.

    The extra key is needed because a location can name only one key for its dependencies. It is a number, as Unity's
    own were for years, so that no label can collide with it.
    """
    sets = [(index, location.dependencies) for index, location in enumerate(listing.locations)]
    return [*listing.keys.items(), *(each for each in sets if len(each[1]) > 1)]


def _key_tables(buckets: _Buckets) -> dict[str, str]:
    keys = bytearray(struct.pack("<i", len(buckets)))
    table = bytearray(struct.pack("<i", len(buckets)))
    for key, indices in buckets:
        table += struct.pack(f"<{2 + len(indices)}i", len(keys), len(indices), *indices)
        keys += _string(key) if isinstance(key, str) else _INT32 + struct.pack("<i", key)
    return {"m_KeyDataString": _base64(keys), "m_BucketDataString": _base64(table)}


def _entry_table(
    listing: Listing, buckets: _Buckets, providers: list[str], types: list[TypeName], data_offsets: list[int]
) -> bytes:
    key_index = {key: index for index, (key, _) in enumerate(buckets)}
    table = bytearray(struct.pack("<i", len(listing.locations)))
    for index, location in enumerate(listing.locations):
        table += struct.pack(
            "<7i",
            index,
            providers.index(location.provider),
            _dependency_key(listing, index, key_index),
            _dependency_hash(listing, location),
            data_offsets[index],
            key_index[location.key],
            types.index(location.type),
        )
    return bytes(table)


def _dependency_key(listing: Listing, index: int, key_index: dict[str | int, int]) -> int:
    dependencies = listing.locations[index].dependencies
    if not dependencies:
        return _NONE
    return key_index[index if len(dependencies) > 1 else listing.locations[dependencies[0]].key]


def _dependency_hash(listing: Listing, location: Location) -> int:
    """Return the hash of a location's dependencies, different for each asset and version.

    Unity groups loads by it; early packages use nothing else.
    """
    names = "\n".join(listing.locations[each].internal_id for each in location.dependencies)
    return zlib.crc32(names.encode()) - 2**31 if names else 0


def _data_table(listing: Listing) -> tuple[bytes, list[int]]:
    """Concatenate the data of all locations, and return it with the offset of each."""
    table, offsets = bytearray(), []
    for location in listing.locations:
        offsets.append(_NONE if location.data is None else len(table))
        if isinstance(location.data, str):
            table += _string(location.data)
        elif location.data is not None:
            table += _options(location.data)
    return bytes(table), offsets


def _options(options: BundleOptions) -> bytes:
    """Serialise a file's load options. Unity uses its defaults for fields that are left out."""
    fields = {"m_Hash": options.hash, "m_Crc": options.crc, "m_BundleName": options.name, "m_BundleSize": options.size}
    text = _encode(fields).encode("utf-16-le")
    return _OPTIONS + struct.pack("<i", len(text)) + text


def _string(text: str) -> bytes:
    data = text.encode("ascii" if text.isascii() else "utf-16-le")
    return (_ASCII if text.isascii() else _UTF16) + struct.pack("<i", len(data)) + data


def _provider(provider: TypeName) -> dict[str, Any]:
    return {"m_Id": provider.name, "m_ObjectType": _type(provider), "m_Data": ""}


def _type(type_name: TypeName) -> dict[str, str]:
    return {"m_AssemblyName": assembly_name(type_name), "m_ClassName": type_name.name}


def _base64(data: bytes | bytearray) -> str:
    return b64encode(data).decode()
