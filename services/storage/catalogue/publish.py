"""publish(): put a bundle under an asset key so that every reader, at every moment, finds a whole asset.

Order: files, manifest, catalogue entry, moving alias, the collection's shard, its index, its Unity catalogues. Whatever
is written refers only to what was written before it, so a crash between any two steps leaves unreferenced files at
worst, and the next run completes the work.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from services.storage.bundle import Bundle, Json, content_name, content_type, sha256_hex
from services.storage.catalogue import (
    DEFAULT_COLLECTION,
    Entry,
    alias_name,
    check_collection,
    check_key,
    entry,
    entry_name,
)
from services.storage.collect import enter
from services.storage.signing import NO_KEYS, Keys
from services.storage.store import Store
from services.storage.unity.keep import keep
from services.storage.writing import encoded, now_iso, put_mutable, until_won

SCHEMA = 1
_FROM_MANIFEST = ("scale_confidence", "capture_to_asset", "bounds_m", "size_m", "label", "labels", "origin")


class StaleFence(Exception):  # noqa: N818 - not a fault: the job has moved to another worker
    """The job was leased again since this publisher began; its result is void."""


class KeyElsewhere(Exception):  # noqa: N818 - a fault of who chose the key, not of this program
    """The key means an asset of another collection, and this publisher may not take it along."""


@dataclass(frozen=True, slots=True)
class Asset:
    """What was published: version counts from 1 under its key; manifest is an object name."""

    key: str
    version: int
    state: str
    manifest: str


@dataclass(frozen=True, slots=True)
class _Stored:
    """A file of the bundle on the store."""

    file: str
    name: str
    sha256: str
    size: int

    def document(self) -> dict[str, Json]:
        return {"file": self.file, "name": self.name, "sha256": self.sha256, "bytes": self.size}


@dataclass(frozen=True, slots=True)
class _Order:
    """On whose behalf something is published, and where it is listed."""

    job: str
    fence: int
    collection: str
    joins: bool

    def require_room(self, present: Entry | None) -> None:
        """Raises KeyElsewhere."""
        if present and not self.joins and self.collection not in present.collections:
            place = f"in collection {present.collections[0]}, not in {self.collection}"
            raise KeyElsewhere(f"there is an asset {present.key} already, {place}")


class Publish(Protocol):
    """`publish` with its keys chosen, and without joining: what a worker is given."""

    def __call__(self, bundle: Bundle, store: Store, *, key: str, job: str, fence: int, collection: str) -> Asset: ...


def publish(
    bundle: Bundle,
    store: Store,
    *,
    key: str,
    job: str = "",
    fence: int = 0,
    collection: str = DEFAULT_COLLECTION,
    keys: Keys = NO_KEYS,
    joins: bool = True,
) -> Asset:
    """Publish a bundle under `key`, make it the current version, and list it in `collection`, signed with `keys`.

    Publishing the same (job, state) twice adds no version and answers with the first; without a job the content
    decides. A new version of a removed asset brings it back. With `joins` an asset of another collection is listed here
    too. Raises StaleFence when a publisher of the same job had a higher fence, KeyElsewhere, ValueError for an invalid
    key or collection, OSError when the store fails, of which CatalogueFault is one; after that, publish again.
    """
    order = _Order(job, fence, check_collection(collection), joins)
    present = _entry_or_none(store, check_key(key))
    order.require_room(present)
    settled = _settled(present, bundle.state, job, fence)
    is_listed = present is not None and collection in present.collections
    if settled is not None and settled["fence"] >= fence and is_listed:
        asset = _asset(key, settled)
    else:
        files = [_put_content(store, key, file, data) for file, data in sorted(bundle.files.items())]
        manifest = _put_manifest(store, key, bundle, files)
        asset = _enter(store, key, bundle, files, manifest, order)
    _move_alias(store, asset)
    enter(store, key, keys)
    keep(store, key)
    return asset


def _put_content(store: Store, key: str, file: str, data: bytes) -> _Stored:
    sha256 = sha256_hex(data)
    stored = _Stored(file, f"assets/{key}/{content_name(file, sha256)}", sha256, len(data))
    if not _has(store, stored):
        store.put(stored.name, data, content_type=content_type(file))
    return stored


def _has(store: Store, stored: _Stored) -> bool:
    try:
        return store.head(stored.name).size == stored.size
    except FileNotFoundError:
        return False


def _put_manifest(store: Store, key: str, bundle: Bundle, files: list[_Stored]) -> _Stored:
    """No times and no version in it: the same bundle always gives the same manifest, so a repeated run adds nothing."""
    document = {
        **bundle.manifest,
        "schema": SCHEMA,
        "key": key,
        "state": bundle.state,
        "lods": _lods(bundle.manifest, files),
        "files": [file.document() for file in files],
    }
    return _put_content(store, key, "manifest.json", encoded(document))


def _enter(store: Store, key: str, bundle: Bundle, files: list[_Stored], manifest: _Stored, order: _Order) -> Asset:
    """Add a version to the catalogue entry; among concurrent publishers every one gets a version of its own."""

    def attempt() -> Asset:
        present = _entry_or_none(store, key)
        order.require_room(present)
        versions = present.versions if present else []
        record = _settled(present, bundle.state, order.job, order.fence, manifest.name)
        if present and record:
            document = {**present.document, "versions": _with_fence(versions, record, order.fence)}
        else:
            record = _new_record(versions, bundle.state, manifest.name, order)
            document = _document(key, bundle, files, manifest, record, versions)
        listed = present.collections if present else []
        document["collections"] = list(dict.fromkeys((*listed, order.collection)))
        put_mutable(store, entry_name(key), encoded(document), present.etag if present else None)
        return _asset(key, record)

    return until_won(attempt)


def _settled(present: Entry | None, state: str, job: str, fence: int, manifest: str = "") -> dict[str, Any] | None:
    """The version that makes this publication superfluous, if there is one. Raises StaleFence."""
    versions = present.versions if present else []
    if not job:
        return next((each for each in versions[-1:] if each["manifest"] == manifest), None)
    mine = [each for each in versions if each["job"] == job]
    newest = max((int(each["fence"]) for each in mine), default=fence)
    if newest > fence:
        raise StaleFence(f"job {job} has published under fence {newest}; fence {fence} is void")
    # A preview that comes behind its own refined version would take the asset a step back, so that one answers for it.
    return next((each for wanted in (state, "refined") for each in mine if each["state"] == wanted), None)


def _with_fence(versions: list[dict[str, Any]], record: dict[str, Any], fence: int) -> list[dict[str, Any]]:
    """The versions with a higher fence noted, so that the job's earlier worker is refused from now on."""
    return [{**each, "fence": fence} if each["version"] == record["version"] else each for each in versions]


