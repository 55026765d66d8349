"""Keeping a collection's Unity catalogues: an asset's locations are brought up to its catalogue entry, in all forms.

The JSON form is read back and replaced under its etag; the others and the hashes are made from the same table and put
behind it. Whoever finds afterwards that the JSON has moved on writes them anew, so that the last to finish has written
the newest.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

from services.storage.bundle import content_type
from services.storage.catalogue import Entry, entry, list_keys
from services.storage.store import NO_CACHE, ConditionFailed, Store
from services.storage.unity.json_reader import read_json_catalogue
from services.storage.unity.nouns import Asset, Catalogue, LodFile
from services.storage.unity.plan import assets, locations
from services.storage.unity.publication import file_names, publication
from services.storage.writing import read_mutable, until_won

_log = logging.getLogger(__name__)

_PAGE = 1000  # keys at once, which is what S3 lists in one request


def keep(store: Store, key: str) -> None:
    """Bring the Unity catalogues of every collection that the asset belongs to up to its entry.

    Writes nothing where all is as it should be. A removed asset is left out, and one that Unity would misread, which is
    logged. Raises FileNotFoundError where nothing was published under the key, OSError when the store fails.
    """
    for collection in entry(store, key).collections:
        until_won(lambda collection=collection: _replace(store, key, collection))  # type: ignore[misc]


def _replace(store: Store, key: str, collection: str) -> None:
    """One attempt. Raises ConditionFailed where somebody came between."""
    first = file_names(collection)[0].catalogue
    data, etag = read_mutable(store, first)
    known = {asset.key: asset for asset in _known(store, collection, data)}
    known.pop(key, None)
    known |= {asset.key: asset for asset in _wanted(entry(store, key))}
    (_, table), *others = publication(Catalogue(collection, tuple(known.values())), collection)
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
        if not _holds(store, name, content):
            store.put(name, content, content_type=content_type(name), cache_control=NO_CACHE)
    if store.head(first).etag != etag:
        raise ConditionFailed(f"{first} has changed")


def _holds(store: Store, name: str, content: bytes) -> bool:
    try:
        return store.head(name).size == len(content) and store.get(name) == content
    except FileNotFoundError:
        return False


def _known(store: Store, collection: str, data: bytes | None) -> tuple[Asset, ...]:
    """What the catalogue lists; from the entries where there is none, or where it is damaged."""
    if data is not None:
        try:
            return assets(read_json_catalogue(data))
        except ValueError as fault:
            _log.warning("the Unity catalogue of collection %s is made anew: %s", collection, fault)
    return tuple(asset for found in _members(store, collection) for asset in _wanted(found))


def _members(store: Store, collection: str) -> Iterator[Entry]:
    after = ""
    while page := list_keys(store, after=after, limit=_PAGE):
        entries = (entry(store, key) for key in page)
        yield from (found for found in entries if collection in found.collections)
        after = page[-1]


def _wanted(found: Entry) -> tuple[Asset, ...]:
    """The asset as Unity is to see it, if it is to see it."""
    lods = found.document["lods"]
    if found.removed or not lods:
        return ()
    files = tuple(LodFile(lod["level"], lod["name"], lod["sha256"], lod["bytes"]) for lod in lods)
    asset = Asset(found.key, found.version, tuple(sorted(set(found.document.get("labels") or ()))), files)
    try:
        locations(Catalogue("", (asset,)))
    except ValueError as fault:
        _log.warning("asset %s is left out of Unity's catalogues: %s", found.key, fault)
        return ()
    return (asset,)
