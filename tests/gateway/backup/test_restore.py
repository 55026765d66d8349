"""A damaged database comes back: from a snapshot, from its own readable rows, from the store; nothing of it is lost."""

from __future__ import annotations

import os
import shutil
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from capture2vr.cli.backups.database_work import check_database, restore_database, scrub_store
from capture2vr.errors import BadInput
from capture2vr.gateway.access.caller import ALL_SCOPES
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.backup.restore import restore
from capture2vr.gateway.backup.snapshots import (
    NAME_TIME,
    DatabaseDamaged,
    Snapshots,
    check_file,
    snapshots_in,
    take_snapshot,
)
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.database.instance_lock import lock_instance
from capture2vr.gateway.jobs.job import Order, State
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Head
from capture2vr.storage.tenant_store import DEFAULT_TENANT, store_of_tenant
from tests.support.bundles import bundle


@pytest.fixture
def database(tmp_path: Path) -> Path:
    return tmp_path / "gateway.db"


def add_jobs(database: Path, *keys: str) -> list[str]:
    engine = open_engine(f"sqlite:///{database}")
    try:
        store = JobStore(engine)
        return [store.create(DEFAULT_TENANT, Order("cap_1", key, JobOptions("draft"))).id for key in keys]
    finally:
        engine.dispose()


def known_jobs(database: Path) -> dict[str, State]:
    """The states of all jobs; those that the database has counted are as many."""
    engine = open_engine(f"sqlite:///{database}")
    try:
        found = {job.id: job.state for job in JobStore(engine).page(DEFAULT_TENANT, limit=200)}
        assert JobStore(engine).figures().counts[State.QUEUED] == list(found.values()).count(State.QUEUED)
        return found
    finally:
        engine.dispose()


def spoil(database: Path, start: float, end: float) -> None:
    """Overwrite a part of the file, from and to these shares of it, after its log has been written into it."""
    with closing(sqlite3.connect(database)) as db:
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    size = database.stat().st_size
    with database.open("r+b") as file:
        file.seek(int(size * start))
        file.write(b"\xaa" * (int(size * end) - int(size * start)))


def test_a_whole_file_is_whole_and_a_cut_one_is_not(database: Path) -> None:
    add_jobs(database, *(f"key{number}" for number in range(50)))
    check_file(database)
    spoil(database, 0.5, 1.0)
    with pytest.raises(DatabaseDamaged):
        check_file(database)
    database.write_bytes(b"no database" * 100)
    with pytest.raises(DatabaseDamaged):
        check_file(database)


def test_snapshots_are_whole_and_the_newest_are_kept(database: Path, tmp_path: Path) -> None:
    made = []
    for day in range(4):
        add_jobs(database, f"key{day}")
        made.append(take_snapshot(database, tmp_path / "snapshots", 3, 1e9 + 86_400 * day))
    assert snapshots_in(tmp_path / "snapshots") == made[:0:-1]
    for snapshot in snapshots_in(tmp_path / "snapshots"):
        check_file(snapshot)
    assert len(known_jobs(made[-1])) == 4


def test_a_damaged_database_takes_no_snapshots_place(database: Path, tmp_path: Path) -> None:
    add_jobs(database, *(f"key{number}" for number in range(50)))
    good = take_snapshot(database, tmp_path / "snapshots", 1, 1e9)
    spoil(database, 0.4, 0.9)
    snapshots = Snapshots(f"sqlite:///{database}", tmp_path / "snapshots", 1)
    good_time = good.stat().st_mtime
    os.utime(good, (good_time - 2 * 86_400, good_time - 2 * 86_400))
    snapshots.take_if_due(database)
    assert snapshots.fault
    assert snapshots_in(tmp_path / "snapshots") == [good]


def test_one_is_taken_a_day(database: Path, tmp_path: Path) -> None:
    add_jobs(database, "a")
    snapshots = Snapshots(f"sqlite:///{database}", tmp_path / "snapshots", 7)
    assert snapshots.newest is None
    for _ in range(3):
        snapshots.take_if_due(database)
    assert len(snapshots_in(tmp_path / "snapshots")) == 1
    assert snapshots.newest is not None
    assert time.time() - snapshots.newest < 3600


def test_what_came_after_the_snapshot_is_read_from_the_damaged_file(database: Path, tmp_path: Path) -> None:
    before = add_jobs(database, *(f"key{number}" for number in range(30)))
    take_snapshot(database, tmp_path / "snapshots", 3, time.time())
    after = add_jobs(database, *(f"later{number}" for number in range(100)))
    spoil(database, 0.8, 0.9)
    damaged = database.read_bytes()
    done = restore(database, tmp_path / "snapshots", MemoryStore())
    assert done.snapshot is not None
    assert done.kept is not None
    assert done.kept.read_bytes() == damaged
    check_file(database)
    found = known_jobs(database)
    assert set(before) <= found.keys()
    assert set(found) <= {*before, *after}
    assert done.rows >= len(found.keys() & set(after)) > 0


