"""verify(): check a collection's signature and every hash, from the root down to the last file, as a client would."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from capture2vr.storage.catalogue.collection import Row, Shard, read_shard
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_MISSING,
    FILE_CHANGED,
    FILE_MISSING,
    MANIFEST_MISSING,
    SHARD_MISSING,
    CatalogueFault,
)
from capture2vr.storage.catalogue.reader import AssetFile, parse_manifest
from capture2vr.storage.catalogue.root import Index, index_name, read_index, root_name
from capture2vr.storage.catalogue.signing import PublicKey
from capture2vr.storage.catalogue.tree import read_node
from capture2vr.storage.store import Store

Fetch = Callable[[str], Iterable[bytes]]
"""Downloads an object by name and yields its bytes in blocks. Raises FileNotFoundError. Called from several threads."""

_T = TypeVar("_T")

_AT_ONCE = 8  # simultaneous downloads; a gateway promises 32
_BLOCK_BYTES = 8 << 20  # per read: the largest bundles have about 100 MB


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result for one kind of objects: how many were checked, their bytes, and the faults found.

    kind     root | nodes | shards | manifests | files; nodes are of one level, and small collections have none
    summary  of the root: its version and its time; "" for the others
    """

    kind: str
    count: int
    bytes: int
    faults: tuple[CatalogueFault, ...]
    summary: str = ""


def verify(
    fetch: Fetch, collection: str, verification_keys: tuple[PublicKey, ...], *, at_least: int = 0
) -> Iterator[CheckResult]:
    """Check root, nodes, shards, manifests and files, in this order, stopping after the first kind that has faults.

    What a faulty object lists could not be trusted anyway. Files of removed assets are checked too: they may come back.
    """
    index, result = _check_index(fetch, collection, verification_keys, at_least)
    yield result
    if index is None:
        return
    parts = index.parts
    for depth in reversed(range(index.depth)):
        below, result = _check_all("nodes", parts, partial(_check_node, fetch, collection, depth))
        yield result
        if result.faults:
            return
        parts = tuple(part for node in below for part in node)
    shards, result = _check_all("shards", parts, lambda shard: _check_shard(fetch, shard))
    yield result
    if result.faults:
        return
    rows = [row for part in shards for row in part]
    manifests, result = _check_all("manifests", rows, lambda row: _check_manifest(fetch, row))
    yield result
    if result.faults:
        return
    unique = {file.name: file for part in manifests for file in part}
    yield _check_all("files", unique.values(), lambda file: _check_file(fetch, file))[1]


def fetch_from(store: Store) -> Fetch:
    """Return a function that fetches catalogue files from a store, for `verify`."""

    def fetch(name: str) -> Iterator[bytes]:
        start = 0
        while block := store.get(name, start=start, length=_BLOCK_BYTES):
            yield block
            start += len(block)

    return fetch


def _check_index(
    fetch: Fetch, collection: str, verification_keys: tuple[PublicKey, ...], at_least: int
) -> tuple[Index | None, CheckResult]:
    data = b""
    try:
        data = _read_root(fetch, collection)
        index = read_index(data, collection, verification_keys, at_least=at_least)
    except CatalogueFault as fault:
        return None, CheckResult("root", 1, len(data), (fault,))
    return index, CheckResult("root", 1, len(data), (), f"version {index.version}, updated {index.updated}")


def _read_root(fetch: Fetch, collection: str) -> bytes:
    """Read the root; of a collection that only earlier releases have written, its flat index."""
    try:
        return _read_object(fetch, root_name(collection), CATALOGUE_MISSING)
    except CatalogueFault as missing:
        try:
            return _read_object(fetch, index_name(collection), CATALOGUE_MISSING)
        except CatalogueFault:
            raise missing from None


def _check_node(fetch: Fetch, collection: str, depth: int, node: Shard) -> tuple[tuple[Shard, ...], int]:
    data = _read_object(fetch, node.name, SHARD_MISSING)
    return read_node(data, node, collection, depth), len(data)


def _check_all(kind: str, each: Iterable[Any], check: Callable[[Any], tuple[_T, int]]) -> tuple[list[_T], CheckResult]:
    """Run `check`, which returns an object's content and its size in bytes, on every object of a kind, in parallel."""

    def attempt(one: Any) -> tuple[_T, int] | CatalogueFault:
        try:
            return check(one)
        except CatalogueFault as fault:
            return fault

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        results = list(pool.map(attempt, each))
    good = [result for result in results if not isinstance(result, CatalogueFault)]
    faults = tuple(result for result in results if isinstance(result, CatalogueFault))
    return [found for found, _ in good], CheckResult(kind, len(results), sum(size for _, size in good), faults)


def _check_shard(fetch: Fetch, shard: Shard) -> tuple[tuple[Row, ...], int]:
    data = _read_object(fetch, shard.name, SHARD_MISSING)
    return read_shard(data, shard), len(data)


def _check_manifest(fetch: Fetch, row: Row) -> tuple[list[AssetFile], int]:
    """Check a manifest's hash; return the files that it lists, and its size in bytes."""
    data = _read_object(fetch, row.manifest_name, MANIFEST_MISSING)
    return parse_manifest(data, row.manifest_name), len(data)


def _check_file(fetch: Fetch, file: AssetFile) -> tuple[str, int]:
    digest, size = hashlib.sha256(), 0
    try:
        for block in fetch(file.name):
            digest.update(block)
            size += len(block)
    except (FileNotFoundError, ValueError):  # ValueError: an invalid object name
        raise CatalogueFault(FILE_MISSING, file.name, "the manifest lists it, but it is missing") from None
    if size != file.size:
        raise CatalogueFault(FILE_CHANGED, file.name, f"it has {size:,} bytes, the manifest says {file.size:,}")
    if digest.hexdigest() != file.sha256:
        raise CatalogueFault(
            FILE_CHANGED, file.name, f"its {size:,} bytes do not have the hash that the manifest lists"
        )
    return file.name, size


def _read_object(fetch: Fetch, name: str, code: str) -> bytes:
    """Read a small object into memory. Raises CatalogueFault with this code where it is missing."""
    try:
        return b"".join(fetch(name))
    except FileNotFoundError:
        raise CatalogueFault(code, name, "it is missing") from None
