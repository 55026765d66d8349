"""Catalogues that anybody may have made: a named error, quickly, and never much memory."""

from __future__ import annotations

import json
import struct
import time
import tracemalloc
from base64 import b64decode, b64encode
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.listing import Listing
from capture2vr.storage.unity.locations import parse_assets
from tests.support.clients.unity_binary_reader import read_binary_catalogue
from tests.support.clients.unity_catalogues import FORMS, asset, catalogue, reader, written

every_form = pytest.mark.parametrize("form", FORMS)
_MADE = catalogue(asset("dress", "clothes"), asset("ä", "clothes", levels=1))
_BLOBS = ("m_KeyDataString", "m_BucketDataString", "m_EntryDataString", "m_ExtraDataString")


def understand(read: Callable[[bytes], Listing], data: bytes) -> None:
    """Read as far as it goes. Anything but a ValueError is a fault of ours."""
    reason = "fine"
    try:
        parse_assets(read(data))
    except ValueError as fault:
        reason = str(fault)
    assert 0 < len(reason) < 1000


@every_form
def test_a_catalogue_cut_anywhere_is_refused(form: int) -> None:
    data = written(_MADE, form)
    for size in range(len(data)):
        with pytest.raises(ValueError):
            reader(form)(data[:size])


@pytest.mark.slow
@pytest.mark.parametrize("form", [1, 2, 3])
@given(changes=st.lists(st.tuples(st.integers(0), st.integers(0, 2**32 - 1)), min_size=1, max_size=6))
@settings(max_examples=300, deadline=2000)
def test_any_words_in_a_binary_catalogue(form: int, changes: list[tuple[int, int]]) -> None:
    data = bytearray(written(_MADE, form))
    for place, word in changes:
        # Most words are offsets, so half of the changes are offsets too: those lead somewhere.
        struct.pack_into("<I", data, 8 + place % (len(data) - 12), word if word % 2 else word // 2 % len(data))
    understand(read_binary_catalogue, bytes(data))


@given(
    blob=st.sampled_from(_BLOBS),
    changes=st.lists(st.tuples(st.integers(0), st.integers(-(2**31), 2**31 - 1)), min_size=1, max_size=6),
)
@settings(max_examples=300, deadline=2000)
def test_any_numbers_in_the_json_tables(blob: str, changes: list[tuple[int, int]]) -> None:
    document = json.loads(written(_MADE, 0))
    data = bytearray(b64decode(document[blob]))
    for place, number in changes:
        struct.pack_into("<i", data, place % (len(data) - 4), number if number % 2 else number // 2 % 12)
    understand(read_json_catalogue, json.dumps({**document, blob: b64encode(data).decode()}).encode())


_anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


@given(field=st.sampled_from(sorted(json.loads(written(_MADE, 0)))), value=_anything)
@settings(max_examples=200, deadline=2000)
def test_anything_in_a_json_field(field: str, value: Any) -> None:
    document = {**json.loads(written(_MADE, 0)), field: value}
    understand(read_json_catalogue, json.dumps(document).encode())


@given(data=st.binary(max_size=300))
def test_any_bytes(data: bytes) -> None:
    for form in FORMS:
        understand(reader(form), data)
    understand(read_binary_catalogue, written(_MADE, 2)[:8] + data)


@pytest.mark.parametrize(
    ("offset", "word", "reason"),
    [
        (0, 0x04034B50, "not a binary catalogue"),
        (4, 0, "version 0"),
        (4, 4, "version 4"),
        (8, 0xFFFFFFF0, "beyond the end"),
        (8, 2, "beyond the end"),
        (32, 0x7FFFFFFF, "beyond the end"),
        (32, 12, "no pairs"),
        (32, 7, "no whole numbers"),
        (12, 40 | 1 << 30, "split"),
    ],
)
def test_the_reason_is_named(offset: int, word: int, reason: str) -> None:
    data = bytearray(written(_MADE, 2))
    struct.pack_into("<I", data, offset, word)
    with pytest.raises(ValueError, match=reason):
        read_binary_catalogue(bytes(data))


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("m_LocatorId", None, "m_LocatorId is a NoneType, not a string"),
        ("m_LocatorId", "\ud800", "not valid Unicode"),
        ("m_InternalIds", {}, "m_InternalIds is not a list"),
        ("m_InternalIds", [], "id 0 of 0"),
        ("m_InternalIdPrefixes", ["http"], "compressed"),
        ("m_resourceTypes", [1], "m_resourceTypes is not a JSON object"),
        ("m_KeyDataString", "%", "no base64"),
        ("m_KeyDataString", "/////w==", "a count of -1"),
        ("m_BucketDataString", "", "beyond the end"),
        ("m_EntryDataString", "AQAAAA==", "beyond the end"),
    ],
)
def test_the_faulty_field_is_named(field: str, value: object, reason: str) -> None:
    document = {**json.loads(written(_MADE, 0)), field: value}
    with pytest.raises(ValueError, match=reason):
        read_json_catalogue(json.dumps(document).encode())


