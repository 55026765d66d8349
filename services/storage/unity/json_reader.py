"""Reader of Unity Addressables' JSON catalogue (ContentCatalogData), for updates and checks.

Written from the format's description, not from the writer. Refuses ids that are compressed with prefixes, which this
program never writes.
"""

from __future__ import annotations

import binascii
import json
from base64 import b64decode
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from capture2vr.storage.unity.bounded import BoundedReader
from capture2vr.storage.unity.listing import BundleOptions, Listing, Location, TypeName

_LocationData = str | BundleOptions | None
_Key = str | int
_T = TypeVar("_T")

_CORE_LIBRARIES = ("mscorlib", "System.Private.CoreLib", "netstandard")
_OPTIONS_CLASS = "AssetBundleRequestOptions"


def read_json_catalogue(data: bytes) -> Listing:
    """Parse a JSON catalogue from untrusted bytes. Raises ValueError that names the faulty part."""
    document = _object("the catalogue", _parse_json("the catalogue", data))
    if document.get("m_InternalIdPrefixes"):
        raise ValueError("m_InternalIdPrefixes: compressed ids are not supported; build the catalogue without them")
    keys, buckets = _keys_and_buckets(document)
    locations = _locations(document, keys, buckets)
    for indices in buckets:
        _check_indices(indices, len(locations))
    text_keys = {key: indices for key, indices in zip(keys, buckets, strict=True) if isinstance(key, str)}
    return Listing(0, _string("m_LocatorId", document.get("m_LocatorId")), locations, text_keys)


def _keys_and_buckets(document: Mapping[str, Any]) -> tuple[list[_Key], list[tuple[int, ...]]]:
    table, texts = _read_blob(document, "m_BucketDataString"), _read_blob(document, "m_KeyDataString")
    count = table.count(0)
    if texts.count(0) != count:
        raise ValueError(f"m_KeyDataString: {texts.count(0)} keys for {count} buckets")
    keys: list[_Key] = []
    buckets: list[tuple[int, ...]] = []
    at = 4
    for _ in range(count):
        offset, length = table.unpack("<2i", at)
        keys.append(_key(texts, offset))
        buckets.append(table.int32s(at + 8, length))
        at += 8 + 4 * length
    if len(set(keys)) < len(keys):
        raise ValueError("m_KeyDataString: two keys are the same")
    return keys, buckets


def _locations(document: Mapping[str, Any], keys: list[_Key], buckets: list[tuple[int, ...]]) -> tuple[Location, ...]:
    ids, providers = (_strings(document, name) for name in ("m_InternalIds", "m_ProviderIds"))
    types = [_type(each) for each in _list(document, "m_resourceTypes")]
    table = _read_blob(document, "m_EntryDataString")
    extra = _ExtraData(_read_blob(document, "m_ExtraDataString"))
    found = []
    for index in range(table.count(0)):
        row = table.unpack("<7i", 4 + 28 * index)
        id_index, provider, dependency_key, _, data_offset, primary_key, type_index = row
        dependencies = () if dependency_key < 0 else _get_item("dependencies", buckets, dependency_key)
        found.append(
            Location(
                str(_get_item("primary key", keys, primary_key)),
                _get_item("id", ids, id_index),
                _get_item("provider", providers, provider),
                _get_item("type", types, type_index),
                None if data_offset < 0 else extra.at(data_offset),
                dependencies,
            )
        )
    return tuple(found)


