"""Update a collection's Unity Addressables catalogues (JSON and binary forms) after an asset has changed.

The JSON form is read and replaced by compare-and-swap. The binary forms and the hashes are made from the same table and
written after it. A writer who then finds that the JSON has changed starts again, so that the last to finish has written
the newest.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

from capture2vr.storage.bundle import content_type
from capture2vr.storage.catalogue.collection import index_name, read_index
from capture2vr.storage.catalogue.compare_and_swap import read_mutable, retry_on_conflict
from capture2vr.storage.catalogue.entry import Entry, list_keys, read_entry
from capture2vr.storage.catalogue.visibility import Visibility, lists
from capture2vr.storage.store import NO_CACHE, ConditionFailed, Store
from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.locations import PREFIX, build_listing, parse_assets
from capture2vr.storage.unity.nouns import Asset, Catalogue, LodFile
from capture2vr.storage.unity.publication import catalogue_files, catalogue_names

_log = logging.getLogger(__name__)

_PAGE = 1000  # keys per list request, the most that S3 allows


def update_unity_catalogues(store: Store, key: str) -> None:
    """Update the asset in the Unity catalogues of every collection that lists it.

    Writes nothing where nothing has changed. Leaves out what is removed or held back, and (with a warning in the log)
    what Unity would misread. Raises FileNotFoundError where nothing was published under the key, OSError where the
    store fails.
    """
    for collection in read_entry(store, key).collections:
        retry_on_conflict(lambda collection=collection: _replace(store, key, collection))  # type: ignore[misc]


def rebuild_unity_catalogues(store: Store, collection: str) -> None:
    """Write a collection's Unity catalogues anew from the catalogue entries: its visibility has changed."""

    def attempt() -> None:
        data, etag = read_mutable(store, catalogue_names(collection)[0].catalogue)
        _write(store, collection, _read_assets(store, collection, None), data, etag)

    retry_on_conflict(attempt)


def _replace(store: Store, key: str, collection: str) -> None:
    """Make one attempt to write the catalogues. Raises ConditionFailed where somebody else wrote them meanwhile."""
    data, etag = read_mutable(store, catalogue_names(collection)[0].catalogue)
    assets = {asset.key: asset for asset in _read_assets(store, collection, data)}
    assets.pop(key, None)
    visibility = _visibility_of(store, collection)
    assets |= {asset.key: asset for asset in _unity_asset(read_entry(store, key), visibility)}
    _write(store, collection, tuple(assets.values()), data, etag)


def _visibility_of(store: Store, collection: str) -> Visibility | None:
    """Return the visibility of a collection whose index has just been written or verified; None where there is none."""
    try:
        return read_index(store.get(index_name(collection)), collection).visibility
    except FileNotFoundError:
        return None


def _write(store: Store, collection: str, assets: tuple[Asset, ...], data: bytes | None, etag: str | None) -> None:
    """Write the catalogues of these assets in place of `data`, which was read with `etag`. Raises ConditionFailed."""
    (first, table), *others = catalogue_files(Catalogue(collection, assets), collection)
    if table != data:
        head = store.put(
            first,
            table,
            content_type=content_type(first),
            cache_control=NO_CACHE,
            if_match=etag,
            if_absent=etag is None,
        )
        etag = head.etag
    for name, content in others:
        if not _has_content(store, name, content):
            store.put(name, content, content_type=content_type(name), cache_control=NO_CACHE)
    if store.head(first).etag != etag:
        raise ConditionFailed(f"{first} has changed")


def _has_content(store: Store, name: str, content: bytes) -> bool:
    try:
        return store.head(name).size == len(content) and store.get(name) == content
    except FileNotFoundError:
        return False


def _read_assets(store: Store, collection: str, data: bytes | None) -> tuple[Asset, ...]:
    """Return the assets in the catalogue `data`; where it is missing or damaged, those in the catalogue entries."""
    if data is not None:
        try:
            return parse_assets(read_json_catalogue(data))
        except ValueError as fault:
            _log.warning("the Unity catalogue of collection %s cannot be read and is rebuilt: %s", collection, fault)
    visibility = _visibility_of(store, collection)
    return tuple(asset for found in _entries_of(store, collection) for asset in _unity_asset(found, visibility))


def _entries_of(store: Store, collection: str) -> Iterator[Entry]:
    """Yield the catalogue entries of all assets in a collection."""
    after = ""
    while page := list_keys(store, after=after, limit=_PAGE):
        entries = (read_entry(store, key) for key in page)
        yield from (found for found in entries if collection in found.collections)
        after = page[-1]


def _unity_asset(found: Entry, visibility: Visibility | None) -> tuple[Asset, ...]:
    """Return the asset as the Unity catalogues of a collection of this visibility list it; () if they do not, it is
    removed or held back, has no LODs, or Unity would misread it.
    """
    lods = found.document["lods"]
    if found.removed or found.held or not lods or not lists(visibility, found.visibility):
        return ()
    files = tuple(LodFile(lod["level"], lod["name"], lod["sha256"], lod["bytes"]) for lod in lods)
    # A label that is another asset's address would make the whole catalogue one that Unity misreads.
    labels = sorted({label for label in found.names.labels if not label.startswith(PREFIX)})
    asset = Asset(found.key, found.version, tuple(labels), files)
    try:
        build_listing(Catalogue("", (asset,)))
    except ValueError as fault:
        _log.warning("asset %s is left out of the Unity catalogues: %s", found.key, fault)
        return ()
    return (asset,)
