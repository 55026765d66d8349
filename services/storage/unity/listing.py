"""A catalogue as Unity sees it: locations, each with a provider that loads it, and the keys that lead to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TypeName:
    """A .NET class. The assembly has its simple name, and none if it is the core library, which varies by runtime."""

    assembly: str
    name: str


@dataclass(frozen=True, slots=True)
class BundleOptions:
    """The part of Unity's AssetBundleRequestOptions that is in use: 32 hexadecimal digits, 0, a name, bytes."""

    hash: str
    crc: int
    name: str
    size: int


@dataclass(frozen=True, slots=True)
class Location:
    """One thing that Unity can load. Dependencies are indices into the listing's locations."""

    key: str
    internal_id: str
    provider: str
    type: TypeName
    data: str | BundleOptions | None
    dependencies: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Listing:
    """Everything that a catalogue says.

    form   0 for JSON, else the version of the binary form
    keys   lead to indices of locations
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
FILE_PROVIDER = TypeName("Capture2vr", "Capture2vr.GlbFileProvider")
PREFAB_PROVIDER = TypeName("Capture2vr", "Capture2vr.GlbPrefabProvider")
INSTANCE_PROVIDER = TypeName(
    "Unity.ResourceManager", "UnityEngine.ResourceManagement.ResourceProviders.InstanceProvider"
)
SCENE_PROVIDER = TypeName("Unity.ResourceManager", "UnityEngine.ResourceManagement.ResourceProviders.SceneProvider")


def assembly_name(type_name: TypeName) -> str:
    """The assembly's full name, which all but the newest form carry."""
    if not type_name.assembly:
        return "mscorlib, Version=4.0.0.0, Culture=neutral, PublicKeyToken=b77a5c561934e089"
    return f"{type_name.assembly}, Version=0.0.0.0, Culture=neutral, PublicKeyToken=null"
