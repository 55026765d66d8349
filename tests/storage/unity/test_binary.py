"""Unity's catalogues byte by byte: what the format's description says, worked out by hand."""

from __future__ import annotations

import json
import struct
from base64 import b64decode

import pytest

from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.listing import BUNDLE_RESOURCE
from capture2vr.storage.unity.nouns import BASE_URL, Catalogue
from tests.support.clients.unity_catalogues import asset, catalogue, written


def test_the_smallest_binary_catalogue_byte_by_byte() -> None:
    """No assets: a header, an empty table of keys, the id, and the four providers with their types."""
    data = written(Catalogue("ä", ()), 2)
    header = struct.unpack_from("<8I", data)
    assert header[:3] == (0x0DE38942, 2, 36)
    assert data[32:36] == bytes(4)
    assert header[3] == 40 | 1 << 31
    assert data[36:42] == b"\2\0\0\0\xe4\0"
    assert header[7] == 0xFFFFFFFF
    name, kind, initial = struct.unpack_from("<3I", data, header[4])
    assembly, class_name = struct.unpack_from("<2I", data, kind)
    assert block(data, name) == b"UnityEngine.ResourceManagement.ResourceProviders.InstanceProvider"
    assert block(data, name) == block(data, class_name)
    assert block(data, assembly) == b"Unity.ResourceManager, Version=0.0.0.0, Culture=neutral, PublicKeyToken=null"
    assert initial == 0xFFFFFFFF
    assert len(block(data, header[6])) == 8


@pytest.mark.parametrize("version", [1, 2, 3])
def test_a_binary_location_follows_the_format(version: int) -> None:
    data = written(catalogue(asset("é", levels=2)), version)
    (keys_at,) = struct.unpack_from("<I", data, 8)
    pairs = struct.unpack("<6I", block(data, keys_at))
    names = [string_object(data, place) for place in pairs[::2]]
    assert names == ["captures/é/lod0", "captures/é/lod1", "captures/é"]

    (finest,), (coarse,), (prefab,) = (struct.unpack("<I", block(data, place)) for place in pairs[1::2])
    key, internal_id, provider, dependencies, _, extra, kind = struct.unpack_from("<4Ii2I", data, prefab)
    assert (text(data, key), text(data, internal_id)) == ("captures/é", "captures/é@1")
    assert text(data, provider) == "Capture2vr.GlbPrefabProvider"
    assert struct.unpack("<2I", block(data, dependencies)) == (finest, coarse)
    assert string_object(data, extra) == '{"version":1}'
    assert type_names(data, kind)[1] == "UnityEngine.GameObject"

    row = struct.unpack_from("<4Ii2I", data, finest)
    assert row[3] == 0xFFFFFFFF
    type_at, options = struct.unpack_from("<2I", data, row[5])
    assert type_names(data, type_at)[1].endswith(".AssetBundleRequestOptions")
    hash_at, name, crc, size, transfer = struct.unpack_from("<5I", data, options)
    assert data[hash_at : hash_at + 16].hex() == asset("é").files[0].sha256[:32]
    assert (text(data, name), crc, size) == ("lod0", 0, 1000)
    assert data[transfer : transfer + 8] == b"\0\0\x20\0\0\0\0\0"


@pytest.mark.parametrize(
    ("version", "core", "unity"),
    [
        (1, "mscorlib, Version=4.0.0.0, Culture=neutral, PublicKeyToken=b77a5c561934e089", "UnityEngine.CoreModule, V"),
        (2, "mscorlib, Version=4.0.0.0, Culture=neutral, PublicKeyToken=b77a5c561934e089", "UnityEngine.CoreModule, V"),
        (3, "", "UnityEngine.CoreModule"),
    ],
)
def test_the_newest_form_names_assemblies_in_short(version: int, core: str, unity: str) -> None:
    data = written(catalogue(asset(levels=1)), version)
    (keys_at,) = struct.unpack_from("<I", data, 8)
    pairs = struct.unpack("<4I", block(data, keys_at))
    file, prefab = (struct.unpack_from("<7I", data, *struct.unpack("<I", block(data, each))) for each in pairs[1::2])
    assert string_object(data, prefab[5]) == '{"version":1}'
    assert type_names(data, struct.unpack_from("<I", data, prefab[5])[0]) == (core, "System.String")
    assert type_names(data, file[6])[1] == BUNDLE_RESOURCE.name
    assert type_names(data, prefab[6])[0].startswith(unity)
    assert (", " in type_names(data, prefab[6])[0]) == (version < 3)


