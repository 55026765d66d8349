"""verify(): follow the hashes from a collection's signed index down to the last file, as a client would."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

from services.storage.collection import Index, Row, Shard, index_name, read_index, read_shard
from services.storage.faults import (
    CATALOGUE_MISSING,
    FILE_CHANGED,
    FILE_MISSING,
    MANIFEST_MISSING,
    SHARD_MISSING,
    CatalogueFault,
)
from services.storage.reading import Piece, pieces_of
from services.storage.signing import Public
from services.storage.store import Store

Fetch = Callable[[str], Iterable[bytes]]
"""The bytes of an object by its name, in blocks. Raises FileNotFoundError. Called from several threads."""

_T = TypeVar("_T")

_AT_ONCE = 8  # downloads; a gateway promises 32
_BLOCK_BYTES = 8 << 20  # of a file at once: the largest bundles have some 100 MB


@dataclass(frozen=True, slots=True)
class Checked:
    """One class of objects: how many were looked at, their bytes, and what is wrong with them.

    what  index | shards | manifests | files
    said  about the index: its version and shards
    """

    what: str
    count: int
    bytes: int
    faults: tuple[CatalogueFault, ...]
    said: str = ""


def verify(fetch: Fetch, collection: str, believed: tuple[Public, ...], *, at_least: int = 0) -> Iterator[Checked]:
    """Index, shards, manifests, files, in this order; ends behind the first class that has faults.

    What comes behind such a class could not be trusted anyway. Files of removed assets count: they can come back.
    """
    index, seen = _checked_index(fetch, collection, believed, at_least)
    yield seen
    if index is None:
        return
    shards, seen = _checked_all("shards", index.shards, lambda shard: _rows(fetch, shard))
    yield seen
    if seen.faults:
        return
    rows = [row for part in shards for row in part]
    manifests, seen = _checked_all("manifests", rows, lambda row: _files(fetch, row))
    yield seen
    if seen.faults:
        return
    unique = {file.name: file for part in manifests for file in part}
    yield _checked_all("files", unique.values(), lambda file: _file(fetch, file))[1]


def fetch_from(store: Store) -> Fetch:
    """The objects of a store."""

    def fetch(name: str) -> Iterator[bytes]:
        start = 0
        while block := store.get(name, start=start, length=_BLOCK_BYTES):
            yield block
            start += len(block)

    return fetch


def _checked_index(
    fetch: Fetch, collection: str, believed: tuple[Public, ...], at_least: int
) -> tuple[Index | None, Checked]:
    name, data = index_name(collection), b""
    try:
        data = _whole(fetch, name, CATALOGUE_MISSING)
        index = read_index(data, collection, believed, at_least=at_least)
    except CatalogueFault as fault:
        return None, Checked("index", 1, len(data), (fault,))
    return index, Checked("index", 1, len(data), (), f"version {index.version}, updated {index.updated}")


def _checked_all(what: str, each: Iterable[Any], check: Callable[[Any], tuple[_T, int]]) -> tuple[list[_T], Checked]:
    """Every object of a class through `check`, which gives what it holds and its bytes."""

    def attempt(one: Any) -> tuple[_T, int] | CatalogueFault:
        try:
            return check(one)
        except CatalogueFault as fault:
            return fault

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        results = list(pool.map(attempt, each))
    good = [result for result in results if not isinstance(result, CatalogueFault)]
    faults = tuple(result for result in results if isinstance(result, CatalogueFault))
    return [found for found, _ in good], Checked(what, len(results), sum(size for _, size in good), faults)


def _rows(fetch: Fetch, shard: Shard) -> tuple[tuple[Row, ...], int]:
    data = _whole(fetch, shard.name, SHARD_MISSING)
    return read_shard(data, shard), len(data)


def _files(fetch: Fetch, row: Row) -> tuple[list[Piece], int]:
    """What a manifest lists, once it is the one that the row means."""
    data = _whole(fetch, row.manifest_name, MANIFEST_MISSING)
    return pieces_of(data, row), len(data)


def _file(fetch: Fetch, file: Piece) -> tuple[str, int]:
    digest, size = hashlib.sha256(), 0
    try:
        for block in fetch(file.name):
            digest.update(block)
            size += len(block)
    except (FileNotFoundError, ValueError):  # ValueError: a name that no store takes
        raise CatalogueFault(FILE_MISSING, file.name, "the manifest lists it, and it is not there") from None
    if size != file.size:
        raise CatalogueFault(FILE_CHANGED, file.name, f"it has {size:,} bytes, the manifest says {file.size:,}")
    if digest.hexdigest() != file.sha256:
        raise CatalogueFault(FILE_CHANGED, file.name, f"its {size:,} bytes do not have the hash of the manifest")
    return file.name, size


def _whole(fetch: Fetch, name: str, code: str) -> bytes:
    """A small object. Raises CatalogueFault of this class where it is absent."""
    try:
        return b"".join(fetch(name))
    except FileNotFoundError:
        raise CatalogueFault(code, name, "it is not there") from None
