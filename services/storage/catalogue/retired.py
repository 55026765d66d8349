"""Objects of a collection that newer ones have replaced: they stay a while for readers of an older root, and go."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial

from capture2vr.process.at_once import at_once
from capture2vr.storage.bundle import content_name, sha256_hex
from capture2vr.storage.catalogue.collection import Shard
from capture2vr.storage.catalogue.compare_and_swap import canonical_json
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.catalogue.root import Index
from capture2vr.storage.catalogue.tree import Draft, load_node, shards_of
from capture2vr.storage.store import Store

RETIRED_INLINE = 16
"""Names of replaced objects in the root at most; more are written to an object of their own."""
KEPT_S = 120.0
"""How long replaced objects stay for readers, at least."""
_DUE_AT_ONCE = 4  # lists of replaced objects that one commit deletes


def with_retired_aside(index: Index, draft: Draft) -> Index:
    """Write the names of retired objects to an object of their own where there are many: the root stays small."""
    if len(index.retired) <= RETIRED_INLINE:
        return index
    data = canonical_json({"commit": draft.commit, "objects": index.retired})
    name = f"collections/{index.collection}/{content_name('retired.json', sha256_hex(data))}"
    draft.written[name] = data
    return replace(index, retired=(), lists=(*index.lists, (int(time.time()), name)))


def due_lists(index: Index) -> list[tuple[int, str]]:
    """Return the lists of objects that have stayed long enough, a few at a time."""
    return [each for each in index.lists if each[0] < time.time() - KEPT_S][:_DUE_AT_ONCE]


def listed_names(store: Store, name: str) -> list[str]:
    """Return the names in a list of retired objects that are this collection's; none of one that cannot be read."""
    folder = name.rpartition("/")[0] + "/"
    try:
        names = json.loads(store.get(name))["objects"]
    except (FileNotFoundError, ValueError, LookupError, TypeError):
        return []
    return [each for each in names if isinstance(each, str) and each.startswith((f"{folder}shard.", f"{folder}node."))]


def all_objects(store: Store, index: Index) -> list[str]:
    """Return the names of all shards and nodes of a collection, and of what it has retired; what is damaged ends it."""
    names: list[str] = [*index.retired, *(name for _, name in index.lists)]

    def load(depth: int, node: Shard) -> tuple[Shard, ...]:
        names.append(node.name)
        return load_node(store, index.collection, depth, node)

    with suppress(CatalogueFault):
        for _, name in index.lists:
            names += listed_names(store, name)
        names += [shard.name for shard in shards_of(index, load)]
    return names


def delete_objects(store: Store, names: Iterable[str]) -> None:
    """Delete objects; those that cannot be deleted only take space, and must not fail the publication."""

    def delete(name: str) -> None:
        with suppress(OSError):
            store.delete(name)

    at_once([partial(delete, name) for name in names])


def delete_lists(store: Store, lists: Iterable[tuple[int, str]]) -> None:
    """Delete the objects that lists of retired ones name, and the lists."""
    for _, name in lists:
        delete_objects(store, [*listed_names(store, name), name])