def block(data: bytes, offset: int) -> bytes:
    """An array or string, whose size stands before it."""
    (size,) = struct.unpack_from("<I", data, offset - 4)
    return data[offset : offset + size]


def text(data: bytes, reference: int) -> str:
    if reference == 0xFFFFFFFF:
        return ""
    return block(data, reference & 0x3FFFFFFF).decode("utf-16-le" if reference >> 31 else "ascii")


def type_names(data: bytes, offset: int) -> tuple[str, str]:
    assembly, name = struct.unpack_from("<2I", data, offset)
    return text(data, assembly), text(data, name)


def string_object(data: bytes, offset: int) -> str:
    type_at, string_at = struct.unpack_from("<2I", data, offset)
    assert type_names(data, type_at)[1] == "System.String"
    reference, separator = struct.unpack_from("<IH", data, string_at)
    assert separator == 0
    return text(data, reference)


def test_the_json_tables_byte_by_byte() -> None:
    """Two files of one asset under one label: four keys and a fifth, the number 2, for both files together."""
    document = json.loads(written(catalogue(asset("a", "ä", levels=2)), 0))
    blobs = {name: b64decode(document[f"m_{name}DataString"]) for name in ("Key", "Bucket", "Entry", "Extra")}
    assert blobs["Key"] == b"".join(
        (
            struct.pack("<i", 5),
            b"\0\x0f\0\0\0captures/a/lod0",
            b"\0\x0f\0\0\0captures/a/lod1",
            b"\0\x0a\0\0\0captures/a",
            b"\1\2\0\0\0\xe4\0",
            b"\4\2\0\0\0",
        )
    )
    assert struct.unpack("<17i", blobs["Bucket"]) == (5, 4, 1, 0, 24, 1, 1, 44, 1, 2, 59, 1, 2, 66, 2, 0, 1)
    count, *entries = struct.unpack("<22i", blobs["Entry"])
    assert count == 3
    second = blobs["Extra"].index(b"\7", 1)
    assert entries[:14] == [0, 0, -1, 0, 0, 0, 0, 1, 0, -1, 0, second, 1, 0]
    assert entries[14:17] == [2, 1, 4]
    assert entries[17] != 0
    assert entries[18:] == [blobs["Extra"].index(b"\0\x0d\0\0\0{"), 2, 1]
    files = [f"{BASE_URL}/{file.url}" for file in asset("a", levels=2).files]
    assert document["m_InternalIds"] == [*files, "captures/a@1"]
    assert document["m_InternalIdPrefixes"] == []
    assert [each["m_ClassName"] for each in document["m_resourceTypes"]] == [
        BUNDLE_RESOURCE.name,
        "UnityEngine.GameObject",
    ]


def test_json_data_is_unitys_class_with_its_field_names() -> None:
    extra = b64decode(json.loads(written(catalogue(asset(levels=1)), 0))["m_ExtraDataString"])
    assembly = b"Unity.ResourceManager, Version=0.0.0.0, Culture=neutral, PublicKeyToken=null"
    name = b"UnityEngine.ResourceManagement.ResourceProviders.AssetBundleRequestOptions"
    head = b"\7" + bytes([len(assembly)]) + assembly + bytes([len(name)]) + name
    assert extra.startswith(head)
    (size,) = struct.unpack_from("<i", extra, len(head))
    fields = json.loads(extra[len(head) + 4 : len(head) + 4 + size].decode("utf-16-le"))
    sha256 = asset(levels=1).files[0].sha256
    assert fields == {"m_Hash": sha256[:32], "m_Crc": 0, "m_BundleName": "lod0", "m_BundleSize": 1000}


def test_a_single_file_is_depended_on_by_its_own_key() -> None:
    document = json.loads(written(catalogue(asset(levels=1)), 0))
    entries = struct.unpack("<15i", b64decode(document["m_EntryDataString"]))
    assert entries[8 + 2] == 0
    assert read_json_catalogue(json.dumps(document).encode()).locations[1].dependencies == (0,)
