"""Who may read an asset, a collection or a scene besides its tenant: its visibility, cached for a few seconds.

The cache bounds how long a change goes unnoticed by other gateways; the one that makes it forgets at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import anyio.to_thread
from cachetools import TTLCache

from capture2vr.gateway.access.authentication import CACHE_S
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.reader import read_root
from capture2vr.storage.catalogue.visibility import Visibility, effective
from capture2vr.storage.scenes.scene_documents import read_scene
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant

_CACHED = 20_000

Kind = Literal["asset", "collection", "scene"]


@dataclass(frozen=True, slots=True)
class Thing:
    """An asset, a collection or a scene of a tenant."""

    tenant: str
    kind: Kind
    name: str


@dataclass(frozen=True, slots=True)
class Readers:
    """Who may read a thing besides its tenant.

    visibility   the one that holds; None: the gateway's default
    collections  those that list an asset
    assets       those that stand in a scene
    """

    visibility: Visibility | None = None
    collections: tuple[str, ...] = ()
    assets: frozenset[str] = frozenset()


class ReadersCache:
    """Looks up who may read things. Used on the event loop only."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._cached: TTLCache[Thing, Readers] = TTLCache(_CACHED, CACHE_S)

    async def of(self, thing: Thing) -> Readers:
        """Return who may read a thing. A missing or damaged one, or a store that fails, opens nothing to anybody."""
        found = self._cached.get(thing)
        if found is None:
            looks: dict[Kind, Callable[[Thing], Readers]]
            looks = {"asset": self._of_asset, "collection": self._of_collection, "scene": self._of_scene}
            try:
                found = await anyio.to_thread.run_sync(looks[thing.kind], thing)
            except (OSError, ValueError):  # CatalogueFault is an OSError; ValueError: no valid name
                return Readers()
            self._cached[thing] = found
        return found

    def forget_all(self, tenant: str) -> None:
        """Invalidate the cache of a tenant's assets, collections and arrangements, after one was changed here."""
        for thing in [each for each in self._cached if each.tenant == tenant]:
            self._cached.pop(thing, None)

    def _of_asset(self, thing: Thing) -> Readers:
        store = store_of_tenant(self._store, thing.tenant)
        entry = read_entry(store, thing.name)
        if entry.visibility is not None:
            return Readers(entry.visibility, tuple(entry.collections))
        inherited = [_collection_visibility(store, name) for name in entry.collections]
        return Readers(effective(None, inherited), tuple(entry.collections))

    def _of_collection(self, thing: Thing) -> Readers:
        return Readers(_collection_visibility(store_of_tenant(self._store, thing.tenant), thing.name))

    def _of_scene(self, thing: Thing) -> Readers:
        return Readers(assets=read_scene(store_of_tenant(self._store, thing.tenant), thing.name).assets)


def _collection_visibility(store: Store, name: str) -> Visibility | None:
    """Return a collection's visibility; None where it has none, or does not exist."""
    try:
        return read_root(store, name).visibility
    except FileNotFoundError:
        return None
