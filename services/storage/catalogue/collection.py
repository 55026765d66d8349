"""File format of a collection's rows: shards with one row per asset, and the records that list them.

    collections/<name>/shard.<sha256>.json   {"columns": [...], "words": [...], "rows": [[...], ...]}, immutable

A row lists the sha256 of its manifest, and a manifest the sha256 of every file. `root.py` tells what lists shards.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from capture2vr.storage.bundle import content_name, sha256_hex
from capture2vr.storage.catalogue.compare_and_swap import canonical_json
from capture2vr.storage.catalogue.entry import Entry, check_collection, check_key
from capture2vr.storage.catalogue.faults import SHARD_CHANGED, SHARD_MISSING, CatalogueFault
from capture2vr.storage.store import Store

SCHEMA = 1
REMOVED = "removed"
_COLUMNS = ("key", "label", "labels", "version", "state", "updated", "manifest", "preview", "bytes", "grade")
_PREVIEW = "preview.png"


@dataclass(frozen=True, slots=True)
class Row:
    """One asset in a collection.

    labels    search terms; `label` is the name for people, or ""
    state     preview | refined | removed; a removed asset keeps its row, so that clients can report the removal
    updated   seconds since 1970 of the last publication, removal or restoration
    manifest  sha256 (hex) of the manifest, from which its object name follows
    preview   sha256 (hex) of preview.png, or ""
    bytes     of all files of the version; 0: not known, as in shards that were written before rows had it
    grade     level of the version's grade; "": nothing could tell, or the shard was written before rows had it
    """

    key: str
    label: str
    labels: tuple[str, ...]
    version: int
    state: str
    updated: int
    manifest: str
    preview: str
    bytes: int = 0
    grade: str = ""

    @property
    def manifest_name(self) -> str:
        return f"assets/{self.key}/{content_name('manifest.json', self.manifest)}"

    @property
    def preview_name(self) -> str:
        """Object name of preview.png, or ""."""
        return f"assets/{self.key}/{content_name(_PREVIEW, self.preview)}" if self.preview else ""

    @property
    def removed(self) -> bool:
        return self.state == REMOVED


@dataclass(frozen=True, slots=True)
class Shard:
    """The record of a shard in what lists it, and likewise of a node: `count` rows with keys from `first` to `last`."""

    name: str
    sha256: str
    bytes: int
    count: int
    first: str
    last: str


def shard_name(collection: str, sha256: str) -> str:
    """Return the object name of a shard."""
    return f"collections/{check_collection(collection)}/{content_name('shard.json', sha256)}"


def node_name(collection: str, sha256: str) -> str:
    """Return the object name of a node."""
    return f"collections/{check_collection(collection)}/{content_name('node.json', sha256)}"


def row_of(entry: Entry) -> Row:
    """Convert an asset's catalogue entry to its row."""
    document = entry.document
    preview = document["preview"]
    updated = datetime.fromisoformat(document["updated"]).astimezone(UTC)
    return Row(
        key=entry.key,
        label=document.get("label") or "",
        labels=entry.tags,
        version=entry.version,
        state=REMOVED if entry.removed else entry.state,
        updated=int(updated.timestamp()),
        manifest=document["manifest"]["sha256"],
        preview=preview["sha256"] if preview else "",
        bytes=sum(int(file["bytes"]) for file in document["files"]),
        grade=entry.grade,
    )


def shard_data(rows: Sequence[Row], commit: str) -> bytes:
    """Return the bytes of a shard object with these rows, sorted by key.

    commit  of the root that lists the shard first, which makes the bytes unique
    """
    words = list(dict.fromkeys(word for row in rows for word in (row.state, row.grade, *row.labels)))
    indices = {word: number for number, word in enumerate(words)}
    cells = [_cells(row, indices) for row in rows]
    return canonical_json({"schema": SCHEMA, "commit": commit, "columns": _COLUMNS, "words": words, "rows": cells})


def describe_shard(collection: str, rows: Sequence[Row], data: bytes) -> Shard:
    """Return the record of a shard with these rows and these bytes."""
    sha256 = sha256_hex(data)
    return Shard(shard_name(collection, sha256), sha256, len(data), len(rows), rows[0].key, rows[-1].key)


def check_part(data: bytes, part: Shard) -> None:
    """Check the hash of a shard's or node's bytes. Raises CatalogueFault SHARD_CHANGED."""
    if sha256_hex(data) != part.sha256:
        message = f"its {len(data):,} bytes do not have the hash that the catalogue lists"
        raise CatalogueFault(SHARD_CHANGED, part.name, message, hint=f"the catalogue says {part.bytes:,} bytes")


def read_shard(data: bytes, shard: Shard) -> tuple[Row, ...]:
    """Check a shard's hash against the record of it and parse its rows. Raises CatalogueFault SHARD_CHANGED."""
    check_part(data, shard)
    try:
        document = json.loads(data)
        columns, words = document["columns"], document["words"]
        return tuple(_parse_row(dict(zip(columns, cells, strict=True)), words) for cells in document["rows"])
    except (ValueError, LookupError, TypeError) as error:
        raise CatalogueFault(SHARD_CHANGED, shard.name, f"its rows cannot be read: {error}") from None


def load_shard(store: Store, shard: Shard) -> tuple[Row, ...]:
    """Read the rows of a shard from the store. Raises CatalogueFault SHARD_MISSING, SHARD_CHANGED."""
    try:
        return read_shard(store.get(shard.name), shard)
    except FileNotFoundError:
        raise CatalogueFault(SHARD_MISSING, shard.name, "it is not on the store") from None


def _cells(row: Row, indices: Mapping[str, int]) -> list[Any]:
    """Encode a row compactly, in the order of `_COLUMNS`, because a client downloads all of them.

    Hashes as base64url (43 letters, not 64); states, grades and labels, which repeat, as indices into `words`.
    """
    labels = [indices[label] for label in row.labels]
    facts = (row.key, row.label, labels, row.version, indices[row.state], row.updated)
    return [*facts, to_base64(row.manifest), to_base64(row.preview), row.bytes, indices[row.grade]]


def _parse_row(cells: Mapping[str, Any], words: Sequence[str]) -> Row:
    return Row(
        key=check_key(cells["key"]),
        label=cells["label"],
        labels=tuple(words[number] for number in cells["labels"]),
        version=cells["version"],
        state=words[cells["state"]],
        updated=cells["updated"],
        manifest=from_base64(cells["manifest"]),
        preview=from_base64(cells["preview"]),
        bytes=cells.get("bytes", 0),
        grade=words[cells["grade"]] if "grade" in cells else "",
    )


def to_base64(sha256: str) -> str:
    """Return a sha256 in hex as base64url without padding: 43 letters; "" of none."""
    return base64.urlsafe_b64encode(bytes.fromhex(sha256)).decode().rstrip("=")


def from_base64(encoded: str) -> str:
    """Return the sha256 as hex of its 43 letters; "" of none."""
    return base64.urlsafe_b64decode(encoded + "=" * (-len(encoded) % 4)).hex()