def _new_record(versions: list[dict[str, Any]], state: str, manifest: str, order: _Order) -> dict[str, Any]:
    return {
        "version": 1 + max((int(each["version"]) for each in versions), default=0),
        "state": state,
        "job": order.job,
        "fence": order.fence,
        "manifest": manifest,
        "created": now_iso(),
    }


def _document(
    key: str,
    bundle: Bundle,
    files: list[_Stored],
    manifest: _Stored,
    record: dict[str, Any],
    versions: list[dict[str, Any]],
) -> dict[str, Json]:
    """The catalogue entry that makes `record` the current version behind `versions`."""
    return {
        "schema": SCHEMA,
        "key": key,
        "version": record["version"],
        "state": bundle.state,
        "updated": record["created"],
        "manifest": {"name": manifest.name, "sha256": manifest.sha256, "bytes": manifest.size},
        "lods": _lods(bundle.manifest, files),
        "preview": next((file.document() for file in files if file.file == "preview.png"), None),
        "files": [file.document() for file in files],
        **{field: bundle.manifest.get(field) for field in _FROM_MANIFEST},
        "versions": [*versions, record],
    }


def _asset(key: str, record: Mapping[str, Json]) -> Asset:
    return Asset(key, int(record["version"]), str(record["state"]), str(record["manifest"]))


def _move_alias(store: Store, asset: Asset) -> None:
    """Point the alias at the asset, never backwards: a slow publisher must not undo a faster one."""
    name = alias_name(asset.key)

    def attempt() -> None:
        try:
            etag: str | None = store.head(name).etag
            if json.loads(store.get(name))["version"] >= asset.version:
                return
        except FileNotFoundError:
            etag = None
        put_mutable(store, name, encoded({"version": asset.version, "manifest": asset.manifest}), etag)

    until_won(attempt)


def _entry_or_none(store: Store, key: str) -> Entry | None:
    try:
        return entry(store, key)
    except FileNotFoundError:
        return None


def _lods(manifest: Mapping[str, Json], files: list[_Stored]) -> list[dict[str, Any]]:
    """The manifest's levels of detail with the place of each file, finest first."""
    places = {file.file: file.document() for file in files}
    levels = ({**level, **places[level["file"]]} for level in manifest.get("lods", ()))
    return sorted(levels, key=lambda level: int(level["level"]))
