"""Content of a Unity Addressables catalogue: locations, each with the provider that loads it, and keys to find them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TypeName:
    """Name of a .NET class. assembly: its short name; "" for the core library, whose name depends on the runtime"""

    assembly: str
    name: str


@dataclass(frozen=True, slots=True)
class BundleOptions:
    """The fields of Unity's AssetBundleRequestOptions that are used.

    hash  32 hexadecimal digits; crc: 0; name: of the file; size: bytes
    """

    hash: str
    crc: int
    name: str
    size: int


@dataclass(frozen=True, slots=True)
class Location:
    """Something that Unity can load. Dependencies are indices into the listing's locations."""

    key: str
    internal_id: str
    provider: str
    type: TypeName
    data: str | BundleOptions | None
    dependencies: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Listing:
    """The whole content of a catalogue.

    form   0 for JSON, else the version of the binary form
    keys   key -> indices of its locations
    """

    form: int
    locator_id: str
    locations: tuple[Location, ...]
    keys: Mapping[str, tuple[int, ...]]


STRING = TypeName("", "System.String")
GAME_OBJECT = TypeName("UnityEngine.CoreModule", "UnityEngine.GameObject")
BUNDLE_OPTIONS = TypeName(
    "Unity.ResourceManager", "UnityEngine.ResourceManagement.ResourceProviders.AssetBundleRequestOptions"
)
BUNDLE_RESOURCE = TypeName(
    "Unity.ResourceManager", "UnityEngine.ResourceManagement.ResourceProviders.IAssetBundleResource"
)
"""What files are to Unity: it downloads in advance only what is of this type."""
FILE_PROVIDER = TypeName("Capture2vr", "Capture2vr.GlbFileProvider")
PREFAB_PROVIDER = TypeName("Capture2vr", "Capture2vr.GlbPrefabProvider")
INSTANCE_PROVIDER = TypeName(
    "Unity.ResourceManager", "UnityEngine.ResourceManagement.ResourceProviders.InstanceProvider"
)
SCENE_PROVIDER = TypeName("Unity.ResourceManager", "UnityEngine.ResourceManagement.ResourceProviders.SceneProvider")


def assembly_name(type_name: TypeName) -> str:
    """Return the assembly's full name, as all forms but v3 store it."""
    if not type_name.assembly:
        return "mscorlib, Version=4.0.0.0, Culture=neutral, PublicKeyToken=b77a5c561934e089"
    return f"{type_name.assembly}, Version=0.0.0.0, Culture=neutral, PublicKeyToken=null"