@pytest.mark.parametrize("hole", [(0.0, 0.0), (0.8, 0.9)])
def test_rows_are_read_whatever_their_numbers_are(database: Path, tmp_path: Path, hole: tuple[float, float]) -> None:
    """As after years in which retention has deleted older jobs: more numbers were given than the file has space for."""
    jobs = add_jobs(database, *(f"key{number}" for number in range(100)))
    with closing(sqlite3.connect(database)) as db:
        for table in ("jobs", "leases"):
            db.execute(f"UPDATE {table} SET rowid = rowid + 100000000")
        db.commit()
    spoil(database, *hole)
    restore(database, tmp_path / "snapshots", MemoryStore())
    found = known_jobs(database).keys() & set(jobs)
    assert len(found) == len(jobs) if hole == (0.0, 0.0) else len(found) > 0


def test_a_file_that_is_no_database_any_more_is_replaced_by_the_snapshot(database: Path, tmp_path: Path) -> None:
    jobs = add_jobs(database, "a", "b")
    engine = open_engine(f"sqlite:///{database}")
    access = AccessStore(engine)
    access.ensure_tenant("ada")
    key, _ = access.create_key("ada", ALL_SCOPES)
    engine.dispose()
    take_snapshot(database, tmp_path / "snapshots", 3, time.time())
    database.write_bytes(b"\xaa" * 50_000)
    done = restore(database, tmp_path / "snapshots", MemoryStore())
    assert known_jobs(database).keys() == set(jobs)
    engine = open_engine(f"sqlite:///{database}")
    assert AccessStore(engine).key(key.id) is not None
    engine.dispose()
    assert done.rows == 0


@pytest.mark.slow
def test_without_a_snapshot_the_store_tells_what_was_published(database: Path, tmp_path: Path) -> None:
    store = MemoryStore()
    mine, adas = "job_019b2f7c8a3e5d1f0a9b8c7d6e5f4a3b", "job_019b2f7c8a3e5d1f0a9b8c7d6e5f4a3c"
    publish(bundle(), store, key="dress", job=mine, fence=1)
    publish(bundle(), store_of_tenant(store, "ada"), key="dress", job=adas, fence=1)
    database.write_bytes(b"\xaa" * 50_000)
    done = restore(database, tmp_path / "snapshots", store)
    assert (done.snapshot, done.jobs) == (None, 2)
    engine = open_engine(f"sqlite:///{database}")
    try:
        jobs = JobStore(engine)
        for tenant, job in ((DEFAULT_TENANT, mine), ("ada", adas)):
            (found,) = jobs.page(tenant, limit=10)
            assert (found.id, found.state, found.order.asset_key) == (job, State.SUCCEEDED, "dress")
            assert found.asset is not None
            assert found.asset["version"] == 1
    finally:
        engine.dispose()
    assert restore(database, tmp_path / "snapshots", store).jobs == 0, "they are in the database now"


class _AwayStore(MemoryStore):
    """A store that cannot be reached."""

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        raise OSError("the store does not answer")


@pytest.fixture
def damaged(database: Path, tmp_path: Path) -> set[str]:
    """Damage the database, whose snapshot knows one of its jobs; return what can be read of all its jobs."""
    old = add_jobs(database, "old")
    take_snapshot(database, tmp_path / "snapshots", 3, time.time())
    add_jobs(database, *(f"new{number}" for number in range(100)))
    spoil(database, 0.8, 0.9)
    (tmp_path / "copy").mkdir()
    copy = Path(shutil.copy(database, tmp_path / "copy"))
    restore(copy, tmp_path / "snapshots", MemoryStore())
    found = set(known_jobs(copy))
    assert len(found) > len(old)
    return found


def others_beside(database: Path) -> list[str]:
    return sorted(file.name for file in database.parent.glob(f"{database.stem}*") if file != database)


def test_a_restore_that_fails_changes_nothing_and_its_repeat_loses_nothing(
    database: Path, tmp_path: Path, damaged: set[str]
) -> None:
    before = database.read_bytes()
    for _ in range(2):
        with pytest.raises(OSError, match="does not answer"):
            restore(database, tmp_path / "snapshots", _AwayStore())
        assert database.read_bytes() == before
        assert others_beside(database) == [], "nothing half built stays"
    done = restore(database, tmp_path / "snapshots", MemoryStore())
    assert set(known_jobs(database)) == damaged
    assert done.kept is not None
    assert done.kept.read_bytes() == before


