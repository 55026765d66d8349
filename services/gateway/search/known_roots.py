"""Roots of collections that have been searched: what changed since one of them is told without reading all shards."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence

from capture2vr.storage.catalogue.collection import Shard
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.catalogue.root import Index
from capture2vr.storage.catalogue.tree import LoadNode, changed_shards

_MOST = 200  # of a few kilobytes each


def token_of(index: Index) -> str:
    """Return a text that no other root of the collection has."""
    return f"{index.version}.{index.commit}"


class KnownRoots:
    """The roots that searches have read last, by tenant, collection and token. Thread-safe."""

    def __init__(self) -> None:
        self._roots: OrderedDict[tuple[str, str, str], Index] = OrderedDict()
        self._lock = threading.Lock()

    def remember(self, tenant: str, index: Index) -> None:
        """Keep a root, and forget the one that was used longest ago."""
        with self._lock:
            name = (tenant, index.collection, token_of(index))
            self._roots[name] = index
            self._roots.move_to_end(name)
            if len(self._roots) > _MOST:
                self._roots.popitem(last=False)

    def changed(
        self, tenant: str, index: Index, load: LoadNode, token: str
    ) -> tuple[Sequence[Shard], Sequence[Shard]] | None:
        """Return the shards that a root lists no more, and those that it lists first, since the one with this token.

        None where that one is not known, or its nodes are gone.
        """
        with self._lock:
            earlier = self._roots.get((tenant, index.collection, token))
        try:
            return changed_shards(earlier, index, load) if earlier else None
        except CatalogueFault:
            return None
