"""Read a collection while others write it: find an asset's row, parse its manifest, retry if a part was replaced."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TypeVar

from capture2vr.storage.bundle import hash_in_name, sha256_hex
from capture2vr.storage.catalogue.collection import Row, Shard, load_shard
from capture2vr.storage.catalogue.faults import MANIFEST_CHANGED, SHARD_MISSING, CatalogueFault
from capture2vr.storage.catalogue.root import Index, index_name, read_index, root_name
from capture2vr.storage.catalogue.signing import PublicKey
from capture2vr.storage.catalogue.tree import LoadNode, load_node, shard_with
from capture2vr.storage.store import LAST, Store
from capture2vr.storage.tenant_store import store_of_tenant

LoadRows = Callable[[Shard], Iterable[Row]]
"""Reads the rows of a shard."""

_T = TypeVar("_T")

DOCUMENT_BYTES = 16 << 20
"""Limit when reading a shard or manifest from an untrusted server; real ones are smaller."""

_CACHED = 2000  # parsed shards in memory, and as many nodes, of about 20 KB each
_FILE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")  # a safe file name: `pull` writes it into the user's folder
_TRIES = 3  # a part is deleted minutes after it was replaced; the root of that moment lists another
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


@dataclass(frozen=True, slots=True)
class TreeParts:
    """How what a root lists is read.

    rows   of a shard
    nodes  (depth of the parts, node) -> parts of a node
    """

    rows: LoadRows
    nodes: LoadNode


def parts_on(store: Store, collection: str) -> TreeParts:
    """Return how the parts of a collection on a store are read."""
    return TreeParts(partial(load_shard, store), partial(load_node, store, collection))


def tenant_parts(store: Store) -> Callable[[str, str], TreeParts]:
    """Return a function (tenant, collection) -> TreeParts that caches what it reads, which is named by hash and never
    changes.
    """

    @lru_cache(maxsize=_CACHED)
    def rows(tenant: str, shard: Shard) -> Iterable[Row]:
        return load_shard(store_of_tenant(store, tenant), shard)

    @lru_cache(maxsize=_CACHED)
    def nodes(tenant: str, collection: str, depth: int, node: Shard) -> tuple[Shard, ...]:
        return load_node(store_of_tenant(store, tenant), collection, depth, node)

    return lambda tenant, collection: TreeParts(partial(rows, tenant), partial(nodes, tenant, collection))


def read_root(store: Store, collection: str, verification_keys: tuple[PublicKey, ...] = ()) -> Index:
    """Read a collection's root; of one that only earlier releases have written, its flat index.

    Raises FileNotFoundError where there is no such collection, CatalogueFault.
    """
    return read_index(read_root_data(store, collection), collection, verification_keys)


def read_root_data(store: Store, collection: str) -> bytes:
    """Read the bytes that `read_root` parses. Raises FileNotFoundError."""
    try:
        return store.get(root_name(collection))
    except FileNotFoundError:
        return store.get(index_name(collection))


def find_row(index: Index, key: str, parts: TreeParts) -> tuple[Shard, Row] | None:
    """Find the row of an asset and the shard that has it; None where the collection does not list the key."""
    shard = shard_with(index, key, parts.nodes)
    row = next((row for row in parts.rows(shard) if row.key == key), None) if shard else None
    return (shard, row) if shard and row else None


def retry_if_shard_missing(attempt: Callable[[], _T]) -> _T:
    """Call `attempt`, which reads a root and then its parts; retry when one was deleted in between.

    Raises CatalogueFault SHARD_MISSING after three attempts.
    """
    for tries_left in reversed(range(_TRIES)):
        try:
            return attempt()
        except CatalogueFault as fault:
            if fault.code != SHARD_MISSING or not tries_left:
                raise
    raise AssertionError("the last try returns or raises")
