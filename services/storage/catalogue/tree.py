"""The tree of a collection: shards with its rows below nodes, of which one change writes a path anew.

All objects below the root are immutable and named by their hash. A change writes the shard with the row, the nodes
above it, and the root, whatever the size of the collection: a million rows have three levels of nodes.
"""

from __future__ import annotations

import json
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import TypeVar

from capture2vr.process.at_once import at_once
from capture2vr.storage.bundle import sha256_hex
from capture2vr.storage.catalogue.collection import (
    Row,
    Shard,
    check_part,
    describe_shard,
    load_shard,
    node_name,
    shard_data,
)
from capture2vr.storage.catalogue.faults import SHARD_CHANGED, SHARD_MISSING, CatalogueFault
from capture2vr.storage.catalogue.root import Index, node_data, parse_parts
from capture2vr.storage.store import Store

LEAF_ROWS = 32
"""Rows of one shard at most, about 4 KB; of larger ones, as earlier releases wrote, those that change are split."""
NODE_PARTS = 32
"""Parts of one node, and of the root, at most: about 3 KB."""

LoadNode = Callable[[int, Shard], tuple[Shard, ...]]
"""(depth of the parts, node) -> the parts that the node lists"""

_T = TypeVar("_T")


def read_node(data: bytes, node: Shard, collection: str, depth: int) -> tuple[Shard, ...]:
    """Check a node's hash against the record of it and parse its parts, which are shards where depth is 0.

    Raises CatalogueFault SHARD_CHANGED.
    """
    check_part(data, node)
    try:
        return parse_parts(json.loads(data), collection, depth)
    except (ValueError, LookupError, TypeError) as error:
        raise CatalogueFault(SHARD_CHANGED, node.name, f"its parts cannot be read: {error}") from None


def load_node(store: Store, collection: str, depth: int, node: Shard) -> tuple[Shard, ...]:
    """Read the parts of a node from the store. Raises CatalogueFault SHARD_MISSING, SHARD_CHANGED."""
    try:
        return read_node(store.get(node.name), node, collection, depth)
    except FileNotFoundError:
        raise CatalogueFault(SHARD_MISSING, node.name, "it is not on the store") from None


def shards_of(index: Index, load: LoadNode, after: str = "") -> Iterator[Shard]:
    """Yield the shards of a collection in the order of their keys, those alone that have keys behind `after`."""

    def below(parts: Sequence[Shard], depth: int) -> Iterator[Shard]:
        for part in parts:
            if part.last > after:
                if depth:
                    yield from below(load(depth - 1, part), depth - 1)
                else:
                    yield part

    return below(index.parts, index.depth)


def shard_with(index: Index, key: str, load: LoadNode) -> Shard | None:
    """Return the shard that has the row of a key if any has; None where the collection is empty."""
    path = path_to(index, key, load)
    return path[-1] if path else None


def path_to(index: Index, key: str, load: LoadNode) -> list[Shard]:
    """Return the nodes from the root down to the shard that has the row of a key if any has, and the shard."""
    path: list[Shard] = []
    parts = index.parts
    for depth in reversed(range(index.depth + 1)):
        if parts:
            path.append(parts[_place(parts, key)])
            parts = load(depth - 1, path[-1]) if depth else ()
    return path


def changed_shards(old: Index, new: Index, load: LoadNode) -> tuple[list[Shard], list[Shard]]:
    """Return the shards that a newer root of a collection lists no more, and those that it lists first.

    Reads only the nodes that differ, those of a level at once. Raises CatalogueFault where one of the older root is
    gone.
    """
    depth = min(old.depth, new.depth)
    gone, fresh = _apart(_parts_at(old, depth, load), _parts_at(new, depth, load))
    for level in reversed(range(depth)):
        below = at_once([partial(load, level, node) for node in (*gone, *fresh)])
        gone, fresh = _apart(*(list(chain.from_iterable(each)) for each in (below[: len(gone)], below[len(gone) :])))
    return gone, fresh


def _apart(some: Sequence[Shard], others: Sequence[Shard]) -> tuple[list[Shard], list[Shard]]:
    """Return the parts that only the first have, and those that only the others have."""
    these, those = ({part.sha256 for part in parts} for parts in (some, others))
    return [part for part in some if part.sha256 not in those], [part for part in others if part.sha256 not in these]


def _parts_at(index: Index, depth: int, load: LoadNode) -> Sequence[Shard]:
    """Return the parts of a tree with `depth` levels of nodes below them."""
    parts: Sequence[Shard] = index.parts
    for level in reversed(range(depth, index.depth)):
        parts = list(chain.from_iterable(at_once([partial(load, level, node) for node in parts])))
    return parts


