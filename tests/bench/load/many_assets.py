"""A collection that has many assets from the start, and the bytes that publishing into it writes."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from capture2vr.storage.catalogue.collection import Row
from capture2vr.storage.catalogue.root import Index, root_name, sign_index
from capture2vr.storage.catalogue.signing import Signer
from capture2vr.storage.catalogue.tree import Draft
from capture2vr.storage.store import Store

_EARLIER_FORMS = ("/unity/", "/index.json")
_AT_ONCE = 16


class WrittenBytes:
    """Bytes that were written, and those of catalogues among them; not those of the forms for earlier clients."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.all = self.by_catalogue = 0

    def add(self, name: str, size: int) -> None:
        """Count an object."""
        if not any(part in name for part in _EARLIER_FORMS):
            with self._lock:
                self.all += size
                self.by_catalogue += size * name.startswith("collections/")


def fill(store: Store, collection: str, keys: Iterable[str], signers: Sequence[Signer]) -> None:
    """Write a collection of assets with these keys, which have rows and nothing else."""
    rows = [
        Row(key, f"Chair {number}", ("chair", "wood"), 1, "refined", 1_790_000_000, f"{number:064x}", "1b" * 32, 10**6)
        for number, key in enumerate(sorted(set(keys)))
    ]
    draft = Draft(store, collection, "first")
    parts, depth = draft.build(rows)
    put = partial(store.put, content_type="application/json")
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        list(pool.map(put, draft.written.keys(), draft.written.values()))
    index = Index(collection, 1, "2026-01-01T00:00:00Z", parts, depth, "first")
    put(root_name(collection), sign_index(index, signers))