def test_a_key_that_stands_there_twice() -> None:
    document = json.loads(written(catalogue(asset(levels=2)), 0))
    table = bytearray(b64decode(document["m_BucketDataString"]))
    struct.pack_into("<i", table, 16, 4)
    with pytest.raises(ValueError, match="two keys are the same"):
        read_json_catalogue(json.dumps({**document, "m_BucketDataString": b64encode(table).decode()}).encode())


@pytest.mark.parametrize("size", [b"1.50", b"true", b"null", b'"10"', b" NaN"])
def test_a_size_that_is_no_whole_number(size: bytes) -> None:
    document = json.loads(written(catalogue(asset(levels=1)), 0))
    extra = b64decode(document["m_ExtraDataString"]).replace(_utf16(b"1000"), _utf16(size))
    with pytest.raises(ValueError, match="not an integer"):
        read_json_catalogue(json.dumps({**document, "m_ExtraDataString": b64encode(extra).decode()}).encode())


def _utf16(text: bytes) -> bytes:
    return text.decode().encode("utf-16-le")


def test_a_class_with_an_endless_name() -> None:
    data = bytearray(written(catalogue(asset(levels=1)), 2))
    (keys_at,) = struct.unpack_from("<I", data, 8)
    (places_at,) = struct.unpack_from("<I", data, keys_at + 4)
    (file,) = struct.unpack_from("<I", data, places_at)
    (kind,) = struct.unpack_from("<I", data, file + 24)
    struct.pack_into("<I", data, kind, len(data) + 4)
    data += struct.pack("<I", 100_000) + b"x" * 100_000
    with pytest.raises(ValueError, match="more than 1000 letters"):
        read_binary_catalogue(bytes(data))


def test_json_nested_a_million_deep() -> None:
    with pytest.raises(ValueError, match="not JSON"):
        read_json_catalogue(b"[" * 1_000_000)


def test_json_nested_just_as_deep_as_can_be_read() -> None:
    understand(read_json_catalogue, b'{"m_InternalIdPrefixes":[],"m_KeyDataString":' + b"[" * 900 + b"]" * 900 + b"}")


def test_a_location_that_depends_on_itself_is_no_asset() -> None:
    data = bytearray(written(catalogue(asset(levels=2)), 2))
    (keys_at,) = struct.unpack_from("<I", data, 8)
    (places_at,) = struct.unpack_from("<I", data, keys_at + 20)
    (prefab,) = struct.unpack_from("<I", data, places_at)
    (dependencies,) = struct.unpack_from("<I", data, prefab + 12)
    struct.pack_into("<I", data, dependencies, prefab)
    listing = read_binary_catalogue(bytes(data))
    assert listing.locations[2].dependencies == (2, 1)
    with pytest.raises(ValueError, match="not a LOD file"):
        parse_assets(listing)


