"""An object store in memory, for tests. It passes the same contract test as the real stores."""

from __future__ import annotations

import hashlib
import threading
from datetime import UTC, datetime
from pathlib import Path

from capture2vr.storage.store import IMMUTABLE, ConditionFailed, Head, check_name


class MemoryStore:
    """Objects in the memory of one process. Thread-safe."""

    def __init__(self) -> None:
        self._objects: dict[str, tuple[Head, bytes]] = {}
        self._lock = threading.Lock()

    def put(
        self,
        name: str,
        data: bytes | Path,
        *,
        content_type: str,
        cache_control: str = IMMUTABLE,
        if_match: str | None = None,
        if_absent: bool = False,
        link: bool = False,
    ) -> Head:
        content = data.read_bytes() if isinstance(data, Path) else bytes(data)
        etag = hashlib.sha256(content).hexdigest()
        head = Head(check_name(name), len(content), etag, content_type, cache_control, datetime.now(UTC))
        with self._lock:
            present = self._objects.get(name)
            if if_absent and present:
                raise ConditionFailed(f"{name} exists")
            if if_match is not None and (present is None or present[0].etag != if_match):
                raise ConditionFailed(f"{name} has changed")
            self._objects[name] = (head, content)
        return head

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        return self._find(name)[1][start : None if length is None else start + length]

    def fetch(self, name: str, path: Path) -> None:
        path.write_bytes(self._find(name)[1])

    def head(self, name: str) -> Head:
        return self._find(name)[0]

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        with self._lock:
            heads = [head for head, _ in self._objects.values() if head.name.startswith(prefix) and head.name > after]
        heads.sort(key=lambda head: head.name)
        return [Head(h.name, h.size, h.etag, "", "", h.modified) for h in heads[:limit]]

    def delete(self, name: str) -> None:
        with self._lock:
            self._objects.pop(check_name(name), None)

    def url(self, name: str) -> str:
        return f"memory:///{check_name(name)}"

    def _find(self, name: str) -> tuple[Head, bytes]:
        with self._lock:
            try:
                return self._objects[check_name(name)]
            except KeyError:
                raise FileNotFoundError(name) from None
