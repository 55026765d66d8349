"""A database is exported while it is in use and imported into an empty one, of the same kind or the other."""

from __future__ import annotations

import json
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

import capture2vr.gateway.app  # noqa: F401 - with it come all tables
from capture2vr.gateway.access.caller import ALL_SCOPES
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.backup.database_copy import (
    DatabaseNotEmpty,
    check_importable,
    export_database,
    import_database,
    lost_rows,
)
from capture2vr.gateway.database.database import create_engine, metadata, open_engine
from capture2vr.gateway.database.schema import newest_schema, schema_of, upgrade
from capture2vr.gateway.jobs.job import Order, State
from capture2vr.gateway.jobs.reports import RunFinished, VersionPublished
from capture2vr.gateway.jobs.state_machine import Retry, apply_reports, lease_to_worker, request_cancel
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.resumable.store import Chunk, UploadStore
from capture2vr.gateway.webhooks.outbox import Outbox
from capture2vr.gateway.webhooks.store import WebhookStore
from capture2vr.order.job_options import JobOptions

RETRY = Retry(3, 0.0)


@contextmanager
def opened(url: str) -> Iterator[sa.Engine]:
    engine = open_engine(url)
    try:
        yield engine
    finally:
        engine.dispose()


@pytest.fixture(params=["of the other kind"])
def target(url: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[str]:
    """Another empty database."""
    if url.startswith("sqlite") == (request.param == "of the same kind"):
        yield f"sqlite:///{tmp_path / 'restored.db'}"
        return
    postgres: str = request.getfixturevalue("postgres")
    server = sa.create_engine(postgres, isolation_level="AUTOCOMMIT")
    with server.connect() as db:
        db.exec_driver_sql("CREATE DATABASE restored ENCODING 'UTF8' TEMPLATE template0")
        yield postgres.removesuffix("/postgres") + "/restored"
        db.exec_driver_sql("DROP DATABASE restored")
    server.dispose()


def fill(engine: sa.Engine) -> dict[str, str]:
    """One of everything that outlives a restart; jobs by what they do."""
    access, jobs = AccessStore(engine), JobStore(engine)
    access.ensure_tenant("ada", 'A "da" Ω\u2028\U0001f457')
    access.create_key("ada", ALL_SCOPES, label="phone")
    access.secret("session")
    access.set_limits("ada", {"jobs_at_once": 3})
    WebhookStore(engine).create("ada", "https://ada.example/hook", (), "", most=9)
    names = ("ended", "runs", "stops", "waits")
    made = {
        name: jobs.create("ada", Order("cap_1", name, JobOptions("draft", longest_m=0.1)), key=name).id
        for name in names
    }
    for _ in names[:3]:
        jobs.claim(
            time.time(), ["draft"], lambda job: lease_to_worker(job, holder="gw", worker="w", now=1e9, lease_s=9)
        )
    reports = [
        VersionPublished(1, "ended", 1, "refined", "assets/ended/manifest.json", "default"),
        RunFinished(2, ("odd",), {"FITTING": 0.1 + 0.2}),
    ]
    jobs.change(made["ended"], lambda job: apply_reports(job, 1, reports, now=time.time(), retry=RETRY))
    jobs.change(made["stops"], lambda job: request_cancel(job, now=time.time()))
    return made


def rows(engine: sa.Engine) -> dict[str, list[tuple[Any, ...]]]:
    """All rows of all tables; JSON as its text, which tells null from NULL."""
    found = {}
    with engine.connect() as db:
        for table in metadata.sorted_tables:
            if table.name == "job_counts":  # made anew by triggers, of which each test of them tells
                continue
            columns = [sa.cast(each, sa.Text) if isinstance(each.type, sa.JSON) else each for each in table.columns]
            stored = db.execute(sa.select(*columns)).all()
            texts = [isinstance(each.type, sa.JSON) for each in table.columns]
            found[table.name] = sorted(
                (
                    tuple(
                        json.dumps(json.loads(cell)) if text and cell is not None else cell
                        for cell, text in zip(row, texts, strict=True)
                    )
                    for row in stored
                ),
                key=repr,
            )
    return found


def copied(url: str, target: str, tmp_path: Path) -> tuple[int, int]:
    exported = export_database(url, tmp_path / "database.zip")
    check_importable(target, exported.schema)
    done = import_database(target, tmp_path / "database.zip", exported.schema)
    assert done.rows == exported.rows
    assert list(lost_rows(target, tmp_path / "database.zip")) == [], "with jobs that run and are queued again, too"
    return done.rows, done.queued


@pytest.mark.slow
@pytest.mark.parametrize("target", ["of the same kind", "of the other kind"], indirect=True)
def test_every_row_comes_back(url: str, target: str, tmp_path: Path) -> None:
    with opened(url) as engine:
        fill(engine)
        before = rows(engine)
        assert copied(url, target, tmp_path) == (sum(map(len, before.values())), 1)
        assert rows(engine) == before, "an export changes nothing"
    with opened(target) as engine:
        after = rows(engine)
    changed = {name for name in before if after[name] != before[name]}
    assert changed == {"jobs", "leases", "events", "webhook_messages", "ended_jobs"}, "of the jobs that ran"
    assert all(len(found) for name, found in before.items() if name in ("tenants", "api_keys", "secrets", "webhooks"))


def test_jobs_that_ran_are_queued_again_and_others_are_as_they_were(url: str, target: str, tmp_path: Path) -> None:
    with opened(url) as engine:
        made = fill(engine)
        ended = JobStore(engine).get("ada", made["ended"])
        copied(url, target, tmp_path)
    with opened(target) as engine:
        jobs = JobStore(engine)
        assert jobs.get("ada", made["ended"]) == ended
        states = {name: jobs.get("ada", job).state for name, job in made.items()}
        assert jobs.figures().counts == {state: list(states.values()).count(state) for state in State}
        assert states == {
            "ended": State.SUCCEEDED,
            "runs": State.QUEUED,
            "stops": State.CANCELLED,
            "waits": State.QUEUED,
        }
        runs = jobs.get("ada", made["runs"])
        assert (runs.lease.holder, runs.lease.worker, runs.lease.attempts) == ("", "", 0)
        for name in ("runs", "waits"):  # above what a worker may have published since the backup
            assert jobs.get("ada", made[name]).lease.fence > time.time() - 3_600
        assert jobs.find_by_key("ada", "waits", "") == jobs.get("ada", made["waits"])


def test_the_restored_database_is_one_to_go_on_with(url: str, target: str, tmp_path: Path) -> None:
    """Numbers of events and audit rows go on, rows of the log cannot be changed, jobs are claimed."""
    with opened(url) as engine:
        made = fill(engine)
        copied(url, target, tmp_path)
    with opened(target) as engine:
        jobs = JobStore(engine)
        newest = jobs.newest_event_id()
        new = jobs.create("ada", Order("cap_2", "new", JobOptions("draft")))
        assert jobs.newest_event_id() > newest
        lease = lambda job: lease_to_worker(job, holder="gw", worker="w", now=time.time(), lease_s=9)  # noqa: E731
        claimed = [jobs.claim(time.time() + 1, ["draft"], lease) for _ in range(3)]
        assert {job.id for job in claimed if job} == {made["runs"], made["waits"], new.id}
        with engine.connect() as db:
            assert schema_of(db) == newest_schema()


def test_uploads_that_had_not_ended_are_forgotten(url: str, target: str, tmp_path: Path) -> None:
    with opened(url) as engine:
        AccessStore(engine).ensure_tenant("ada")
        uploads = UploadStore(engine)
        later = time.time() + 3_600
        going, done = (uploads.create("ada", 10, {"filename": name}, later, 5) for name in ("a.zip", "b.zip"))
        assert going is not None
        assert done is not None
        for each in (going, done):
            assert uploads.take_over(each, "writer")
            assert uploads.append(each.id, 0, [Chunk(0, 10, "writer")], later)
        held = uploads.lease(uploads.get("ada", done.id, time.time()) or done, "finisher", "cap_1", time.time())
        assert held is not None
        assert uploads.finish(done.id, time.time())
        copied(url, target, tmp_path)
    with opened(target) as engine:
        uploads = UploadStore(engine)
        assert uploads.get("ada", going.id, time.time()) is None
        found = uploads.get("ada", done.id, time.time())
        assert found is not None
        assert found.capture == "cap_1"


def test_what_webhooks_were_told_is_not_told_again(url: str, target: str, tmp_path: Path) -> None:
    with opened(url) as engine:
        fill(engine)
        outbox = Outbox(engine)
        (delivery,) = outbox.claim(time.time(), 1, set())
        outbox.delivered(delivery.message, "204", time.time())
        copied(url, target, tmp_path)
    with opened(target) as engine:
        outbox = Outbox(engine)
        again = []
        while found := outbox.claim(time.time() + 1, 9, set()):
            again += [each.message.id for each in found]
            for each in found:
                outbox.delivered(each.message, "204", time.time())
        assert delivery.message.id not in again
        assert len(again) == len(set(again))


def test_an_older_schema_is_migrated(url: str, target: str, tmp_path: Path) -> None:
    old = create_engine(url)
    with old.connect() as db, db.begin():
        upgrade(db, "0003_limits")
        job = {"id": "job_" + "1" * 32, "order": json.dumps({"capture": "c", "preset": "fine", "asset_key": "k"})}
        db.execute(
            sa.text(
                'INSERT INTO jobs (id, "order", state, stage, fraction, elapsed_s, eta_s, warnings, seconds, '
                "last_event, created, updated) VALUES (:id, :order, 'QUEUED', '', 0, 0, 0, '[]', '{}', 0, 1, 1)"
            ),
            job,
        )
        db.execute(sa.text("INSERT INTO leases VALUES (:id, '', '', 0, 0, 0, 0, 0, false)"), {"id": job["id"]})
    old.dispose()
    open_engine(target).dispose()  # a gateway of now has started on it
    copied(url, target, tmp_path)
    with opened(target) as engine:
        assert JobStore(engine).get("default", job["id"]).order.options.preset == "fine"
        with engine.connect() as db:
            assert schema_of(db) == newest_schema()
            assert db.execute(sa.text("SELECT preset FROM jobs")).scalar_one() == "fine"


def test_a_newer_schema_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match=r"newer version of capture2vr \(schema 9999"):
        check_importable(url, "9999")


