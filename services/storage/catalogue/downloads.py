"""Cache of an asset's downloads on the store: each file is made once, under a name that has its hash.

`assets/KEY/downloads/HASH.json` names the file of one version in one format; HASH is that of what it is made from. Both
lie below the asset's own prefix: who may read the asset may read them, and deleting the asset deletes them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from capture2vr.order.download_formats import WRITERS, DownloadFormat
from capture2vr.storage.bundle import content_name, content_type, hash_in_name, sha256_hex
from capture2vr.storage.catalogue.compare_and_swap import canonical_json
from capture2vr.storage.catalogue.entry import check_key, entry_name
from capture2vr.storage.store import Store


@dataclass(frozen=True, slots=True)
class DownloadOrder:
    """A version of an asset in a format. manifest: sha256 of the version's manifest, hex; the tenant is the store's"""

    key: str
    manifest: str
    format: DownloadFormat

    @property
    def record_name(self) -> str:
        """Object name of the record that names the file."""
        made_from = sha256_hex(f"{WRITERS} {self.format.name} {self.manifest}".encode())
        return f"assets/{check_key(self.key)}/downloads/{made_from}.json"


@dataclass(frozen=True, slots=True)
class StoredDownload:
    """A file that was made: its object name, its size in bytes."""

    name: str
    size: int

    @property
    def sha256(self) -> str:
        """The file's hash, hex."""
        return hash_in_name(self.name) or ""


def find_download(store: Store, order: DownloadOrder) -> StoredDownload | None:
    """Return the file where it was made and is still there, else None. Raises OSError."""
    try:
        record = json.loads(store.get(order.record_name))
        name = str(record["name"])
        if not name.startswith(f"assets/{order.key}/"):
            return None
        return StoredDownload(name, store.head(name).size)
    except (FileNotFoundError, ValueError, KeyError, TypeError):  # missing or damaged: it is made again
        return None


def store_download(store: Store, order: DownloadOrder, made: Path, bundle_files: Mapping[str, str]) -> StoredDownload:
    """Write a file that was made and its record. Who writes last wins; both then name files that are there.

    bundle_files  object names of the version's own files, by hash: one of them is named where it is the same
    Raises FileNotFoundError, and leaves nothing, where the asset was deleted meanwhile; OSError.
    """
    with made.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    own = content_name(order.format.file_name(order.key), sha256)
    name = bundle_files.get(sha256, f"assets/{check_key(order.key)}/{own}")
    if sha256 not in bundle_files:
        store.put(name, made, content_type=content_type(own))
    store.put(order.record_name, canonical_json({"name": name}), content_type="application/json")
    try:
        store.head(entry_name(order.key))
    except FileNotFoundError:
        for each in (order.record_name, name):
            store.delete(each)
        raise
    return StoredDownload(name, made.stat().st_size)
