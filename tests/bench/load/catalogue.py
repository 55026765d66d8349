"""What a publication and a look cost in collections of 100 to 1,000,000 assets; many publishers at once.

`python -m tests.bench catalogue` publishes into a collection that has so many assets already, on a store in memory
that counts bytes, without those of the forms for earlier clients. Every call of it takes `--delay` milliseconds, as of
an object store in the same place; "near" none. A publication's files are those of `tests/support/bundles.py`, tiny.
"""

from __future__ import annotations

import argparse
import random
import statistics
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any

from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.reader import find_row, parts_on, read_root
from capture2vr.storage.catalogue.root import root_name
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.catalogue.tree import shards_of
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Head
from tests.bench.load.many_assets import WrittenBytes, fill
from tests.storage.catalogue.test_signing import ONE
from tests.support.bundles import bundle

_KEYS = Keys(signers=(ONE,))
_POLICY = PublishPolicy(_KEYS)
_PUBLISHED = 200  # assets that are published, not only listed


class MeteredStore(MemoryStore):
    """A store in memory that is as far away as `delay_s`, and counts what is written and read by each thread."""

    def __init__(self, delay_s: float) -> None:
        super().__init__()
        self.delay_s = delay_s
        self.written = WrittenBytes()
        self.read = 0
        self._counts = threading.Lock()

    def put(self, name: str, data: bytes | Path, **how: Any) -> Head:  # type: ignore[override]
        self.written.add(name, len(data) if isinstance(data, bytes) else data.stat().st_size)
        self._wait()
        return super().put(name, data, **how)

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        self._wait()
        data = super().get(name, start=start, length=length)
        with self._counts:
            self.read += len(data)
        return data

    def head(self, name: str) -> Head:
        self._wait()
        return super().head(name)

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        self._wait()
        return super().list(prefix, after=after, limit=limit)

    def delete(self, name: str) -> None:
        self._wait()
        super().delete(name)

    def _wait(self) -> None:
        if self.delay_s:
            time.sleep(self.delay_s)


def main(arguments: list[str]) -> None:
    """Print a table row for each size of the collection."""
    options = _parser().parse_args(arguments)
    columns = (
        "assets", "publication s, near", f"at {options.delay} ms a call", "kB written", "of them catalogue",
        f"{options.writers} publishers: a second", "slowest s", "root kB", "first page ms", "one key ms", "kB for it",
    )  # fmt: skip
    print(f"| {' | '.join(columns)} |")
    print("|" + "---|" * len(columns))
    for assets in options.assets:
        print(f"| {' | '.join(_row(assets, options))} |", flush=True)


def _row(assets: int, options: argparse.Namespace) -> list[str]:
    store = MeteredStore(0)
    _fill(store, assets)
    near, written, catalogue = _publish_some(store, options.times)
    looks = _look(store, assets)
    store.delay_s = options.delay / 1000
    far, _, _ = _publish_some(store, 5)
    rate, slowest = _publish_at_once(store, options.writers, options.times)
    return [
        f"{assets:,}", f"{near:.3f}", f"{far:.2f}", f"{written / 1000:.1f}", f"{catalogue / 1000:.1f}", f"{rate:.0f}",
        f"{slowest:.1f}", *(f"{value:.1f}" for value in looks),
    ]  # fmt: skip


def _fill(store: MeteredStore, assets: int) -> None:
    """Write a collection of assets, with keys as the product chooses them; large ones have rows and nothing else."""
    if assets <= _PUBLISHED:
        for number in range(assets):
            publish(bundle("refined", str(number)), store, key=f"capture-{number:012x}", policy=_POLICY)
        return
    rng = random.Random(assets)
    fill(store, "default", (f"capture-{rng.getrandbits(48):012x}" for _ in range(assets)), _KEYS.signers)


def _publish_some(store: MeteredStore, times: int) -> tuple[float, float, float]:
    """Return the median seconds of one publication, and mean bytes written, in all and by the catalogue."""
    seconds, before, catalogue = [], store.written.all, store.written.by_catalogue
    for _ in range(times):
        key = f"capture-{random.getrandbits(48):012x}"
        start = time.perf_counter()
        publish(bundle("refined", key), store, key=key, policy=_POLICY)
        seconds.append(time.perf_counter() - start)
    written, by_catalogue = store.written.all - before, store.written.by_catalogue - catalogue
    return statistics.median(seconds), written / times, by_catalogue / times


def _publish_at_once(store: MeteredStore, writers: int, times: int) -> tuple[float, float]:
    """Return publications a second of many publishers, and the seconds of the slowest."""

    def one(number: int) -> float:
        start = time.perf_counter()
        publish(bundle("refined", str(number)), store, key=f"capture-{random.getrandbits(48):012x}", policy=_POLICY)
        return time.perf_counter() - start

    start = time.perf_counter()
    with ThreadPoolExecutor(writers) as pool:
        each = list(pool.map(one, range(writers * max(2, times // 4))))
    return len(each) / (time.perf_counter() - start), max(each)


def _look(store: MeteredStore, assets: int) -> tuple[float, float, float, float]:
    """Return the root's kB, the milliseconds of a first page of 20 and of one key, and the kB that a key takes."""
    parts = parts_on(store, "default")
    root = len(store.get(root_name("default")))

    def first_page() -> None:
        index = read_root(store, "default", _KEYS.verification_keys)
        rows = (row for shard in shards_of(index, parts.nodes) for row in parts.rows(shard))
        assert len(list(islice(rows, 20))) == 20

    index = read_root(store, "default")
    key = next(iter(parts.rows(next(shards_of(index, parts.nodes, index.parts[len(index.parts) // 2].first))))).key

    def one_key() -> None:
        assert find_row(read_root(store, "default", _KEYS.verification_keys), key, parts) is not None

    page, look = _milliseconds(first_page), _milliseconds(one_key)
    before = store.read
    one_key()
    return root / 1000, page, look, (store.read - before) / 1000


def _milliseconds(call: Any) -> float:
    seconds = []
    for _ in range(20):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return 1000 * statistics.median(seconds)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench catalogue", description=__doc__)
    parser.add_argument("--assets", type=int, nargs="+", default=[100, 1000, 10_000, 100_000, 1_000_000])
    parser.add_argument("--delay", type=float, default=20.0, help="milliseconds of a store call")
    parser.add_argument("--writers", type=int, default=32)
    parser.add_argument("--times", type=int, default=20, help="publications that are measured")
    return parser
