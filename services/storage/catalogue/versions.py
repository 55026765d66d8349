"""Earlier versions of an asset: read one, and restore one as the newest. A version number only ever grows."""

from __future__ import annotations

import json
from typing import Any

from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Json, content_name, sha256_hex
from capture2vr.storage.catalogue.change_entry import change_entry
from capture2vr.storage.catalogue.entry import Entry, read_entry
from capture2vr.storage.catalogue.faults import FILE_MISSING, MANIFEST_CHANGED, MANIFEST_MISSING, CatalogueFault
from capture2vr.storage.catalogue.next_entry import MANIFEST_FIELDS, level_of
from capture2vr.storage.catalogue.proof import sign_proof
from capture2vr.storage.catalogue.publish import PublishedAsset, move_alias
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.store import Store


class UnknownVersion(LookupError):  # noqa: N818 - a mistake of who asks
    """An asset has no version of this number."""


def read_version(store: Store, key: str, version: int) -> Entry:
    """Read an asset's entry as it was with this version; its names, collections and visibility are those of now.

    Raises UnknownVersion, FileNotFoundError for an unknown key, OSError (CatalogueFault too) where the store fails.
    """
    present = read_entry(store, key)
    return Entry(key, present.etag, {**present.document, **_facts_of(store, present, version)})


def restore_version(store: Store, key: str, version: int, keys: Keys = NO_KEYS) -> Entry:
    """Publish an earlier version's files again as the newest version, and return the new entry.

    Does nothing where the current version has the same files. A removed asset is shown again, and what was held back is
    kept. Raises as `read_version` does, CatalogueFault FILE_MISSING too; after a failure of the store, restore it
    again.
    """

    def changes(present: Entry, now: str) -> dict[str, Any]:
        facts = _facts_of(store, present, version)
        if facts["manifest"]["name"] == present.manifest and not present.removed and not present.held:
            return {}
        _require_files(store, facts["files"])
        number = 1 + max(int(each["version"]) for each in present.versions)
        record = {**_record_of(present, version), "version": number, "created": now, "restored": version}
        record.pop("held", None)
        facts |= {"version": number, "updated": now, "versions": [*present.versions, record], "removed": None}
        return {**facts, "proof": sign_proof(key, facts, keys.signers) if keys.signers else None}

    entry = change_entry(store, key, keys, changes)
    move_alias(store, PublishedAsset(key, entry.version, entry.state, entry.manifest))
    return entry


def _record_of(present: Entry, version: int) -> dict[str, Any]:
    for record in present.versions:
        if record["version"] == version:
            return record
    known = ", ".join(str(each["version"]) for each in present.versions)
    raise UnknownVersion(say("asset_has_no_version", key=present.key, version=version, known=known))


def _facts_of(store: Store, present: Entry, version: int) -> dict[str, Any]:
    """Return the fields of an entry that follow from a version, by its manifest."""
    record = _record_of(present, version)
    name = str(record["manifest"])
    try:
        data = store.get(name)
    except FileNotFoundError:
        raise CatalogueFault(MANIFEST_MISSING, name, say("files_version_deleted", version=version)) from None
    sha256 = sha256_hex(data)
    if not name.endswith(f"/{content_name('manifest.json', sha256)}"):
        raise CatalogueFault(MANIFEST_CHANGED, name, "its content is not what its name says")
    manifest: dict[str, Json] = json.loads(data)
    return {
        "version": version,
        "state": record["state"],
        "updated": record["created"],
        "manifest": {"name": name, "sha256": sha256, "bytes": len(data)},
        "lods": manifest["lods"],
        "preview": next((each for each in manifest["files"] if each["file"] == "preview.png"), None),
        "files": manifest["files"],
        "grade": level_of(manifest),
        **{field: manifest.get(field) for field in MANIFEST_FIELDS},
    }


def _require_files(store: Store, files: list[dict[str, Any]]) -> None:
    for file in files:
        try:
            store.head(file["name"])
        except FileNotFoundError:
            raise CatalogueFault(FILE_MISSING, file["name"], say("file_earlier_version_deleted")) from None
