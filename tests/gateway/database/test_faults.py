"""What the gateway says when its database is locked or full, and when a disk is: never an internal error."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

from capture2vr.gateway.database import database
from capture2vr.gateway.vitals import checks
from tests.support.in_process_gateway import Making, capture, ended, gateway, memory, start, worker


@contextmanager
def locked(database: Path) -> Iterator[None]:
    with closing(sqlite3.connect(database, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.execute("ROLLBACK")


class Disk:
    """How many pages the databases of this process may have."""

    pages = 1 << 30

    def limit(self, db: Connection) -> None:
        db.exec_driver_sql(f"PRAGMA max_page_count={self.pages}")


@pytest.fixture
def disk() -> Iterator[Disk]:
    """With `pages` of 1 no database grows any more, which SQLite reports as a full disk."""
    made = Disk()
    sa.event.listen(Engine, "begin", made.limit)
    yield made
    sa.event.remove(Engine, "begin", made.limit)


async def test_a_locked_database_is_a_wait_and_not_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database, "_BUSY_MS", 200)
    monkeypatch.setattr(database, "_CHECK_MS", 100)
    store = memory()
    order = {"capture": capture(store), "asset_key": "dress"}
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        with locked(tmp_path / "gw" / "gateway.db"):
            refused = await client.post("/v1/jobs", json=order)
            ready = await client.get("/readyz")
        assert (refused.status_code, refused.json()["code"]) == (503, "DATABASE_UNAVAILABLE")
        assert int(refused.headers["retry-after"]) > 0
        assert refused.json()["retryable"]
        assert (ready.status_code, ready.json()["checks"]["database"]["ok"]) == (503, False)
        assert (await client.get("/readyz")).status_code == 200
        assert (await client.get("/v1/jobs")).json()["jobs"] == [], "nothing was half done"
        assert (await ended(client, await start(client, order["capture"])))["state"] == "SUCCEEDED"


@pytest.mark.slow
async def test_a_full_database_is_named(tmp_path: Path, disk: Disk) -> None:
    store = memory()
    order = {"capture": capture(store), "asset_key": "dress", "label": "x" * 200}
    async with gateway(tmp_path / "gw", store) as client:
        disk.pages = 1
        answers = [await client.post("/v1/jobs", json=order) for _ in range(100)]
        last = answers[-1]
        assert (last.status_code, last.json()["code"]) == (507, "STORAGE_FULL")
        assert int(last.headers["retry-after"]) > 0
        kept = [answer.json()["id"] for answer in answers if answer.status_code == 202]
        assert len(kept) < len(answers)
        assert {each["id"] for each in (await client.get("/v1/jobs?limit=200")).json()["jobs"]} == set(kept)
        disk.pages = 1 << 30
        assert (await client.post("/v1/jobs", json=order)).status_code == 202


async def test_a_gateway_without_space_is_not_ready(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        assert (await client.get("/readyz")).json()["checks"]["disk"]["ok"]
        monkeypatch.setattr(checks, "_LEAST_FREE", 1 << 60)
        answer = await client.get("/readyz")
    assert answer.status_code == 503
    assert [name for name, check in answer.json()["checks"].items() if not check["ok"]] == ["disk"]


@pytest.mark.parametrize("letter", ["\0", "\r\n", "\x1b[2J", "\u202e", "\u2028", "\x7f"])
async def test_a_name_is_one_line(letter: str, tmp_path: Path) -> None:
    store = memory()
    order = {"capture": capture(store), "asset_key": "dress"}
    async with gateway(tmp_path / "gw", store) as client:
        job = await client.post("/v1/jobs", json={**order, "label": f"a{letter}b"})
        files = {"files": ("a.xyz", b"0 0 0\n1 1 1\n")}
        upload = await client.post("/v1/captures", data={"name": f"a{letter}b"}, files=files)
        assert (job.status_code, job.json()["code"]) == (422, "REQUEST_INVALID")
        assert (upload.status_code, upload.json()["code"]) == (422, "NAME_INVALID")
        fine = await client.post("/v1/jobs", json={**order, "label": "Ada’s 👩‍👩‍👧 שמלה"})
        assert fine.status_code == 202
