"""A collection: a signed index of shards, and shards of rows, from which a client learns the hash of everything else.

    collections/<name>/index.json            {"signed": "<JSON text>", "signatures": [{"key", "ed25519"}]}, mutable
    collections/<name>/shard.<sha256>.json   {"columns": [...], "words": [...], "rows": [[...], ...]}, immutable

The signed text names every shard by its sha256, a row its manifest by its sha256, a manifest every file by its sha256:
one signature covers them all. `version` in it grows by one with every change, so that an older text is known as such.
"""

from __future__ import annotations

import base64
import json
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from services.storage.bundle import content_name, sha256_hex
from services.storage.catalogue import Entry, check_collection, check_key
from services.storage.faults import (
    CATALOGUE_OLDER,
    CATALOGUE_OTHER,
    CATALOGUE_TRUNCATED,
    SHARD_CHANGED,
    SHARD_MISSING,
    CatalogueFault,
)
from services.storage.signing import Public, Signature, Signer, check_signatures
from services.storage.store import Store
from services.storage.writing import encoded

SCHEMA = 1
SHARD_ROWS = 1000  # at most; a shard of these has some 140 KB, which is what one update rewrites
RETIRED = 32  # shards that stay for clients that read an older index a moment ago
REMOVED = "removed"
_COLUMNS = ("key", "label", "labels", "version", "state", "updated", "manifest", "preview")
_PREVIEW = "preview.png"


@dataclass(frozen=True, slots=True)
class Row:
    """An asset as a collection knows it.

    labels    to search by; `label` is the one name for people, or ""
    state     preview | refined | removed; a removed asset keeps its row, so that a client can tell
    updated   seconds since 1970 of the last publication, removal or restoration
    manifest  sha256 (hex) of the manifest, and so its name
    preview   sha256 (hex) of preview.png, or ""
    """

    key: str
    label: str
    labels: tuple[str, ...]
    version: int
    state: str
    updated: int
    manifest: str
    preview: str

    @property
    def manifest_name(self) -> str:
        return f"assets/{self.key}/{content_name('manifest.json', self.manifest)}"

    @property
    def preview_name(self) -> str:
        """Object name of the picture, or ""."""
        return f"assets/{self.key}/{content_name(_PREVIEW, self.preview)}" if self.preview else ""

    @property
    def removed(self) -> bool:
        return self.state == REMOVED

    def matches(self, label: str) -> bool:
        """Whether the text is part of the label (else the key), or is one of the labels; case does not count."""
        wanted = label.casefold()
        return wanted in (self.label or self.key).casefold() or any(wanted == each.casefold() for each in self.labels)


@dataclass(frozen=True, slots=True)
class Shard:
    """A shard as the index lists it: `count` rows with keys from `first` to `last`."""

    name: str
    sha256: str
    bytes: int
    count: int
    first: str
    last: str


@dataclass(frozen=True, slots=True)
class Index:
    """What was signed. `retired` are the shards of the last few versions, oldest first, by sha256."""

    collection: str
    version: int
    updated: str
    shards: tuple[Shard, ...]
    retired: tuple[str, ...] = ()

    def place(self, key: str) -> int:
        """Which of the shards has the row of a key, or would take it."""
        return max(0, bisect_right([shard.first for shard in self.shards], key) - 1)


def index_name(collection: str) -> str:
    """Object name of a collection's index. Raises ValueError for a name that is none: the same rules as for keys."""
    return f"collections/{check_collection(collection)}/index.json"


def shard_name(collection: str, sha256: str) -> str:
    """Object name of a shard."""
    return f"collections/{check_collection(collection)}/{content_name('shard.json', sha256)}"


def row_of(entry: Entry) -> Row:
    """The row of an asset by its catalogue entry."""
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
    )


def sealed(index: Index, signers: Sequence[Signer]) -> bytes:
    """The index as its object: the text, and the signature of every signer."""
    document = {"schema": SCHEMA, **asdict(index)}
    text = encoded(document)
    return encoded({"signed": text.decode(), "signatures": [signer.sign(text) for signer in signers]})


def opened(data: bytes, collection: str) -> tuple[str, list[Signature]]:
    """The text and who claims to have signed it, unchecked. Raises CatalogueFault CATALOGUE_TRUNCATED."""
    try:
        envelope = json.loads(data)
        signatures = [{"key": str(each["key"]), "ed25519": str(each["ed25519"])} for each in envelope["signatures"]]
        text = envelope["signed"]
    except (ValueError, KeyError, TypeError):
        text = None
    if not isinstance(text, str):
        message = f"its {len(data):,} bytes are no whole catalogue"
        raise CatalogueFault(CATALOGUE_TRUNCATED, index_name(collection), message)
    return text, list(signatures)


