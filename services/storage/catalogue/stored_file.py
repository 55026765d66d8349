"""A file of an asset on the store: its name holds its hash, so that it never changes."""

from __future__ import annotations

from dataclasses import dataclass

from capture2vr.storage.bundle import Json, content_name, content_type, sha256_hex
from capture2vr.storage.store import Store


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file of the bundle that was written to the store."""

    file: str
    name: str
    sha256: str
    size: int

    def document(self) -> dict[str, Json]:
        """The file's row in a manifest and in an entry."""
        return {"file": self.file, "name": self.name, "sha256": self.sha256, "bytes": self.size}


def put_content(store: Store, key: str, file: str, data: bytes) -> StoredFile:
    """Write a file under the name that its hash gives it, unless it is there already."""
    sha256 = sha256_hex(data)
    stored = StoredFile(file, f"assets/{key}/{content_name(file, sha256)}", sha256, len(data))
    if not _is_stored(store, stored):
        store.put(stored.name, data, content_type=content_type(file))
    return stored


def _is_stored(store: Store, stored: StoredFile) -> bool:
    try:
        return store.head(stored.name).size == stored.size
    except FileNotFoundError:
        return False
