"""File format of a collection: a signed index that lists shards, and shards with one row per asset.

    collections/<name>/index.json            {"signed": "<JSON text>", "signatures": [{"key", "ed25519"}]}, mutable
    collections/<name>/shard.<sha256>.json   {"columns": [...], "words": [...], "rows": [[...], ...]}, immutable

The signed text lists the sha256 of every shard, a row the sha256 of its manifest, a manifest the sha256 of every file:
so one signature covers them all. Its `version` grows by one with every change, so that clients notice an older index.
"""

from __future__ import annotations

import base64
import json
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from capture2vr.storage.bundle import content_name, sha256_hex
from capture2vr.storage.catalogue.compare_and_swap import canonical_json
from capture2vr.storage.catalogue.entry import Entry, check_collection, check_key
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_OLDER,
    CATALOGUE_OTHER,
    CATALOGUE_TRUNCATED,
    SHARD_CHANGED,
    SHARD_MISSING,
    CatalogueFault,
)
from capture2vr.storage.catalogue.signing import PublicKey, Signature, Signer, check_signatures
from capture2vr.storage.catalogue.visibility import Visibility, parse_visibility
from capture2vr.storage.store import Store

SCHEMA = 1
SHARD_ROWS = 1000  # rows of one shard at most: about 140 KB, which is what one update rewrites
RETIRED_SHARDS = 32  # replaced shards that stay on the store, for clients that read an older index a moment ago
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
    """The index's record of a shard: `count` rows with keys from `first` to `last`."""

    name: str
    sha256: str
    bytes: int
    count: int
    first: str
    last: str


@dataclass(frozen=True, slots=True)
class Index:
    """The signed content of a collection's index.

    retired     sha256 of shards that the last few versions listed, oldest first
    visibility  who may read the collection besides its tenant; None: the gateway's default
    """

    collection: str
    version: int
    updated: str
    shards: tuple[Shard, ...]
    retired: tuple[str, ...] = ()
    visibility: Visibility | None = None

    def shard_number(self, key: str) -> int:
        """Return the index of the shard that has the row of a key, or into which it would be inserted."""
        return max(0, bisect_right([shard.first for shard in self.shards], key) - 1)


def index_name(collection: str) -> str:
    """Return the object name of a collection's index. Raises ValueError for an invalid collection name."""
    return f"collections/{check_collection(collection)}/index.json"


def shard_name(collection: str, sha256: str) -> str:
    """Return the object name of a shard."""
    return f"collections/{check_collection(collection)}/{content_name('shard.json', sha256)}"


def row_of(entry: Entry) -> Row:
    """Convert an asset's catalogue entry to its row."""
    document = entry.document
    preview = document["preview"]
    updated = datetime.fromisoformat(document["updated"]).astimezone(UTC)
    return Row(
        key=entry.key,
        label=document.get("label") or "",
        labels=tuple(document.get("labels") or ()),
        version=entry.version,
        state=REMOVED if entry.removed else entry.state,
        updated=int(updated.timestamp()),
        manifest=document["manifest"]["sha256"],
        preview=preview["sha256"] if preview else "",
        bytes=sum(int(file["bytes"]) for file in document["files"]),
        grade=entry.grade,
    )


def sign_index(index: Index, signers: Sequence[Signer]) -> bytes:
    """Return the bytes of the index object: the index as JSON text, and the signature of every signer."""
    document = {"schema": SCHEMA, **asdict(index)}
    text = canonical_json(document)
    return canonical_json({"signed": text.decode(), "signatures": [signer.sign(text) for signer in signers]})


def parse_envelope(data: bytes, collection: str) -> tuple[str, list[Signature]]:
    """Return the signed text and the signatures of an index object, not verified yet.

    Raises CatalogueFault CATALOGUE_TRUNCATED.
    """
    try:
        envelope = json.loads(data)
        signatures = [{"key": str(each["key"]), "ed25519": str(each["ed25519"])} for each in envelope["signatures"]]
        text = envelope["signed"]
    except (ValueError, KeyError, TypeError):
        text = None
    if not isinstance(text, str):
        message = f"its {len(data):,} bytes are not a complete catalogue"
        raise CatalogueFault(CATALOGUE_TRUNCATED, index_name(collection), message)
    return text, list(signatures)


