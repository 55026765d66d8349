"""Signed catalogues as trees, written from the description of the format, with nothing of the product's own writer."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

_T = TypeVar("_T")
_PARTS = ("sha256", "bytes", "count", "first", "last")
_ROWS = ("key", "label", "labels", "version", "state", "updated", "manifest", "preview", "bytes", "grade")


@dataclass(frozen=True)
class TreeRow:
    """An asset; manifest: its sha256 in hexadecimal digits."""

    key: str
    manifest: str
    version: int = 1
    label: str = ""
    labels: tuple[str, ...] = ()
    removed: bool = False


@dataclass(frozen=True)
class Shape:
    """depth: levels of nodes between root and shards; then rows of a shard, and children of a node, at most"""

    depth: int
    rows: int = 48
    children: int = 48


def tree_objects(rows: Sequence[TreeRow], version: int, shape: Shape, private: Ed25519PrivateKey) -> dict[str, bytes]:
    """Names and bytes of a collection "default" of these rows, which are in the order of their keys."""
    objects: dict[str, bytes] = {}
    parts = []
    for some in _chunks(rows, shape.rows):
        data = _json(_shard(some))
        objects[f"collections/default/shard.{hashlib.sha256(data).hexdigest()}.json"] = data
        parts.append(_record(data, len(some), some[0].key, some[-1].key))
    for level in range(shape.depth):
        above = []
        for children in _chunks(parts, shape.children):
            data = _json({"schema": 2, "commit": f"{version}-{level}", "columns": _PARTS, "children": children})
            objects[f"collections/default/node.{hashlib.sha256(data).hexdigest()}.json"] = data
            above.append(_record(data, sum(each[2] for each in children), children[0][3], children[-1][4]))
        parts = above
    root = {
        "schema": 2,
        "collection": "default",
        "version": version,
        "updated": "2026-11-30T12:00:00Z",
        "commit": "a",
        "count": len(rows),
        "depth": shape.depth,
        "columns": _PARTS,
        "children": parts,
        "retired": [],
        "visibility": None,
    }
    stub = {"schema": 2, "collection": "default", "version": version}
    objects["collections/default/root.json"] = signed_envelope(root, private)
    objects["collections/default/index.json"] = signed_envelope(stub, private)
    return objects


def signed_envelope(document: dict[str, Any], private: Ed25519PrivateKey) -> bytes:
    """An object that is signed as root.json and index.json are."""
    text = _json(document)
    key = hashlib.sha256(private.public_key().public_bytes_raw()).hexdigest()[:16]
    signature = {"key": key, "ed25519": base64.b64encode(private.sign(text)).decode()}
    return _json({"signed": text.decode(), "signatures": [signature]})


def _shard(rows: Sequence[TreeRow]) -> dict[str, Any]:
    words = sorted({"preview", "removed", ""}.union(*(row.labels for row in rows)))
    place = {word: number for number, word in enumerate(words)}
    cells = [
        [
            row.key,
            row.label,
            [place[label] for label in row.labels],
            row.version,
            place["removed" if row.removed else "preview"],
            1_795_000_000,
            _base64(bytes.fromhex(row.manifest)),
            "",
            0,
            place[""],
        ]
        for row in rows
    ]
    return {"schema": 1, "commit": "b", "columns": _ROWS, "words": words, "rows": cells}


def _record(data: bytes, count: int, first: str, last: str) -> list[Any]:
    return [_base64(hashlib.sha256(data).digest()), len(data), count, first, last]


def _base64(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).decode().rstrip("=")


def _json(document: Any) -> bytes:
    return json.dumps(document, ensure_ascii=False).encode()


def _chunks(items: Sequence[_T], size: int) -> list[Sequence[_T]]:
    return [items[start : start + size] for start in range(0, len(items), size)]
