"""publish(): write a bundle to the store as the new version of an asset, so that readers always find a complete asset.

Order: files, manifest, catalogue entry, alias, the collection's shard, nodes and root, its Unity catalogues. Each
object refers only to objects written before it. So a crash between two steps leaves unreferenced files at worst, and
the next run completes the work.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from capture2vr.order.asset_names import AssetNames
from capture2vr.process.at_once import at_once
from capture2vr.sentences.documents import with_codes
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Bundle, Json
from capture2vr.storage.catalogue.carried_notes import notes_of_next_version
from capture2vr.storage.catalogue.compare_and_swap import canonical_json, put_mutable, retry_on_conflict
from capture2vr.storage.catalogue.entry import (
    DEFAULT_COLLECTION,
    Entry,
    alias_name,
    check_collection,
    check_key,
    entry_name,
    read_entry,
)
from capture2vr.storage.catalogue.job_versions import existing_version, raise_fence
from capture2vr.storage.catalogue.next_entry import HELD_LEVEL, SCHEMA, level_of, lods_of, new_record, next_document
from capture2vr.storage.catalogue.proof import sign_proof
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.stored_file import StoredFile, put_content
from capture2vr.storage.catalogue.update import update_collections
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.store import Store


class KeyElsewhere(Exception):  # noqa: N818 - a fault of who chose the key, not of this program
    """The key belongs to an asset of another collection, and the caller may not list it in a second one."""


@dataclass(frozen=True, slots=True)
class PublishedAsset:
    """A published version of an asset: version counts from 1 for each key; manifest is an object name; held: whether it
    is held back, because its grade says to shoot again.
    """

    key: str
    version: int
    state: str
    manifest: str
    held: bool = False


@dataclass(frozen=True, slots=True)
class PublishPolicy:
    """How bundles are published: with which signing keys, across collections or not, whatever their grade or not, and
    when publishing stops.

    keys                     sign the catalogue entry and the collection's index
    allow_other_collections  whether an asset of another collection may be listed in a second one
    anyway                   whether what its grade says to shoot again is published like anything else
    proceed                  called before each file, and before the version is added; what it raises is passed on, and
                             then nothing but files that nobody refers to has been written
    """

    keys: Keys = NO_KEYS
    allow_other_collections: bool = True
    anyway: bool = False
    proceed: Callable[[], None] = lambda: None


DEFAULT_POLICY = PublishPolicy()
"""Unsigned; an asset may be listed in several collections; publishing runs to its end."""


@dataclass(frozen=True, slots=True)
class _PublishRequest:
    """The job for which a bundle is published, its fencing token, the collection that will list the asset, the
    visibility that it gets, and the publisher's policy.
    """

    job: str
    fence: int
    collection: str
    visibility: Visibility | None
    policy: PublishPolicy

    def check_not_elsewhere(self, present: Entry | None) -> None:
        """Raises KeyElsewhere where the key is an asset of another collection, unless that is allowed."""
        if present and not self.policy.allow_other_collections and self.collection not in present.collections:
            where = say("in_collection", found=present.collections[0], wanted=self.collection)
            raise KeyElsewhere(say("asset_with_key_exists_already_choose", key=present.key, where=where))

    def visibility_of(self, present: Entry | None) -> Visibility | None:
        """Return the asset's visibility from this version on. A job sets it once: with its first version, so that what
        its owner changes afterwards stays.
        """
        if present is None:
            return self.visibility
        return present.visibility if self.has_published(present) or self.visibility is None else self.visibility

    def has_published(self, present: Entry) -> bool:
        """Whether a version of this job is there already."""
        return bool(self.job) and any(each["job"] == self.job for each in present.versions)

    def holds_back(self, present: Entry | None, bundle: Bundle) -> bool:
        """Whether a bundle is held back: its grade says to shoot again, and nobody wants it all the same.

        An asset that is served although its grade says so was kept by somebody, who then edits it.
        """
        was_kept = present is not None and present.grade == HELD_LEVEL and not present.held
        return level_of(bundle.manifest) == HELD_LEVEL and not self.policy.anyway and not was_kept

    def names_of(self, present: Entry | None, given: AssetNames, key: str) -> AssetNames:
        """Return the asset's names from this version on: those that were given, in place of those that it has.

        A job gives them once, with its first version, so that what its owner changes afterwards stays. A label that is
        the key was given by nobody.
        """
        if present is None:
            return given
        if self.has_published(present):
            return present.names
        had = present.names
        return AssetNames(
            label=had.label if given.label in ("", key) and had.label else given.label,
            description=given.description or had.description,
            labels=given.labels or had.labels,
        )


def publish(
    bundle: Bundle,
    store: Store,
    *,
    key: str,
    job: str = "",
    fence: int = 0,
    collection: str = DEFAULT_COLLECTION,
    visibility: Visibility | None = None,
    policy: PublishPolicy = DEFAULT_POLICY,
) -> PublishedAsset:
    """Publish a bundle under `key`, make it the current version, and list it in `collection`.

    One whose grade says to shoot again is held back, unless the policy publishes it anyway: it becomes a version that
    is not listed, nor the current one where another is served, until `restore_version` keeps it. Publishing the same
    (job, state, last) twice adds no version and returns the first; without a job the content is compared instead. A
    new version of a removed asset restores it.
    visibility  the asset's own from this version on; None: the one it has
    Raises StaleFence where the same job has published with a higher fence, KeyElsewhere, ValueError for an invalid key
    or collection, OSError (CatalogueFault too) where the store fails; after that, publish again.
    """
    request = _PublishRequest(job, fence, check_collection(collection), visibility, policy)
    present = _entry_or_none(store, check_key(key))
    request.check_not_elsewhere(present)
    existing = existing_version(present, bundle, job, fence)
    is_done = (
        present is not None
        and collection in present.collections
        and request.visibility_of(present) == present.visibility
    )
    if existing is not None and existing["fence"] >= fence and is_done:
        asset = _published_asset(key, existing)
    else:
        files = at_once([partial(_put_file, store, key, bundle, file, policy.proceed) for file in sorted(bundle.files)])
        manifest = _put_manifest(store, key, bundle, files)
        policy.proceed()
        asset = _add_version(store, key, bundle, files, manifest, request)
    move_alias(store, asset)
    update_collections(store, key, policy.keys)
    return asset


def _put_file(store: Store, key: str, bundle: Bundle, file: str, proceed: Callable[[], None]) -> StoredFile:
    proceed()
    return put_content(store, key, file, bundle.files[file])


def _put_manifest(store: Store, key: str, bundle: Bundle, files: list[StoredFile]) -> StoredFile:
    """Write the manifest. It has no times and no version, so that publishing the same bundle again adds nothing."""
    document = {
        **bundle.manifest,
        "schema": SCHEMA,
        "key": key,
        "state": bundle.state,
        "lods": lods_of(bundle.manifest, files),
        "files": [file.document() for file in files],
    }
    return put_content(store, key, "manifest.json", canonical_json(with_codes(document)))


def _add_version(
    store: Store, key: str, bundle: Bundle, files: list[StoredFile], manifest: StoredFile, request: _PublishRequest
) -> PublishedAsset:
    """Add a version to the catalogue entry. Concurrent publishers each get a version number of their own."""

    def attempt() -> PublishedAsset:
        present = _entry_or_none(store, key)
        request.check_not_elsewhere(present)
        versions = present.versions if present else []
        record = existing_version(present, bundle, request.job, request.fence, manifest.name)
        if present and record:
            document = {**present.document, "versions": raise_fence(versions, record, request.fence)}
        else:
            record = new_record(
                present,
                bundle,
                manifest.name,
                job=request.job,
                fence=request.fence,
                held=request.holds_back(present, bundle),
            )
            document = next_document(present, key, bundle, files, manifest, record)
        present_collections = present.collections if present else []
        document["collections"] = list(dict.fromkeys((*present_collections, request.collection)))
        document["visibility"] = request.visibility_of(present)
        document |= request.names_of(present, AssetNames.of(bundle.manifest), key).as_json
        if present and present.notes and document["version"] != present.version:
            document["notes"] = notes_of_next_version(store, present, document, bundle)
        if signers := request.policy.keys.signers:
            document["proof"] = sign_proof(key, document, signers)
        put_mutable(store, entry_name(key), canonical_json(document), present.etag if present else None)
        return _published_asset(key, record)

    return retry_on_conflict(attempt)


def _published_asset(key: str, record: Mapping[str, Json]) -> PublishedAsset:
    return PublishedAsset(
        key, int(record["version"]), str(record["state"]), str(record["manifest"]), bool(record.get("held"))
    )


def move_alias(store: Store, asset: PublishedAsset) -> None:
    """Point the alias at this version, unless it names a newer one: a slow publisher must not undo a faster one.

    It never names what is held back.
    """
    if asset.held:
        return
    name = alias_name(asset.key)

    def attempt() -> None:
        try:
            etag: str | None = store.head(name).etag
            if json.loads(store.get(name))["version"] >= asset.version:
                return
        except FileNotFoundError:
            etag = None
        put_mutable(store, name, canonical_json({"version": asset.version, "manifest": asset.manifest}), etag)

    retry_on_conflict(attempt)


def _entry_or_none(store: Store, key: str) -> Entry | None:
    try:
        return read_entry(store, key)
    except FileNotFoundError:
        return None
