"""Reads scenes for all who watch them: one read of the store serves everybody who asks within some seconds."""

from __future__ import annotations

import asyncio

import anyio.to_thread
from cachetools import TTLCache

from capture2vr.gateway.access.readers import Thing
from capture2vr.storage.scenes.scene import Scene
from capture2vr.storage.scenes.scene_documents import read_scene
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant

_FRESH_S = 5.0  # a change that nobody told of, written past this gateway, is seen at a listener's next look after that
_CACHED = 1_000


class SceneReads:
    """Reads scenes. Event loop only."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._reads: TTLCache[Thing, asyncio.Task[Scene]] = TTLCache(_CACHED, _FRESH_S)

    async def read(self, scene: Thing) -> Scene:
        """Read a scene, as it is or was a few seconds ago.

        Raises FileNotFoundError for an unknown one, CatalogueFault for a damaged one, OSError.
        """
        reading = self._reads.get(scene)
        if reading is None:
            reading = self._reads[scene] = asyncio.create_task(self._read(scene))
        return await asyncio.shield(reading)  # others may wait for it when this listener leaves

    def forget(self, scene: Thing) -> None:
        """Read a scene anew: it has changed."""
        self._reads.pop(scene, None)

    async def _read(self, scene: Thing) -> Scene:
        store = store_of_tenant(self._store, scene.tenant)
        return await anyio.to_thread.run_sync(read_scene, store, scene.name)