@pytest.mark.slow
def test_a_database_with_rows_is_refused_and_left_alone(url: str, target: str, tmp_path: Path) -> None:
    with opened(url) as engine:
        fill(engine)
    exported = export_database(url, tmp_path / "database.zip")
    with opened(target) as engine:
        JobStore(engine).create("default", Order("cap_1", "mine", JobOptions("draft")))
        before = rows(engine)
    for refuse in (
        lambda: check_importable(target, exported.schema),
        lambda: import_database(target, tmp_path / "database.zip", exported.schema),
    ):
        with pytest.raises(DatabaseNotEmpty, match="it has rows: 1 in jobs, "):
            refuse()
    with opened(target) as engine:
        assert rows(engine) == before


def test_a_cut_import_leaves_the_database_empty_and_can_be_repeated(url: str, target: str, tmp_path: Path) -> None:
    with opened(url) as engine:
        fill(engine)
    whole, cut = tmp_path / "database.zip", tmp_path / "cut.zip"
    schema = export_database(url, whole).schema
    with zipfile.ZipFile(whole) as source, zipfile.ZipFile(cut, "w") as out:
        for name in source.namelist():
            lines = source.read(name)
            out.writestr(name, lines[:-3] if name == "webhooks.jsonl" else lines)
    with pytest.raises(ValueError):
        import_database(target, cut, schema)
    assert import_database(target, whole, schema).queued == 1


def test_an_export_is_of_one_moment(url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs that are created between its queries are in none of its tables."""
    from capture2vr.gateway.backup import database_copy

    with opened(url) as engine:
        jobs, write = JobStore(engine), database_copy._write_table
        jobs.create("default", Order("cap_1", "before", JobOptions("draft")))

        def create_and_write(*arguments: Any) -> int:
            jobs.create("default", Order("cap_1", "meanwhile", JobOptions("draft")))
            return write(*arguments)

        monkeypatch.setattr(database_copy, "_write_table", create_and_write)
        export_database(url, tmp_path / "database.zip")
        assert len(jobs.page("default", limit=50)) > 2
    with zipfile.ZipFile(tmp_path / "database.zip") as archive:
        counts = {name: archive.read(f"{name}.jsonl").count(b"\n") - 1 for name in ("jobs", "leases", "events")}
    assert counts == {"jobs": 1, "leases": 1, "events": 1}