def read_index(data: bytes, collection: str, believed: tuple[Public, ...] = (), *, at_least: int = 0) -> Index:
    """The index in its object, once its signature holds for one of the believed keys (with none: whatever it is).

    at_least  the highest version seen before: an older one is refused, however well it is signed
    Raises CatalogueFault, of classes SIGNATURE_*, KEY_UNKNOWN and CATALOGUE_*.
    """
    name = index_name(collection)
    text, signatures = opened(data, collection)
    check_signatures(name, text.encode(), signatures, believed)
    index = _index(text, name)
    if index.collection != collection:
        raise CatalogueFault(CATALOGUE_OTHER, name, f"this is the catalogue of collection {index.collection}")
    if index.version < at_least:
        raise CatalogueFault(
            CATALOGUE_OLDER,
            name,
            f"version {index.version} is older than {at_least}, which was seen before",
            hint="an older catalogue was put back, or a cache is stale",
        )
    return index


def shard_data(rows: Sequence[Row], version: int) -> bytes:
    """Rows, by key, as the object of a shard first listed by the index of this version.

    The version makes its bytes new: a shard that was retired is never listed again, so it can be deleted safely.
    """
    words = list(dict.fromkeys(word for row in rows for word in (row.state, *row.labels)))
    places = {word: place for place, word in enumerate(words)}
    cells = [_cells(row, places) for row in rows]
    return encoded({"schema": SCHEMA, "version": version, "columns": _COLUMNS, "words": words, "rows": cells})


def listed(collection: str, rows: Sequence[Row], data: bytes) -> Shard:
    """A shard as the index lists it."""
    sha256 = sha256_hex(data)
    return Shard(shard_name(collection, sha256), sha256, len(data), len(rows), rows[0].key, rows[-1].key)


def read_shard(data: bytes, shard: Shard) -> tuple[Row, ...]:
    """The rows of a shard. Raises CatalogueFault SHARD_CHANGED for bytes that are not those of the index."""
    if sha256_hex(data) != shard.sha256:
        message = f"its {len(data):,} bytes do not have the hash of the index"
        raise CatalogueFault(SHARD_CHANGED, shard.name, message, hint=f"the index says {shard.bytes:,} bytes")
    try:
        document = json.loads(data)
        columns, words = document["columns"], document["words"]
        return tuple(_row(dict(zip(columns, cells, strict=True)), words) for cells in document["rows"])
    except (ValueError, LookupError, TypeError) as error:
        raise CatalogueFault(SHARD_CHANGED, shard.name, f"no rows can be read from it: {error}") from None


def load_shard(store: Store, shard: Shard) -> tuple[Row, ...]:
    """The rows of a shard on the store. Raises CatalogueFault SHARD_MISSING, SHARD_CHANGED."""
    try:
        return read_shard(store.get(shard.name), shard)
    except FileNotFoundError:
        raise CatalogueFault(SHARD_MISSING, shard.name, "it is not on the store") from None


def _index(text: str, name: str) -> Index:
    try:
        document = json.loads(text)
        return Index(
            collection=str(document["collection"]),
            version=int(document["version"]),
            updated=str(document["updated"]),
            shards=tuple(_shard(document["collection"], each) for each in document["shards"]),
            retired=tuple(map(str, document["retired"])),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise CatalogueFault(CATALOGUE_TRUNCATED, name, f"what was signed is no catalogue: {error}") from None


def _shard(collection: str, told: Mapping[str, Any]) -> Shard:
    """The name follows from collection and hash, whatever else it says it is."""
    sha256 = str(told["sha256"])
    name = shard_name(collection, sha256)
    return Shard(name, sha256, int(told["bytes"]), int(told["count"]), str(told["first"]), str(told["last"]))


def _cells(row: Row, places: Mapping[str, int]) -> list[Any]:
    """In the order of `_COLUMNS`, small, because a client loads all of them: hashes as base64url, 43 letters for 64;
    states and labels, which repeat, as places in the shard's `words`.
    """
    labels = [places[label] for label in row.labels]
    facts = (row.key, row.label, labels, row.version, places[row.state], row.updated)
    return [*facts, _short(row.manifest), _short(row.preview)]


def _row(cells: Mapping[str, Any], words: Sequence[str]) -> Row:
    return Row(
        key=check_key(cells["key"]),
        label=cells["label"],
        labels=tuple(words[place] for place in cells["labels"]),
        version=cells["version"],
        state=words[cells["state"]],
        updated=cells["updated"],
        manifest=_long(cells["manifest"]),
        preview=_long(cells["preview"]),
    )


def _short(sha256: str) -> str:
    return base64.urlsafe_b64encode(bytes.fromhex(sha256)).decode().rstrip("=")


def _long(short: str) -> str:
    return base64.urlsafe_b64decode(short + "=" * (-len(short) % 4)).hex()
