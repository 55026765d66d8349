"""Write a collection's Unity Addressables catalogues (JSON and binary forms) from its rows.

The JSON form is read and replaced by compare-and-swap. The binary forms and the hashes are made from the same table and
written after it. A writer who then finds that the JSON has changed starts again, so that the last to finish has written
the newest.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial

from capture2vr.process.at_once import at_once
from capture2vr.storage.bundle import content_type
from capture2vr.storage.catalogue.collection import Row
from capture2vr.storage.catalogue.compare_and_swap import read_mutable, retry_on_conflict
from capture2vr.storage.catalogue.entry import Entry, read_entry
from capture2vr.storage.store import NO_CACHE, ConditionFailed, Store
from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.locations import PREFIX, build_listing, parse_assets
from capture2vr.storage.unity.nouns import Asset, Catalogue, LodFile
from capture2vr.storage.unity.publication import catalogue_files, catalogue_names

_log = logging.getLogger(__name__)


def write_unity_catalogues(store: Store, collection: str, read_rows: Callable[[], Sequence[Row]]) -> None:
    """Write the Unity catalogues of a collection with the rows that it has now. Only changed entries are read.

    Writes nothing where nothing has changed. Leaves out what is removed, and (with a warning in the log) what Unity
    would misread. Raises OSError where the store fails.
    """

    def attempt() -> None:
        data, etag = read_mutable(store, catalogue_names(collection)[0].catalogue)
        had = {asset.key: asset for asset in _read_assets(collection, data)}
        listed = [row for row in read_rows() if not row.removed]  # read after the etag: the last writer has the newest
        found = at_once([partial(_asset_of, store, row, had.get(row.key)) for row in listed])
        _write(store, collection, tuple(asset for asset in found if asset is not None), data, etag)

    retry_on_conflict(attempt)


def delete_unity_catalogues(store: Store, collection: str) -> None:
    """Delete a collection's Unity catalogues, which has become too large for them; first what clients ask for first."""
    for names in catalogue_names(collection):
        for name in (names.hash, names.catalogue):
            store.delete(name)


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


def _read_assets(collection: str, data: bytes | None) -> tuple[Asset, ...]:
    """Return the assets in the catalogue `data`; none where it is missing or damaged."""
    if data is None:
        return ()
    try:
        return parse_assets(read_json_catalogue(data))
    except ValueError as fault:
        _log.warning("the Unity catalogue of collection %s cannot be read and is rebuilt: %s", collection, fault)
        return ()


def _asset_of(store: Store, row: Row, had: Asset | None) -> Asset | None:
    """Return the asset of a row: the one that the catalogue had where it is the same, else from its entry."""
    if had is not None and (had.version, had.labels) == (row.version, _labels(row.labels)):
        return had
    try:
        return _unity_asset(read_entry(store, row.key))
    except FileNotFoundError:  # deleted since
        return None


def _labels(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the labels that Unity has: one that is another asset's address would make it misread the catalogue."""
    return tuple(sorted({label for label in labels if not label.startswith(PREFIX)}))


def _unity_asset(found: Entry) -> Asset | None:
    """Return the asset as Unity lists it; None if it has no LODs, or Unity would misread it."""
    lods = found.document["lods"]
    if found.removed or found.held or not lods:
        return None
    files = tuple(LodFile(lod["level"], lod["name"], lod["sha256"], lod["bytes"]) for lod in lods)
    asset = Asset(found.key, found.version, _labels(found.tags), files)
    try:
        build_listing(Catalogue("", (asset,)))
    except ValueError as fault:
        _log.warning("asset %s is left out of the Unity catalogues: %s", found.key, fault)
        return None
    return asset
