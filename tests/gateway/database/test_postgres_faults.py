"""Postgres that is away, read-only, full or of the wrong encoding: a sentence and a code, and jobs go on afterwards."""

from __future__ import annotations

import asyncio
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa

from capture2vr.gateway.database.database import WrongEncoding, open_engine
from tests.referees.postgres import PostgresServer, running_server
from tests.support.in_process_gateway import (
    Making,
    capture,
    ended,
    events,
    gateway,
    job_when,
    memory,
    start,
    until,
    worker,
)
from tests.support.patience import HANG_S
from tests.support.repository import ROOT


@contextmanager
def operator(url: str) -> Iterator[sa.Connection]:
    """A connection that may write whatever the database's default is; each statement is committed."""
    engine = sa.create_engine(url, connect_args={"options": "-c default_transaction_read_only=off"})
    try:
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as db:
            yield db
    finally:
        engine.dispose()


@pytest.fixture
def server(postgres_programs: Path) -> Iterator[PostgresServer]:
    """A server of this test alone."""
    with running_server(postgres_programs) as made:
        yield made


def refusal(answer: httpx.Response) -> tuple[int, str]:
    assert answer.headers["content-type"] == "application/problem+json"
    assert int(answer.headers["retry-after"]) > 0
    assert answer.json()["retryable"]
    return answer.status_code, answer.json()["code"]


async def database_check(client: httpx.AsyncClient) -> tuple[int, str]:
    answer = await client.get("/readyz")
    return answer.status_code, answer.json()["checks"]["database"]["detail"]


@pytest.fixture
def ascii_database(postgres: str) -> Iterator[str]:
    with operator(postgres) as db:
        create = "CREATE DATABASE plain ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0"
        db.exec_driver_sql(create)
        yield postgres.removesuffix("/postgres") + "/plain"
        db.exec_driver_sql("DROP DATABASE plain")


@pytest.mark.slow
def test_an_encoding_that_cannot_store_all_text_is_refused_and_named(ascii_database: str, tmp_path: Path) -> None:
    with pytest.raises(WrongEncoding, match=r"'plain' has the encoding SQL_ASCII.*ENCODING 'UTF8'"):
        open_engine(ascii_database)
    variables = {"GATEWAY_DATABASE_URL": ascii_database, "GATEWAY_DATA_DIR": str(tmp_path), "GATEWAY_PORT": "0"}
    started = subprocess.run(
        [sys.executable, "-m", "capture2vr.gateway"],
        env={**os.environ, **variables, "STORAGE_ROOT": str(tmp_path / "objects")},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert started.returncode == 1
    assert "cannot start: the jobs database 'plain' has the encoding SQL_ASCII" in started.stderr
    assert "Traceback" not in started.stderr


@pytest.mark.essential
@pytest.mark.slow
async def test_a_server_that_comes_back_finds_every_job_done_once(
    server: PostgresServer, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = memory()
    work = Making(store)
    caplog.set_level(logging.INFO)
    async with (
        worker(work, tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port, database_url=server.url) as client,
    ):
        runs = await start(client, capture(store, wait=True))
        await job_when(client, runs, lambda found: found["fraction"] > 0)
        waits = await start(client, capture(store, "cap_2"), "hat")
        stream = asyncio.create_task(events(client, runs))
        await until(lambda: _is_followed(client))
        await asyncio.to_thread(server.stop)
        order = {"capture": "cap_1", "asset_key": "shoe"}
        assert refusal(await client.get("/v1/jobs")) == (503, "DATABASE_UNAVAILABLE")
        assert refusal(await client.post("/v1/jobs", json=order)) == (503, "DATABASE_UNAVAILABLE")
        assert await database_check(client) == (503, "it is busy, or cannot be reached or used")
        assert (await client.get("/livez")).status_code == 200
        work.release.set()  # the run ends, and its end cannot be stored
        await until(lambda: _is_logged(caplog, "its run supervisor failed"))
        await asyncio.to_thread(server.start)
        done = [await ended(client, job) for job in (runs, waits)]
        story = await stream
        assert (await client.get("/readyz")).status_code == 200
        asked = await client.get("/v1/jobs")
    assert [(job["state"], job["attempts"]) for job in done] == [("SUCCEEDED", 1), ("SUCCEEDED", 1)]
    assert work.runs == [runs, waits]
    assert len(asked.json()["jobs"]) == 2, "what was refused was not done"
    assert [number for number, _, _ in story if number] == list(range(1, story[-1][0] + 1)), "the stream went on"
    assert "a background task of the gateway ended" not in caplog.text
    assert caplog.text.count("no longer tells of changes") == 1, "told once, not every second"


async def _is_followed(client: httpx.AsyncClient) -> bool:
    """Whether a stream of events is open: one that is opened while the database is away is refused."""
    return "capture2vr_event_listeners 1.0" in (await client.get("/metrics")).text


async def _is_logged(caplog: pytest.LogCaptureFixture, text: str) -> bool:
    return text in caplog.text


async def test_a_read_only_database_is_named(empty_postgres: str, tmp_path: Path) -> None:
    store = memory()
    order = {"capture": capture(store), "asset_key": "dress"}
    cut = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND usename = 'test'"
    async with gateway(tmp_path / "gw", store, database_url=empty_postgres) as client:
        with operator(empty_postgres) as db:
            db.exec_driver_sql("ALTER DATABASE postgres SET default_transaction_read_only = on")
            try:
                db.exec_driver_sql(cut)  # what is open keeps its default
                refused = await client.post("/v1/jobs", json=order)
                assert refusal(refused) == (503, "DATABASE_READ_ONLY")
                assert await database_check(client) == (503, "it is read-only")
                assert (await client.get("/v1/jobs")).json()["jobs"] == [], "what is there can be read"
            finally:
                db.exec_driver_sql("ALTER DATABASE postgres RESET default_transaction_read_only")
                db.exec_driver_sql(cut)
        assert (await client.post("/v1/jobs", json=order)).status_code == 202


async def test_a_full_disk_is_named(empty_postgres: str, tmp_path: Path) -> None:
    """The server itself raises its error, with the code and the words of one whose disk is full."""
    store = memory()
    order = {"capture": capture(store), "asset_key": "dress"}
    full = (
        "CREATE FUNCTION full_disk() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN RAISE EXCEPTION USING "
        "ERRCODE = '53100', MESSAGE = 'erweitern fehlgeschlagen: kein Platz'; END $$"
    )
    async with (
        worker(Making(store), tmp_path / "edge") as port,
        gateway(tmp_path / "gw", store, port, database_url=empty_postgres) as client,
    ):
        with operator(empty_postgres) as db:
            db.exec_driver_sql(full)
            db.exec_driver_sql("CREATE TRIGGER full_disk BEFORE INSERT ON events EXECUTE FUNCTION full_disk()")
            assert refusal(await client.post("/v1/jobs", json=order)) == (507, "STORAGE_FULL")
            assert await database_check(client) == (503, "its disk is full")
            assert (await client.get("/v1/jobs")).json()["jobs"] == []
            db.exec_driver_sql("DROP TRIGGER full_disk ON events")
        done = await ended(client, await start(client, order["capture"]))
        assert (await client.get("/readyz")).status_code == 200
    assert done["state"] == "SUCCEEDED"