def test_what_a_killed_restore_has_half_built_is_not_used(database: Path, tmp_path: Path, damaged: set[str]) -> None:
    for suffix in ("", "-wal", "-shm", "-journal"):
        (tmp_path / f"gateway-restoring.db{suffix}").write_bytes(b"half")
    done = restore(database, tmp_path / "snapshots", MemoryStore())
    check_file(database)
    assert set(known_jobs(database)) == damaged
    assert done.kept is not None
    assert others_beside(database) == [done.kept.name]


def test_a_restore_that_was_cut_off_between_its_renames_is_repeated(
    database: Path, tmp_path: Path, damaged: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rename = Path.rename

    def cut_off(self: Path, target: Path) -> Path:
        if target == database:
            raise KeyboardInterrupt
        return rename(self, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", cut_off)
        with pytest.raises(KeyboardInterrupt):
            restore(database, tmp_path / "snapshots", MemoryStore())
    assert not database.exists()
    (aside,) = tmp_path.glob("gateway-damaged-*.db")
    done = restore(database, tmp_path / "snapshots", MemoryStore())
    assert set(known_jobs(database)) == damaged
    assert done.kept == aside
    assert others_beside(database) == [aside.name]


def test_a_log_that_was_not_yet_renamed_is_read_too(database: Path, tmp_path: Path) -> None:
    """What a crash leaves after the first of all renames: a file set aside, its log at the old place, a new file."""
    add_jobs(database, "old")
    take_snapshot(database, tmp_path / "snapshots", 3, time.time())
    with closing(sqlite3.connect(database)) as reader:  # keeps the log from being written into the file
        reader.execute("SELECT count(*) FROM jobs").fetchone()
        jobs = add_jobs(database, "new")
        log = Path(f"{database}-wal").read_bytes()
        aside = shutil.copy(
            database, tmp_path / f"gateway-damaged-{datetime.now(UTC) + timedelta(minutes=1):{NAME_TIME}}.db"
        )
    database.rename(tmp_path / "gateway-restoring.db")
    Path(f"{database}-wal").write_bytes(log)
    done = restore(database, tmp_path / "snapshots", MemoryStore())
    assert set(jobs) <= known_jobs(database).keys()
    assert done.kept == aside


def test_a_damaged_file_from_before_the_snapshot_is_not_read(database: Path, tmp_path: Path) -> None:
    """It is of an earlier restore: its rows would replace newer ones."""
    add_jobs(database, "a")
    shutil.copy(database, tmp_path / "gateway-damaged-20200101T000000Z.db")
    jobs = add_jobs(database, "b")
    take_snapshot(database, tmp_path / "snapshots", 3, time.time())
    database.unlink()
    done = restore(database, tmp_path / "snapshots", MemoryStore())
    assert (done.kept, done.rows) == (None, 0)
    assert set(jobs) <= known_jobs(database).keys()


def test_two_restores_within_a_second_keep_both_damaged_files(database: Path, tmp_path: Path) -> None:
    for content in (b"\xaa" * 50_000, b"\xbb" * 50_000):
        database.write_bytes(content)
        done = restore(database, tmp_path / "snapshots", MemoryStore())
        assert done.kept is not None
        assert done.kept.read_bytes() == content
    assert len(list(tmp_path.glob("gateway-damaged-*.db"))) == 2


class TestCommands:
    @pytest.fixture
    def database(self, tmp_path: Path) -> Path:
        (tmp_path / "data" / "gateway").mkdir(parents=True)
        return tmp_path / "data" / "gateway" / "gateway.db"

    def test_a_damaged_database_is_found_and_restored(self, database: Path, tmp_path: Path) -> None:
        jobs = add_jobs(database, *(f"key{number}" for number in range(50)))
        take_snapshot(database, database.parent / "snapshots", 3, time.time())
        assert check_database(tmp_path / "data")
        spoil(database, 0.5, 1.0)
        assert not check_database(tmp_path / "data")
        restore_database(tmp_path / "data")
        assert check_database(tmp_path / "data")
        assert known_jobs(database).keys() == set(jobs)

    def test_no_gateway_may_run_meanwhile(self, database: Path, tmp_path: Path) -> None:
        add_jobs(database, "a")
        with lock_instance(database.parent), pytest.raises(BadInput, match="another gateway uses"):
            restore_database(tmp_path / "data")
        check_file(database)

    @pytest.mark.parametrize("command", [check_database, restore_database, scrub_store])
    def test_a_mistyped_data_folder_is_named_and_not_made(
        self, command: Callable[[Path], object], tmp_path: Path
    ) -> None:
        with pytest.raises(BadInput, match=r"dta does not exist: name the data folder of the gateway with --data"):
            command(tmp_path / "dta")
        assert not (tmp_path / "dta").exists()

    def test_a_missing_database_is_named(self, database: Path, tmp_path: Path) -> None:
        with pytest.raises(FileNotFoundError, match=r"gateway\.db"):
            check_database(tmp_path / "data")
