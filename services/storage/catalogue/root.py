"""File format of a collection: a signed root, nodes, and shards with one row per asset.

    collections/<name>/root.json             {"signed": "<JSON text>", "signatures": [{"key", "ed25519"}]}, mutable
    collections/<name>/node.<sha256>.json    {"columns": [...], "children": [[...], ...]}, immutable
    collections/<name>/shard.<sha256>.json   {"columns": [...], "words": [...], "rows": [[...], ...]}, immutable
    collections/<name>/index.json            the same as a flat list of shards, for clients of earlier releases

The signed text lists the sha256 of the nodes or shards below it, a node those below it, a row the sha256 of its
manifest, a manifest the sha256 of every file: so one signature covers them all. Its `version` grows by one with every
change, so that clients notice an older root.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from capture2vr.storage.catalogue.collection import Shard, from_base64, node_name, shard_name, to_base64
from capture2vr.storage.catalogue.compare_and_swap import canonical_json
from capture2vr.storage.catalogue.entry import check_collection
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_OLDER,
    CATALOGUE_OTHER,
    CATALOGUE_TRUNCATED,
    CatalogueFault,
)
from capture2vr.storage.catalogue.signing import PublicKey, Signature, Signer, check_signatures
from capture2vr.storage.catalogue.visibility import Visibility, parse_visibility

SCHEMA = 2
FLAT_SCHEMA = 1
"""Of an index that lists all shards itself, as releases before trees wrote and read it."""
DEEPEST = 8
"""Levels of nodes at most, for readers: more rows than there can be."""
_HEX_DIGITS = 64  # of a sha256
_PART_COLUMNS = ("sha256", "bytes", "count", "first", "last")


@dataclass(frozen=True, slots=True)
class Index:
    """The signed content of a collection's root.

    parts       shards where depth is 0, else nodes with `depth` levels of parts below them, in the order of their keys
    commit      text that no other version has; "": a flat index that an earlier release has written
    retired     names of objects that the last few versions listed
    lists       (seconds since 1970, name) of objects that hold more such names
    visibility  who may read the collection besides its tenant; None: the gateway's default
    """

    collection: str
    version: int
    updated: str
    parts: tuple[Shard, ...]
    depth: int = 0
    commit: str = ""
    retired: tuple[str, ...] = ()
    lists: tuple[tuple[int, str], ...] = ()
    visibility: Visibility | None = None

    @property
    def count(self) -> int:
        """Rows of the collection, removed assets among them."""
        return sum(part.count for part in self.parts)


def root_name(collection: str) -> str:
    """Return the object name of a collection's root. Raises ValueError for an invalid collection name."""
    return f"collections/{check_collection(collection)}/root.json"


def index_name(collection: str) -> str:
    """Return the object name of a collection's flat index. Raises ValueError for an invalid collection name."""
    return f"collections/{check_collection(collection)}/index.json"


def sign_index(index: Index, signers: Sequence[Signer]) -> bytes:
    """Return the bytes of the root object: the root as JSON text, and the signature of every signer."""
    facts = {name: value for name, value in asdict(index).items() if name != "parts"}
    return seal({"schema": SCHEMA, "count": index.count, **facts, **_list_parts(index.parts)}, signers)


def seal(document: Mapping[str, Any], signers: Sequence[Signer]) -> bytes:
    """Return an envelope: the document as JSON text, and the signature of every signer."""
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
        raise CatalogueFault(CATALOGUE_TRUNCATED, root_name(collection), message)
    return text, list(signatures)


def read_index(
    data: bytes, collection: str, verification_keys: tuple[PublicKey, ...] = (), *, at_least: int = 0
) -> Index:
    """Verify the signature of a root, or of a flat index, and parse it. Without keys the signature is not checked.

    at_least  the highest version seen before: an older one is refused, even with a valid signature
    Raises CatalogueFault SIGNATURE_*, KEY_UNKNOWN or CATALOGUE_*.
    """
    name = root_name(collection)
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


def index_or_none(data: bytes | None, collection: str) -> Index | None:
    """Parse a root or index without checking its signature; None where there is none, or it cannot be read."""
    try:
        return read_index(data, collection) if data is not None else None
    except CatalogueFault:
        return None


def node_data(parts: Sequence[Shard], commit: str) -> bytes:
    """Return the bytes of a node object with these parts, in the order of their keys; `commit` as of `shard_data`."""
    return canonical_json({"schema": SCHEMA, "commit": commit, **_list_parts(parts)})


def parse_parts(document: Mapping[str, Any], collection: str, depth: int) -> tuple[Shard, ...]:
    """Parse the parts that a root or node lists. Raises ValueError, LookupError or TypeError for others."""
    named = node_name if depth else shard_name

    def parse(sha256: str, size: int, count: int, first: str, last: str) -> Shard:
        sha256 = from_base64(sha256)
        if len(sha256) != _HEX_DIGITS:
            raise ValueError(f"{sha256!r:.80} is no sha256")
        return Shard(named(collection, sha256), sha256, int(size), int(count), str(first), str(last))

    columns = [document["columns"].index(name) for name in _PART_COLUMNS]
    return tuple(parse(*(cells[column] for column in columns)) for cells in document["children"])


def _list_parts(parts: Sequence[Shard]) -> dict[str, Any]:
    cells = [[to_base64(part.sha256), part.bytes, part.count, part.first, part.last] for part in parts]
    return {"columns": _PART_COLUMNS, "children": cells}


def _parse_index(text: str, name: str) -> Index:
    try:
        document = json.loads(text)
        collection, depth = str(document["collection"]), int(document.get("depth", 0))
        if not 0 <= depth <= DEEPEST:
            raise ValueError(f"its depth is {depth}")
        is_tree = "children" in document
        return Index(
            collection=collection,
            version=int(document["version"]),
            updated=str(document["updated"]),
            parts=parse_parts(document, collection, depth) if is_tree else _parse_shards(document),
            depth=depth,
            commit=str(document.get("commit", "")),
            retired=tuple(map(str, document["retired"])) if is_tree else _retired_shards(document),
            lists=tuple((int(at), str(each)) for at, each in document.get("lists", ())),
            visibility=parse_visibility(document.get("visibility")),
        )
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise CatalogueFault(CATALOGUE_TRUNCATED, name, f"the signed text is not a catalogue: {error}") from None


def _retired_shards(document: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(shard_name(document["collection"], str(sha256)) for sha256 in document["retired"])


def _parse_shards(document: Mapping[str, Any]) -> tuple[Shard, ...]:
    """Parse the shards of a flat index. Their names are computed from the hashes; those in the records are ignored."""
    return tuple(
        Shard(
            shard_name(document["collection"], str(each["sha256"])),
            str(each["sha256"]),
            int(each["bytes"]),
            int(each["count"]),
            str(each["first"]),
            str(each["last"]),
        )
        for each in document["shards"]
    )
