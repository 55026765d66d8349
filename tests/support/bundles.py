"""Bundles, what a collection has, and a failing store for the tests of publishing."""

from __future__ import annotations

from pathlib import Path
from threading import Lock

from capture2vr.storage.bundle import Bundle, State
from capture2vr.storage.catalogue.collection import Row, load_shard
from capture2vr.storage.catalogue.reader import parts_on, read_root
from capture2vr.storage.catalogue.signing import PublicKey
from capture2vr.storage.catalogue.tree import shards_of
from capture2vr.storage.store import IMMUTABLE, Head, Store


def bundle(state: State = "preview", content: str = "a", **manifest: object) -> Bundle:
    """A bundle of two levels, a picture and a mesh, told apart by `content`."""
    files = {name: f"{name} {state} {content}".encode() for name in ("lod0.glb", "lod1.glb", "preview.png", "mesh.ply")}
    lods = [
        {"file": f"lod{level}.glb", "level": level, "triangles": 100 >> level, "vertices": 60 >> level}
        for level in (0, 1)
    ]
    facts = {"label": "Dress", "scale_confidence": "metric", "bounds_m": [[0, 0, 0], [1, 2, 3]], "size_m": [1, 2, 3]}
    return Bundle(state=state, files=files, manifest={"lods": lods, "quality": {"triangles": 100}} | facts | manifest)


def listed(store: Store, collection: str = "default", believed: tuple[PublicKey, ...] = ()) -> dict[str, Row]:
    """The rows of a collection by key, each shard as what lists it says and in order."""
    index = read_root(store, collection, believed)
    rows: list[Row] = []
    for shard in shards_of(index, parts_on(store, collection).nodes):
        part = load_shard(store, shard)
        assert (len(part), part[0].key, part[-1].key) == (shard.count, shard.first, shard.last)
        assert store.head(shard.name).size == shard.bytes
        rows += part
    assert [row.key for row in rows] == sorted({row.key for row in rows})
    return {row.key: row for row in rows}


class Crash(Exception):  # noqa: N818 - it reads as what it is
    """The process that published is gone."""


class CrashingStore:
    """A store whose process dies at the n-th put: before the bytes are there, or just after."""

    def __init__(self, inner: Store, at: int, *, after: bool) -> None:
        self._inner = inner
        self._left = at
        self._after = after
        self._counts = Lock()

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
        with self._counts:
            self._left -= 1
            left = self._left
        if left == 0 and not self._after:
            raise Crash(name)
        head = self._inner.put(
            name,
            data,
            content_type=content_type,
            cache_control=cache_control,
            if_match=if_match,
            if_absent=if_absent,
            link=link,
        )
        if left == 0:
            raise Crash(name)
        return head

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        return self._inner.get(name, start=start, length=length)

    def fetch(self, name: str, path: Path) -> None:
        self._inner.fetch(name, path)

    def head(self, name: str) -> Head:
        return self._inner.head(name)

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        return self._inner.list(prefix, after=after, limit=limit)

    def delete(self, name: str) -> None:
        self._inner.delete(name)

    def url(self, name: str) -> str:
        return self._inner.url(name)
