"""The database's schema: what migrations make is what the code expects, and what was stored before is still there."""

from __future__ import annotations

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic import op
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

import capture2vr.gateway.app  # noqa: F401 - with it come all tables
from capture2vr.gateway import migrations
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.database.database import create_engine, metadata, open_engine, pipelined
from capture2vr.gateway.database.schema import SchemaNewer, least_readable, newest_schema, number_of, schema_of
from capture2vr.gateway.jobs.job import Order
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.jobs.tables import queue_turns
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import JobOptions
from capture2vr.process.strict_settings import SettingsError

_ORDER = Order("cap_1", "dress", JobOptions("draft", names=AssetNames("Dress")))
_JOB = "job_" + "0" * 32
MIGRATIONS = Path(migrations.__file__).parent


def test_the_migrations_make_the_tables_that_the_code_expects(url: str) -> None:
    engine = open_engine(url)
    with engine.connect() as db:
        options = {"compare_type": True, "compare_server_default": True}
        assert compare_metadata(MigrationContext.configure(db, opts=options), metadata) == []
    engine.dispose()


def test_a_postgres_url_needs_no_driver(empty_postgres: str) -> None:
    """As other programs write it; what it says of timeouts is left as it is."""
    for scheme in ("postgres", "postgresql"):
        url = f"{scheme}{empty_postgres.removeprefix('postgresql+psycopg')}?connect_timeout=77"
        engine = open_engine(url)
        assert (engine.dialect.driver, engine.url.query["connect_timeout"]) == ("psycopg", "77")
        engine.dispose()


def test_statements_that_are_sent_together_fail_as_one_alone_does(url: str) -> None:
    engine = open_engine(url)

    def insert(times: int, *, commit: bool) -> None:
        with engine.connect() as db, pipelined(db):
            for _ in range(times):
                db.execute(queue_turns.insert().inline(), {"tenant": "ada", "served": 1.0})
            if commit:
                db.commit()

    for commit in (True, False):
        with pytest.raises(sa.exc.IntegrityError):
            insert(2, commit=commit)
    with engine.connect() as db:
        assert db.execute(sa.select(queue_turns)).all() == []
    insert(1, commit=True)
    with engine.connect() as db:
        assert db.execute(sa.select(queue_turns.c.tenant)).scalars().all() == ["ada"]
    engine.dispose()


def make_first_schema(url: str) -> None:
    """A database as the gateway made it before there were migrations, with a job and its idempotency key."""
    engine = sa.create_engine(url)
    text, number = "VARCHAR(255) NOT NULL", "DOUBLE PRECISION NOT NULL"
    with engine.begin() as db:
        db.exec_driver_sql(
            f'CREATE TABLE jobs (id VARCHAR(64) PRIMARY KEY, "order" JSON NOT NULL, state {text}, stage {text}, '
            f"fraction {number}, elapsed_s {number}, eta_s {number}, preview JSON, asset JSON, error JSON, "
            f"warnings JSON NOT NULL, seconds JSON NOT NULL, last_event INTEGER NOT NULL, created {number}, "
            f"updated {number})"
        )
        db.exec_driver_sql(
            f"CREATE TABLE leases (job VARCHAR(64) PRIMARY KEY REFERENCES jobs, holder {text}, worker {text}, "
            f"fence BIGINT NOT NULL, attempts INTEGER NOT NULL, until {number}, not_before {number}, "
            "run_seq BIGINT NOT NULL, cancel BOOLEAN NOT NULL)"
        )
        db.exec_driver_sql(
            f"CREATE TABLE idempotency_keys (key VARCHAR(255) PRIMARY KEY, body_sha256 {text}, "
            "job VARCHAR(64) NOT NULL REFERENCES jobs)"
        )
        db.execute(
            sa.text(
                'INSERT INTO jobs (id, "order", state, stage, fraction, elapsed_s, eta_s, warnings, seconds, '
                "last_event, created, updated) VALUES (:id, :order, 'QUEUED', '', 0, 0, 0, '[]', '{}', 0, 1, 1)"
            ),
            {"id": _JOB, "order": json.dumps(_ORDER.as_json)},
        )
        db.exec_driver_sql(f"INSERT INTO leases VALUES ('{_JOB}', '', '', 0, 0, 0, 0, 0, false)")
        db.exec_driver_sql(f"INSERT INTO idempotency_keys VALUES ('k', 'sha', '{_JOB}')")
    engine.dispose()


def test_jobs_of_before_the_tenants_are_the_default_tenants(url: str) -> None:
    make_first_schema(url)
    engine = open_engine(url)
    jobs = JobStore(engine)
    assert jobs.get("default", _JOB).order == _ORDER
    assert jobs.find_by_key("default", "k", "sha") == jobs.get("default", _JOB)
    assert jobs.page("ada", limit=5) == []
    with engine.connect() as db:  # which the queue's index holds
        assert db.exec_driver_sql("SELECT state, preset FROM jobs").all() == [("QUEUED", "draft")]
    assert not AccessStore(engine).has_keys()
    engine.dispose()


