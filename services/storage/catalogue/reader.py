"""Read a collection while others write it: find an asset's row, parse its manifest, retry if a shard was replaced."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

from capture2vr.storage.bundle import hash_in_name, sha256_hex
from capture2vr.storage.catalogue.collection import Index, Row, Shard, load_shard
from capture2vr.storage.catalogue.faults import MANIFEST_CHANGED, SHARD_MISSING, CatalogueFault
from capture2vr.storage.store import LAST, Store
from capture2vr.storage.tenant_store import store_of_tenant

LoadRows = Callable[[Shard], Iterable[Row]]
"""Reads the rows of a shard."""
LoadTenantRows = Callable[[str, Shard], Iterable[Row]]
"""Reads the rows of a tenant's shard."""

_T = TypeVar("_T")

DOCUMENT_BYTES = 16 << 20
"""Limit when reading a shard or manifest from an untrusted server; real ones are smaller."""

_CACHED_SHARDS = 64  # parsed shards in memory, 0.7 MB each at most: every search reads all shards of its collection
_FILE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")  # a safe file name: `pull` writes it into the user's folder
_TRIES = 3  # a shard is deleted after 32 newer ones; the index of that moment lists another
_PREFIX = "collections/"


def collection_names(store: Store) -> Iterator[str]:
    """Yield the names of the collections on a store, in its order, with one list request for each."""
    after = _PREFIX
    while heads := store.list(_PREFIX, after=after, limit=1):
        name = heads[0].name.removeprefix(_PREFIX).partition("/")[0]
        yield name
        after = f"{_PREFIX}{name}{LAST}"


@dataclass(frozen=True, slots=True)
class AssetFile:
    """A file that a manifest lists.

    file    plain name in the bundle; name: object name
    sha256  hex; size: bytes
    """

    file: str
    name: str
    sha256: str
    size: int


def parse_manifest(data: bytes, name: str) -> list[AssetFile]:
    """Check a manifest's hash against the one in its object name and return the files that it lists.

    Raises CatalogueFault MANIFEST_CHANGED.
    """
    if sha256_hex(data) != hash_in_name(name):
        message = f"its {len(data):,} bytes do not have the hash that the catalogue lists"
        raise CatalogueFault(MANIFEST_CHANGED, name, message)
    try:
        files = [
            _asset_file(each["file"], each["name"], each["sha256"], each["bytes"]) for each in json.loads(data)["files"]
        ]
    except (ValueError, KeyError, TypeError) as error:
        raise CatalogueFault(MANIFEST_CHANGED, name, f"it lists no valid files: {error}") from None
    if len({each.file for each in files}) < len(files):
        raise CatalogueFault(MANIFEST_CHANGED, name, "it lists a file twice")
    return files


def _asset_file(file: str, name: str, sha256: str, size: int) -> AssetFile:
    """Check one file of a manifest. Raises ValueError, TypeError.

    Name and hash become file names on a reader's disk, so both must be harmless.
    """
    if not _FILE.fullmatch(file) or file == "manifest.json":  # the manifest itself has this name
        raise ValueError(f"{file!r:.120} is not a plain file name")
    if len(bytes.fromhex(sha256)) != 32:
        raise ValueError(f"{file} has no sha256")
    return AssetFile(file, str(name), sha256.lower(), int(size))


def tenant_rows(store: Store) -> LoadTenantRows:
    """Return a function that reads the rows of a tenant's shard and caches them: shards are named by hash, and never
    change.
    """
    return lru_cache(maxsize=_CACHED_SHARDS)(lambda tenant, shard: load_shard(store_of_tenant(store, tenant), shard))


def find_row(index: Index, key: str, rows: LoadRows) -> tuple[Shard, Row] | None:
    """Find the row of an asset and the shard that has it; None where the collection does not list the key."""
    if not index.shards:
        return None
    shard = index.shards[index.shard_number(key)]
    row = next((row for row in rows(shard) if row.key == key), None)
    return (shard, row) if row else None


def retry_if_shard_missing(attempt: Callable[[], _T]) -> _T:
    """Call `attempt`, which reads an index and then its shards; retry when a shard was deleted in between.

    Raises CatalogueFault SHARD_MISSING after three attempts.
    """
    for tries_left in reversed(range(_TRIES)):
        try:
            return attempt()
        except CatalogueFault as fault:
            if fault.code != SHARD_MISSING or not tries_left:
                raise
    raise AssertionError("the last try returns or raises")