@dataclass
class Draft:
    """The next version of a tree, before it is written: the objects that it adds, and those that it replaces.

    commit    text that no other change has. It makes the objects of this one unique: no later root can list what this
              one retires, so it can be deleted safely.
    written   new objects by name
    firsts    first key of each new shard and node, by name
    replaced  names of objects that the new version does not have any more
    has_left  whether a row was removed
    """

    store: Store
    collection: str
    commit: str
    written: dict[str, bytes] = field(default_factory=dict)
    firsts: dict[str, str] = field(default_factory=dict)
    replaced: list[str] = field(default_factory=list)
    has_left: bool = False

    def change(self, index: Index, rows: Mapping[str, Row | None]) -> tuple[tuple[Shard, ...], int]:
        """Return parts and depth of the root with these rows in place of those of the same keys; None removes a row."""
        parts = self._changed(index.parts, index.depth, rows)
        return self._below_a_root(parts, index.depth)

    def build(self, rows: Sequence[Row]) -> tuple[tuple[Shard, ...], int]:
        """Return parts and depth of the root of a tree of these rows alone, sorted by key."""
        return self._below_a_root(self._write_shards(rows), 0)

    def _below_a_root(self, parts: Sequence[Shard], depth: int) -> tuple[tuple[Shard, ...], int]:
        while len(parts) > NODE_PARTS:
            parts, depth = self._write_nodes(parts), depth + 1
        return tuple(parts), depth

    def _changed(self, parts: Sequence[Shard], depth: int, rows: Mapping[str, Row | None]) -> Sequence[Shard]:
        """Return parts with changed rows, of the same objects where nothing changes."""
        if not parts:
            return self._write_shards(sorted(filter(None, rows.values()), key=lambda row: row.key))
        at: defaultdict[int, dict[str, Row | None]] = defaultdict(dict)
        for key, row in rows.items():
            at[_place(parts, key)][key] = row
        calls = [partial(self._changed_part, parts[number], depth, at[number]) for number in at]
        changed = dict(zip(at, at_once(calls), strict=True))
        return [each for number, part in enumerate(parts) for each in changed.get(number, (part,))]

    def _changed_part(self, part: Shard, depth: int, rows: Mapping[str, Row | None]) -> Sequence[Shard]:
        if depth:
            within = load_node(self.store, self.collection, depth - 1, part)
            parts = self._changed(within, depth - 1, rows)
            if list(parts) == list(within):
                return (part,)
            self.replaced.append(part.name)
            return self._write_nodes(parts)
        present = {row.key: row for row in load_shard(self.store, part)}
        wanted = {key: row for key, row in ({**present, **rows}).items() if row is not None}
        if wanted == present:
            return (part,)
        self.has_left |= not present.keys() <= wanted.keys()
        self.replaced.append(part.name)
        return self._write_shards([wanted[key] for key in sorted(wanted)])

    def _write_shards(self, rows: Sequence[Row]) -> list[Shard]:
        return [self._written_shard(piece) for piece in _pieces(rows, LEAF_ROWS)]

    def _written_shard(self, rows: Sequence[Row]) -> Shard:
        data = shard_data(rows, self.commit)
        shard = describe_shard(self.collection, rows, data)
        self.written[shard.name], self.firsts[shard.name] = data, shard.first
        return shard

    def _write_nodes(self, parts: Sequence[Shard]) -> list[Shard]:
        return [self._written_node(piece) for piece in _pieces(parts, NODE_PARTS)]

    def _written_node(self, parts: Sequence[Shard]) -> Shard:
        data = node_data(parts, self.commit)
        sha256, count = sha256_hex(data), sum(part.count for part in parts)
        node = Shard(node_name(self.collection, sha256), sha256, len(data), count, parts[0].first, parts[-1].last)
        self.written[node.name], self.firsts[node.name] = data, node.first
        return node


def _place(parts: Sequence[Shard], key: str) -> int:
    """Return the number of the part that has a key, or into which it would be inserted."""
    return max(0, bisect_right(parts, key, key=lambda part: part.first) - 1)


def _pieces(items: Sequence[_T], most: int) -> Iterator[Sequence[_T]]:
    """Cut into pieces of nearly the same length, as few as hold at most `most` each; nothing is no piece."""
    count = -(-len(items) // most)
    for number in range(count):
        yield items[number * len(items) // count : (number + 1) * len(items) // count]
