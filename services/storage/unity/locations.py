"""Convert assets to the table of locations of a Unity Addressables catalogue, and back.

Every LOD file is a location that `GlbFileProvider` downloads; every asset is one that `GlbPrefabProvider` builds from
its files. All four forms of a catalogue have the same content: the table is made once, and each writer serialises it.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace

from capture2vr.storage.unity.listing import (
    BUNDLE_RESOURCE,
    FILE_PROVIDER,
    GAME_OBJECT,
    PREFAB_PROVIDER,
    BundleOptions,
    Listing,
    Location,
)
from capture2vr.storage.unity.nouns import BASE_URL, LABEL_LIMIT, Asset, Catalogue, LodFile, check_catalogue

PREFIX = "captures/"
_HASH_DIGITS = 32  # hex digits of Unity's Hash128; the whole SHA-256 is in the file's name
_LEVEL = re.compile(r"lod([0-9]{1,9})")
_VERSION = re.compile(r'\{"version":([0-9]{1,9})\}')  # nine digits: more versions than an asset ever has


def build_listing(catalogue: Catalogue) -> Listing:
    """Build the table of locations of a catalogue: assets sorted by key, each after its files, finest first.

    Raises ValueError for what `check_catalogue` refuses, and where a label or an asset has the key of another location.
    """
    found: list[Location] = []
    labelled: defaultdict[str, list[int]] = defaultdict(list)
    for asset in sorted(check_catalogue(catalogue).assets, key=lambda asset: asset.key):
        files = sorted(asset.files, key=lambda file: file.level)
        first = len(found)
        found += [_file_location(asset, file, catalogue.base_url) for file in files]
        found.append(_prefab_location(asset, range(first, len(found))))
        for label in asset.labels:
            labelled[label].append(len(found) - 1)
    keys = _primary_keys(found)
    for label in sorted(labelled):
        if label in keys:
            raise ValueError(f"the label {label!r} is also the key of a location; choose another label")
        keys[label] = tuple(labelled[label])
    return Listing(0, catalogue.locator_id, tuple(found), keys)


def _file_location(asset: Asset, file: LodFile, base_url: str) -> Location:
    name = f"lod{file.level}"
    options = BundleOptions(file.sha256[:_HASH_DIGITS], 0, name, file.size)
    key = f"{PREFIX}{asset.key}/{name}"
    return Location(key, f"{base_url}/{file.url}", FILE_PROVIDER.name, BUNDLE_RESOURCE, options, ())


def _prefab_location(asset: Asset, files: range) -> Location:
    key = f"{PREFIX}{asset.key}"
    data = f'{{"version":{asset.version}}}'
    # Addressables returns the same loaded object for the same id as long as it is referenced. So each version needs an
    # id of its own; files have one through the hash in their names.
    return Location(key, f"{key}@{asset.version}", PREFAB_PROVIDER.name, GAME_OBJECT, data, tuple(files))


def _primary_keys(found: Sequence[Location]) -> dict[str, tuple[int, ...]]:
    """Map each location's key to its index. Raises ValueError unless all keys and all ids are unique.

    A hostile catalogue that stores one long key or id and uses it everywhere would unpack to thousands of times its
    size.
    """
    for what, texts in (("key", [each.key for each in found]), ("id", [each.internal_id for each in found])):
        if len(set(texts)) < len(texts):
            twice = next(text for text, times in Counter(texts).items() if times > 1)
            raise ValueError(f"two locations have the same {what}: {twice!r:.200}")
    return {location.key: (index,) for index, location in enumerate(found)}


def parse_assets(listing: Listing, *, base_url: str = BASE_URL) -> tuple[Asset, ...]:
    """Recover the assets from a listing. Raises ValueError for a listing that this program cannot have written."""
    _primary_keys(listing.locations)
    labels = _labels(listing)
    claimed: set[int] = set()
    found = [
        _asset(listing, location, labels.get(index, ()), base_url, claimed)
        for index, location in enumerate(listing.locations)
        if location.provider == PREFAB_PROVIDER.name
    ]
    # The final check, which catches everything else: the assets must give the same listing again.
    if build_listing(Catalogue(listing.locator_id, tuple(found), base_url)) != replace(listing, form=0):
        raise ValueError(
            f"catalogue {listing.locator_id!r:.200} was not written by capture2vr, or its base URL is not {base_url}"
        )
    return tuple(found)


def _labels(listing: Listing) -> dict[int, list[str]]:
    """Return the labels of each asset's location. Raises ValueError for a label of anything but an asset."""
    labels: defaultdict[int, list[str]] = defaultdict(list)
    for key, indices in listing.keys.items():
        if len(indices) == 1 and listing.locations[indices[0]].key == key:
            continue
        for index in indices:
            labels[index].append(key)
            if listing.locations[index].provider != PREFAB_PROVIDER.name or len(labels[index]) > LABEL_LIMIT:
                raise ValueError(f"{listing.locations[index].key!r:.200} cannot have the label {key!r:.200}")
    return {index: sorted(texts) for index, texts in labels.items()}


def _asset(listing: Listing, location: Location, labels: Sequence[str], base_url: str, claimed: set[int]) -> Asset:
    files = []
    for index in location.dependencies:
        if index in claimed:
            raise ValueError(f"{listing.locations[index].key!r:.200} belongs to two assets")
        claimed.add(index)
        files.append(_file(listing.locations[index], base_url))
    return Asset(location.key.removeprefix(PREFIX), _version(location), tuple(labels), tuple(files))


def _file(location: Location, base_url: str) -> LodFile:
    options, url = location.data, location.internal_id.removeprefix(f"{base_url}/")
    level = _LEVEL.fullmatch(options.name) if isinstance(options, BundleOptions) else None
    if not isinstance(options, BundleOptions) or level is None:
        raise ValueError(f"{location.key!r:.200} is not a LOD file")
    return LodFile(int(level[1]), url, url.removesuffix(".glb")[-64:], options.size)


def _version(location: Location) -> int:
    match = _VERSION.fullmatch(location.data) if isinstance(location.data, str) else None
    if match is None:
        raise ValueError(f"{location.key!r:.200} has no version")
    return int(match[1])
