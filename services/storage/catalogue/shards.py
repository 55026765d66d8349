"""Write and delete the shards of a collection, each some of its rows in the order of their keys."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from capture2vr.storage.bundle import sha256_hex
from capture2vr.storage.catalogue.collection import SHARD_ROWS, Row, Shard, describe_shard, shard_data, shard_name
from capture2vr.storage.store import Store


def split_rows(rows: Sequence[Row]) -> list[Sequence[Row]]:
    """Split rows into two halves where they exceed one shard; none are no shard.

    Shards are never merged: few rows ever go, and those of removed assets stay.
    """
    if len(rows) <= SHARD_ROWS:
        return [rows] if rows else []
    half = len(rows) // 2
    return [rows[:half], rows[half:]]


def full_shards(rows: Sequence[Row]) -> list[Sequence[Row]]:
    """Cut rows into as few shards as hold them."""
    return [rows[start : start + SHARD_ROWS] for start in range(0, len(rows), SHARD_ROWS)]


def write_shards(store: Store, collection: str, parts: Sequence[Sequence[Row]], version: int) -> list[Shard]:
    """Write shards to the store, and return the records that the index will list."""
    shards = []
    for rows in parts:
        data = shard_data(rows, version)
        shards.append(describe_shard(collection, rows, data))
        store.put(shard_name(collection, sha256_hex(data)), data, content_type="application/json")
    return shards


def delete_shards(store: Store, collection: str, hashes: Sequence[str]) -> None:
    """Delete shards; those that cannot be deleted only take space."""
    for sha256 in hashes:
        with suppress(OSError):  # a failed deletion costs only space; it must not fail the publication
            store.delete(shard_name(collection, sha256))
