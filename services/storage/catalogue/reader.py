"""Reading a collection that others write at the same time: an asset's row and files, and what if a shard has gone."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from services.storage.bundle import sha256_hex
from services.storage.collection import Index, Row, Shard
from services.storage.faults import MANIFEST_CHANGED, SHARD_MISSING, CatalogueFault
from services.storage.store import Store

Rows = Callable[[Shard], Iterable[Row]]
"""The rows of a shard."""

_T = TypeVar("_T")

DOCUMENT_BYTES = 16 << 20
"""More than any shard or manifest has; readers of what nobody has signed stop there."""

_FILE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")  # becomes a file in somebody's folder
_TRIES = 3  # a shard goes once 32 newer ones have come; the index of that moment knows another


_PREFIX = "collections/"


def collections(store: Store) -> Iterator[str]:
    """The names of the collections on a store, in its order; one question for each."""
    after = _PREFIX
    while heads := store.list(_PREFIX, after=after, limit=1):
        name = heads[0].name.removeprefix(_PREFIX).partition("/")[0]
        yield name
        after = f"{_PREFIX}{name}0"  # "0" comes next after "/": behind all that this one has


@dataclass(frozen=True, slots=True)
class Piece:
    """A file of an asset: its plain name in the bundle, its object name, its hash (hex) and its bytes."""

    file: str
    name: str
    sha256: str
    size: int


def pieces_of(data: bytes, row: Row) -> list[Piece]:
    """The files that a manifest lists, if it is the one that the row means. Raises CatalogueFault MANIFEST_CHANGED."""
    if sha256_hex(data) != row.manifest:
        message = f"its {len(data):,} bytes do not have the hash of the catalogue"
        raise CatalogueFault(MANIFEST_CHANGED, row.manifest_name, message)
    try:
        pieces = [
            _piece(each["file"], each["name"], each["sha256"], each["bytes"]) for each in json.loads(data)["files"]
        ]
    except (ValueError, KeyError, TypeError) as error:
        raise CatalogueFault(MANIFEST_CHANGED, row.manifest_name, f"it lists no files: {error}") from None
    if len({piece.file for piece in pieces}) < len(pieces):
        raise CatalogueFault(MANIFEST_CHANGED, row.manifest_name, "it lists a file twice")
    return pieces


def _piece(file: str, name: str, sha256: str, size: int) -> Piece:
    """Raises ValueError, TypeError. The hash becomes a name on a reader's disk too."""
    if not _FILE.fullmatch(file) or file == "manifest.json":  # which is the manifest itself, wherever it is put
        raise ValueError(f"{file!r:.120} is no plain file name")
    if len(bytes.fromhex(sha256)) != 32:
        raise ValueError(f"{file} has no sha256")
    return Piece(file, str(name), sha256.lower(), int(size))


def row_in(index: Index, key: str, rows: Rows) -> tuple[Shard, Row] | None:
    """The row of an asset, and the shard that has it; None where the collection does not list the key."""
    if not index.shards:
        return None
    shard = index.shards[index.place(key)]
    row = next((row for row in rows(shard) if row.key == key), None)
    return (shard, row) if row else None


def again_if_moved(attempt: Callable[[], _T]) -> _T:
    """What an attempt reads, which begins with the index; again where a shard of that index is there no more.

    Raises CatalogueFault SHARD_MISSING where that goes on.
    """
    for left in reversed(range(_TRIES)):
        try:
            return attempt()
        except CatalogueFault as fault:
            if fault.code != SHARD_MISSING or not left:
                raise
    raise AssertionError("the last try returns or raises")
