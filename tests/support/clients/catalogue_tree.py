"""Signed catalogues as trees, written from the description of the format alone, for tests of what reads them."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

_COLUMNS = ("key", "label", "labels", "version", "state", "updated", "manifest", "preview", "bytes", "grade")
RECORD = ("sha256", "bytes", "count", "first", "last")
Cells = dict[str, Any]
"""An asset by the names of the columns; hashes are hexadecimal, words are words."""


@dataclass(frozen=True)
class TreeWriter:
    """Who writes trees, and of which shape.

    commit  makes the names of nodes and shards those of this tree alone
    """

    key: Ed25519PrivateKey = field(default_factory=Ed25519PrivateKey.generate)
    collection: str = "default"
    shard_rows: int = 4
    node_children: int = 3
    version: int = 1
    commit: str = "one"

    @property
    def public_key(self) -> str:
        """In base64, as clients have it."""
        return base64.b64encode(self.key.public_key().public_bytes_raw()).decode()

    @property
    def key_id(self) -> str:
        """By which signatures name it."""
        return hashlib.sha256(self.key.public_key().public_bytes_raw()).hexdigest()[:16]

    def write(self, rows: Sequence[Cells], **changes: Any) -> Tree:
        """A catalogue of these rows, which are in the order of their keys. changes: of fields of its signed text"""
        tree = Tree(self.collection)
        records = [tree.add_shard(self, part) for part in _parts(rows, self.shard_rows)]
        while len(records) > self.node_children:
            records = [tree.add_node(self, part) for part in _parts(records, self.node_children)]
            tree.depth += 1
        signed = {
            **{"schema": 2, "collection": self.collection, "version": self.version, "commit": self.commit},
            **{"updated": "2026-11-30T12:00:00Z", "retired": [], "visibility": None},
            **{"count": len(rows), "depth": tree.depth, "columns": RECORD, "children": records},
        }
        tree.files[tree.name("root.json")] = self.envelope(signed | changes)
        return tree

    def envelope(self, signed: Cells) -> bytes:
        """The bytes of a root or an index with this signed text."""
        text = json.dumps(signed)
        signature = base64.b64encode(self.key.sign(text.encode())).decode()
        return json.dumps({"signed": text, "signatures": [{"key": self.key_id, "ed25519": signature}]}).encode()


@dataclass
class Tree:
    """The files of a tree by their object names, and the parent of each node and shard."""

    collection: str
    depth: int = 0
    files: dict[str, bytes] = field(default_factory=dict)
    parents: dict[str, str] = field(default_factory=dict)
    shard_of: dict[str, str] = field(default_factory=dict)

    def name(self, file: str) -> str:
        """The object name of a file of the collection."""
        return f"collections/{self.collection}/{file}"

    def path_to(self, key: str) -> list[str]:
        """Object names of all nodes that lead to an asset, and of its shard."""
        path = [self.shard_of[key]]
        while path[0] in self.parents:
            path.insert(0, self.parents[path[0]])
        return path

    def write_to(self, folder: Path) -> None:
        """In the place of whatever catalogue of the collection is in a folder."""
        below = folder / "collections" / self.collection
        for other in below.glob("*.json"):
            other.unlink()
        below.mkdir(parents=True, exist_ok=True)
        for name, data in self.files.items():
            (folder / name).write_bytes(data)

    def add_shard(self, writer: TreeWriter, rows: Sequence[Cells]) -> list[Any]:
        """Add a shard; the record of it."""
        words = sorted({word for row in rows for word in (row["state"], row["grade"], *row["labels"])})
        cells = [[_cell(row, column, words) for column in _COLUMNS] for row in rows]
        record = self._add(writer, "shard", {"columns": _COLUMNS, "words": words, "rows": cells})
        for row in rows:
            self.shard_of[row["key"]] = self.name(f"shard.{hexadecimal(record[0])}.json")
        return [*record, len(rows), rows[0]["key"], rows[-1]["key"]]

    def add_node(self, writer: TreeWriter, records: Sequence[list[Any]]) -> list[Any]:
        """Add a node above others; the record of it."""
        record = self._add(writer, "node", {"columns": RECORD, "children": records})
        for below in records:
            kind = "node" if self.depth else "shard"
            self.parents[self.name(f"{kind}.{hexadecimal(below[0])}.json")] = self.name(
                f"node.{hexadecimal(record[0])}.json"
            )
        return [*record, sum(below[2] for below in records), records[0][3], records[-1][4]]

    def _add(self, writer: TreeWriter, kind: str, document: Cells) -> list[Any]:
        data = json.dumps({"schema": 2, "commit": writer.commit, **document}).encode()
        sha256 = hashlib.sha256(data)
        self.files[self.name(f"{kind}.{sha256.hexdigest()}.json")] = data
        return [_base64url(sha256.digest()), len(data)]


def row(key: str, **changes: Any) -> Cells:
    """An asset that has a row and nothing else."""
    hashes = {"manifest": "0" * 64, "preview": ""}
    names: Cells = {"label": key.title(), "labels": ["many"], "grade": ""}
    return {"key": key, "version": 1, "state": "refined", "updated": 0, "bytes": 0, **names, **hashes, **changes}


def rows_in(folder: Path, collection: str = "default") -> list[Cells]:
    """The rows of a catalogue in the flat form that the product has published."""
    below = folder / "collections" / collection
    shards = json.loads(json.loads((below / "index.json").read_bytes())["signed"])["shards"]
    found = []
    for shard in shards:
        document = json.loads((folder / shard["name"]).read_bytes())
        words = document["words"]
        for cells in document["rows"]:
            told = dict(zip(document["columns"], cells, strict=True))
            told |= {column: hexadecimal(told[column]) for column in ("manifest", "preview")}
            told |= {"labels": [words[place] for place in told["labels"]]}
            found.append(told | {column: words[told[column]] for column in ("state", "grade")})
    return found


def _parts(things: Sequence[Any], most: int) -> list[Sequence[Any]]:
    return [things[start : start + most] for start in range(0, len(things), most)]


def _cell(row: Cells, column: str, words: Sequence[str]) -> Any:
    value = row[column]
    if column in ("manifest", "preview"):
        return _base64url(bytes.fromhex(value))
    if column == "labels":
        return [words.index(each) for each in value]
    return words.index(value) if column in ("state", "grade") else value


def _base64url(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).decode().rstrip("=")


def hexadecimal(encoded: str) -> str:
    """A hash as object names have it, of one in base64url without padding."""
    return base64.urlsafe_b64decode(encoded + "=" * (-len(encoded) % 4)).hex()