def read_index(
    data: bytes, collection: str, verification_keys: tuple[PublicKey, ...] = (), *, at_least: int = 0
) -> Index:
    """Verify the signature of an index object and parse it. With no verification keys the signature is not checked.

    at_least  the highest version seen before: an older one is refused, even with a valid signature
    Raises CatalogueFault SIGNATURE_*, KEY_UNKNOWN or CATALOGUE_*.
    """
    name = index_name(collection)
    text, signatures = parse_envelope(data, collection)
    check_signatures(name, text.encode(), signatures, verification_keys)
    index = _parse_index(text, name)
    if index.collection != collection:
        raise CatalogueFault(CATALOGUE_OTHER, name, f"it is the catalogue of another collection, {index.collection}")
    if index.version < at_least:
        raise CatalogueFault(
            CATALOGUE_OLDER,
            name,
            f"version {index.version} is older than {at_least}, which was seen before",
            hint="somebody restored an older catalogue, or a cache is stale",
        )
    return index


def shard_data(rows: Sequence[Row], version: int) -> bytes:
    """Return the bytes of a shard object with these rows, sorted by key.

    version  of the index that lists the shard first. It makes the bytes unique: no later index can list a retired
             shard again, so retired shards can be deleted safely.
    """
    words = list(dict.fromkeys(word for row in rows for word in (row.state, row.grade, *row.labels)))
    indices = {word: number for number, word in enumerate(words)}
    cells = [_cells(row, indices) for row in rows]
    return canonical_json({"schema": SCHEMA, "version": version, "columns": _COLUMNS, "words": words, "rows": cells})


def describe_shard(collection: str, rows: Sequence[Row], data: bytes) -> Shard:
    """Return the index's record of a shard with these rows and these bytes."""
    sha256 = sha256_hex(data)
    return Shard(shard_name(collection, sha256), sha256, len(data), len(rows), rows[0].key, rows[-1].key)


def read_shard(data: bytes, shard: Shard) -> tuple[Row, ...]:
    """Check a shard's hash against the index and parse its rows. Raises CatalogueFault SHARD_CHANGED."""
    if sha256_hex(data) != shard.sha256:
        message = f"its {len(data):,} bytes do not have the hash that the index lists"
        raise CatalogueFault(SHARD_CHANGED, shard.name, message, hint=f"the index says {shard.bytes:,} bytes")
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


def _parse_index(text: str, name: str) -> Index:
    try:
        document = json.loads(text)
        return Index(
            collection=str(document["collection"]),
            version=int(document["version"]),
            updated=str(document["updated"]),
            shards=tuple(_parse_shard(document["collection"], each) for each in document["shards"]),
            retired=tuple(map(str, document["retired"])),
            visibility=parse_visibility(document.get("visibility")),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise CatalogueFault(CATALOGUE_TRUNCATED, name, f"the signed text is not a catalogue: {error}") from None


def _parse_shard(collection: str, record: Mapping[str, Any]) -> Shard:
    """Parse the index's record of a shard. Its name is computed from the hash; the one in the record is ignored."""
    sha256 = str(record["sha256"])
    name = shard_name(collection, sha256)
    return Shard(name, sha256, int(record["bytes"]), int(record["count"]), str(record["first"]), str(record["last"]))


def _cells(row: Row, indices: Mapping[str, int]) -> list[Any]:
    """Encode a row compactly, in the order of `_COLUMNS`, because a client downloads all of them.

    Hashes as base64url (43 letters, not 64); states, grades and labels, which repeat, as indices into `words`.
    """
    labels = [indices[label] for label in row.labels]
    facts = (row.key, row.label, labels, row.version, indices[row.state], row.updated)
    return [*facts, _to_base64(row.manifest), _to_base64(row.preview), row.bytes, indices[row.grade]]


def _parse_row(cells: Mapping[str, Any], words: Sequence[str]) -> Row:
    return Row(
        key=check_key(cells["key"]),
        label=cells["label"],
        labels=tuple(words[number] for number in cells["labels"]),
        version=cells["version"],
        state=words[cells["state"]],
        updated=cells["updated"],
        manifest=_from_base64(cells["manifest"]),
        preview=_from_base64(cells["preview"]),
        bytes=cells.get("bytes", 0),
        grade=words[cells["grade"]] if "grade" in cells else "",
    )


def _to_base64(sha256: str) -> str:
    return base64.urlsafe_b64encode(bytes.fromhex(sha256)).decode().rstrip("=")


def _from_base64(encoded: str) -> str:
    return base64.urlsafe_b64decode(encoded + "=" * (-len(encoded) % 4)).hex()