@pytest.mark.parametrize("wrong", ["gateway.db", "mysql://u:secret@h/d", "postgresql://u:secret@h:port/d", "://"])
def test_a_url_of_no_database_is_an_error_that_names_the_variable(wrong: str) -> None:
    with pytest.raises(SettingsError, match=r"GATEWAY_DATABASE_URL: must be postgresql://") as told:
        GatewaySettings(database_url=wrong)
    assert "secret" not in str(told.value)


def test_gateways_that_start_at_once_migrate_once(url: str) -> None:
    make_first_schema(url)
    gate = threading.Barrier(4)

    def start(_: int) -> None:
        gate.wait()
        open_engine(url).dispose()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(start, range(4)))
    engine = open_engine(url)
    assert [tenant.name for tenant in AccessStore(engine).list_tenants(limit=9)] == ["default"]
    engine.dispose()


def newer(url: str, revision: str, least: int | None) -> None:
    """Make a database one of a newer gateway."""
    open_engine(url).dispose()
    engine = sa.create_engine(url)
    with engine.begin() as db:
        db.execute(
            sa.text("UPDATE alembic_version SET version_num = :new, least_readable = :least"),
            {"new": revision, "least": least},
        )
    engine.dispose()


@pytest.mark.parametrize("least", [9999, None])
def test_a_database_of_a_newer_gateway_is_refused_and_left_alone(url: str, least: int | None) -> None:
    newer(url, "9999", least)
    with pytest.raises(SchemaNewer, match=r"newer gateway \(schema 9999.*restore the backup"):
        open_engine(url)
    engine = sa.create_engine(url)
    with engine.begin() as db:
        assert schema_of(db) == "9999"
    engine.dispose()


def test_a_newer_schema_that_this_gateway_reads_is_worked_with(url: str) -> None:
    """The gateway of the release before, beside a newer one: new columns with a default are none of its business."""
    newer(url, "9999_later", number_of(newest_schema()))
    other = sa.create_engine(url)
    with other.begin() as db:
        db.exec_driver_sql("ALTER TABLE jobs ADD COLUMN mood VARCHAR(9) NOT NULL DEFAULT 'calm'")
    engine = open_engine(url)
    created = JobStore(engine).create("default", _ORDER)
    assert JobStore(engine).get("default", created.id).order == _ORDER
    with other.begin() as db:
        assert db.exec_driver_sql("SELECT version_num, least_readable FROM alembic_version").all() == [
            ("9999_later", number_of(newest_schema()))
        ]
    for each in (engine, other):
        each.dispose()


def test_every_migration_leaves_a_database_that_the_release_before_works_with() -> None:
    """Expand, then contract: what the schema before it used, a migration does not take away."""
    for script in ScriptDirectory(str(MIGRATIONS), version_locations=[str(MIGRATIONS)]).walk_revisions():
        number = number_of(script.revision)
        assert number > 0, script.revision
        if number >= 11:
            assert 10 <= script.module.least_readable < number, script.revision


def test_the_database_says_which_gateways_work_with_it(url: str) -> None:
    engine = open_engine(url)
    with engine.connect() as db:
        assert least_readable(db) == 10
    engine.dispose()


def test_each_migration_has_a_transaction_of_its_own(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that fails leaves what those before it have done, and the next start goes on from there."""
    make_first_schema(url)
    with monkeypatch.context() as patch:
        patch.setattr(op, "batch_alter_table", _fails)  # of the tenth
        with pytest.raises(RuntimeError, match="of a test"):
            open_engine(url)
    engine = create_engine(url)
    with engine.connect() as db:
        assert schema_of(db) == "0009_credentials"
    engine.dispose()
    engine = open_engine(url)
    with engine.connect() as db:
        assert schema_of(db) == newest_schema()
    engine.dispose()


def _fails(*_: object) -> None:
    raise RuntimeError("of a test")


def test_a_migration_waits_for_a_table_that_others_use(empty_postgres: str) -> None:
    """It does not stand in their way meanwhile: who wants a table behind it would wait too."""
    make_first_schema(empty_postgres)
    other = sa.create_engine(empty_postgres)
    with other.begin() as db, ThreadPoolExecutor(1) as pool:
        db.exec_driver_sql("SELECT count(*) FROM jobs")
        migrating = pool.submit(open_engine, empty_postgres)
        while not db.exec_driver_sql(
            "SELECT count(*) FROM pg_locks WHERE NOT granted AND relation = 'jobs'::regclass"
        ).scalar_one():
            assert not migrating.done()
            time.sleep(0.01)
        while db.exec_driver_sql(
            "SELECT count(*) FROM pg_locks WHERE NOT granted AND relation = 'jobs'::regclass"
        ).scalar_one():
            time.sleep(0.01)  # until it gives up for a moment
        assert not migrating.done()
        db.commit()
        migrating.result().dispose()
    other.dispose()