def bomb_of_arrays() -> bytes:
    """A megabyte in which every word is the size of an array that reaches over the next 16,384 words."""
    keys, first = 1000, 20_000
    data = bytearray(struct.pack("<I", 0x10000) * 250_000)
    data[:first] = written(catalogue(asset()), 2).ljust(first, b"\0")
    (old_keys,) = struct.unpack_from("<I", data, 8)
    (name,) = struct.unpack_from("<I", data, old_keys)
    pairs = [word for number in range(keys) for word in (name, first + 4 * number)]
    table = struct.pack(f"<{1 + len(pairs)}I", 4 * len(pairs), *pairs)
    data[10_000 : 10_000 + len(table)] = table
    struct.pack_into("<I", data, 8, 10_004)
    return bytes(data)


def bomb_of_labels() -> bytes:
    """Every one of 3,000 labels is on every one of 3,000 assets, by one array of 12 kB."""
    names = [f"label-{number}" for number in range(3000)]
    made = catalogue(*(asset(f"a{number}", names[number], levels=1) for number in range(3000)))
    data = bytearray(written(made, 2))
    (keys_at,) = struct.unpack_from("<I", data, 8)
    places = range(keys_at + 8 * 6000 + 4, keys_at + 8 * 9000, 8)
    prefabs = [struct.unpack_from("<I", data, struct.unpack_from("<I", data, place)[0])[0] for place in places]
    shared = len(data) + 4
    data += struct.pack(f"<{1 + len(prefabs)}I", 4 * len(prefabs), *prefabs)
    for place in places:
        struct.pack_into("<I", data, place, shared)
    return bytes(data)


def bomb_of_files() -> bytes:
    """Every one of 3,000 assets is made of all 3,000 files, by one array of 12 kB."""
    data = bytearray(written(catalogue(*(asset(f"a{number}", levels=1) for number in range(3000))), 2))
    (keys_at,) = struct.unpack_from("<I", data, 8)
    sets = (struct.unpack_from("<I", data, keys_at + 8 * number + 4)[0] for number in range(6000))
    places = [struct.unpack_from("<I", data, each)[0] for each in sets]
    shared = len(data) + 4
    data += struct.pack("<3001I", 12_000, *places[::2])
    for prefab in places[1::2]:
        struct.pack_into("<I", data, prefab + 12, shared)
    return bytes(data)


def bomb_of_ids() -> bytes:
    """20,000 locations with one id of half a megabyte."""
    document = json.loads(written(catalogue(*(asset(f"a{number}", levels=1) for number in range(10_000))), 0))
    table = bytearray(b64decode(document["m_EntryDataString"]))
    for row in range(4, len(table), 28):
        struct.pack_into("<i", table, row, 0)
    ids = ["x" * 500_000]
    return json.dumps({**document, "m_InternalIds": ids, "m_EntryDataString": b64encode(table).decode()}).encode()


def bomb_of_keys() -> bytes:
    """20,000 keys of half a megabyte, each five bytes further on than the last."""
    count, length = 20_000, 0x070707  # a length that is text itself
    keys = struct.pack("<i", count) + (b"\0" + struct.pack("<i", length)) * count + b"x" * length
    buckets = struct.pack("<i", count) + b"".join(struct.pack("<2i", 4 + 5 * each, 0) for each in range(count))
    tables = {"m_KeyDataString": b64encode(keys).decode(), "m_BucketDataString": b64encode(buckets).decode()}
    return json.dumps({**json.loads(written(_MADE, 0)), **tables}).encode()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bomb", "read", "reason"),
    [
        (bomb_of_arrays, read_binary_catalogue, "overlaps|twice"),
        (bomb_of_labels, read_binary_catalogue, "cannot have the label"),
        (bomb_of_files, read_binary_catalogue, "belongs to two assets"),
        (bomb_of_ids, read_json_catalogue, "two locations have the same id"),
        (bomb_of_keys, read_json_catalogue, "overlaps"),
    ],
)
def test_what_unpacks_to_gigabytes_is_refused(
    bomb: Callable[[], bytes], read: Callable[[bytes], Listing], reason: str
) -> None:
    data = bomb()
    tracemalloc.start()
    try:
        start = time.process_time()
        with pytest.raises(ValueError, match=reason):
            parse_assets(read(data))
        assert time.process_time() - start < 3
        assert tracemalloc.get_traced_memory()[1] < 100 * 2**20
    finally:
        tracemalloc.stop()