class _ExtraData:
    """The locations' data, parsed once for each offset."""

    def __init__(self, table: BoundedReader) -> None:
        self._table = table
        self._known: dict[int, _LocationData] = {}

    def at(self, offset: int) -> _LocationData:
        if offset not in self._known:
            self._known[offset] = self._read(offset)
        return self._known[offset]

    def _read(self, offset: int) -> _LocationData:
        (kind,) = self._table.unpack("<B", offset)
        if kind in (0, 1):
            return _text_key(self._table, offset, kind)
        if kind == 7:
            return self._json_object(offset + 1)
        raise ValueError(f"m_ExtraDataString: kind {kind} of data at {offset} is not supported")

    def _json_object(self, offset: int) -> BundleOptions:
        at = offset
        names = []
        for _ in range(2):
            (length,) = self._table.unpack("<B", at)
            names.append(self._table.text(at + 1, length, "ascii"))
            at += 1 + length
        if names[1].rpartition(".")[2] != _OPTIONS_CLASS:
            raise ValueError(f"m_ExtraDataString: data of class {names[1]!r} at {offset} is not supported")
        (length,) = self._table.unpack("<i", at)
        text = self._table.text(at + 4, length, "utf-16-le")
        self._table.spend(at + 4 + length - offset, offset)
        return _bundle_options(_object("m_ExtraDataString", _parse_json("m_ExtraDataString", text)))


def _bundle_options(fields: Mapping[str, Any]) -> BundleOptions:
    content_hash, name = (_string(field, fields.get(field, "")) for field in ("m_Hash", "m_BundleName"))
    crc, size = (fields.get(field, 0) for field in ("m_Crc", "m_BundleSize"))
    if type(crc) is not int or type(size) is not int:
        raise ValueError("m_ExtraDataString: m_Crc or m_BundleSize is not an integer")
    return BundleOptions(content_hash, crc, name, size)


def _key(table: BoundedReader, offset: int) -> _Key:
    (kind,) = table.unpack("<B", offset)
    if kind in (0, 1):
        return _text_key(table, offset, kind)
    layout = {2: "<H", 3: "<I", 4: "<i"}.get(kind)
    if layout is None:
        raise ValueError(f"{table.what}: kind {kind} of key at {offset} is not supported")
    return int(table.unpack(layout, offset + 1)[0])


def _text_key(table: BoundedReader, offset: int, kind: int) -> str:
    (length,) = table.unpack("<i", offset + 1)
    text = table.text(offset + 5, length, ("ascii", "utf-16-le")[kind])
    table.spend(5 + length, offset)
    return text


def _type(document: Any) -> TypeName:
    fields = _object("m_resourceTypes", document)
    assembly = _string("m_AssemblyName", fields.get("m_AssemblyName", "")).partition(",")[0]
    name = _string("m_ClassName", fields.get("m_ClassName"))
    return TypeName("" if assembly in _CORE_LIBRARIES else assembly, name)


def _read_blob(document: Mapping[str, Any], name: str) -> BoundedReader:
    try:
        return BoundedReader(name, b64decode(_string(name, document.get(name)), validate=True))
    except binascii.Error as fault:
        raise ValueError(f"{name} is no base64: {fault}") from None


def _get_item(what: str, values: Sequence[_T], index: int) -> _T:
    if not 0 <= index < len(values):
        raise ValueError(f"m_EntryDataString: {what} {index} of {len(values)}")
    return values[index]


def _check_indices(indices: tuple[int, ...], count: int) -> None:
    if indices and not 0 <= min(indices) <= max(indices) < count:
        raise ValueError(f"m_BucketDataString: location {min(indices)} or {max(indices)} of {count}")


def _strings(document: Mapping[str, Any], name: str) -> list[str]:
    return [_string(name, each) for each in _list(document, name)]


def _string(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name} is a {type(value).__name__}, not a string")
    try:
        value.encode()
    except UnicodeEncodeError:  # JSON can encode half a surrogate pair, which cannot be printed
        raise ValueError(f"{name}: a string is not valid Unicode") from None
    return value


def _list(document: Mapping[str, Any], name: str) -> list[Any]:
    value = document.get(name)
    if not isinstance(value, list):
        raise ValueError(f"{name} is not a list")
    return value


def _object(name: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{name} is not a JSON object")
    return value


def _parse_json(what: str, text: bytes | str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as fault:
        raise ValueError(f"{what} is not JSON: {fault}") from None
