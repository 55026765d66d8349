"""A gateway that starts on a database which it must migrate, or cannot work with, says so and lives."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa

from capture2vr.cli.up import free_port
from capture2vr.gateway.database.database import open_engine
from tests.support.patience import HANG_S, PATIENCE_S
from tests.support.repository import ROOT
from tests.support.service_processes import ServiceProcess, killed_at_the_end

pytestmark = pytest.mark.slow


class Starting:
    """A gateway that starts on a database."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.log, port = folder, folder / "gateway.log", free_port()
        self.url = f"http://127.0.0.1:{port}"
        self.environment = {"GATEWAY_DATA_DIR": str(folder), "STORAGE_ROOT": str(folder / "objects")}
        self.process = ServiceProcess("capture2vr.gateway", self.log, GATEWAY_PORT=str(port), **self.environment)

    def status(self, path: str) -> int:
        """Status of an answer; 0 where there is none."""
        try:
            return httpx.get(self.url + path, timeout=PATIENCE_S).status_code
        except httpx.TransportError:
            return 0

    def wait(self, holds: Callable[[], bool]) -> None:
        deadline = time.monotonic() + HANG_S
        while not holds():
            assert time.monotonic() < deadline, self.log.read_text()[-2000:]
            time.sleep(0.05)

    def lines(self, text: str) -> list[str]:
        """Messages of the log that have this text."""
        messages = [json.loads(line)["message"] for line in self.log.read_text().splitlines()]
        return [each for each in messages if text in each]


@pytest.fixture
def database(tmp_path: Path) -> Iterator[sa.Engine]:
    url = f"sqlite:///{tmp_path / 'gateway.db'}"
    open_engine(url).dispose()
    engine = sa.create_engine(url)
    yield engine
    engine.dispose()


def stamp(database: sa.Engine, revision: str, least: int) -> None:
    with database.begin() as db:
        values = {"revision": revision, "least": least}
        db.execute(sa.text("UPDATE alembic_version SET version_num = :revision, least_readable = :least"), values)


def test_an_older_gateway_waits_for_a_database_that_it_works_with(database: sa.Engine, tmp_path: Path) -> None:
    """It does not end: an orchestrator would start it again and again. It is told once why."""
    with database.begin() as db:
        (known,) = db.exec_driver_sql("SELECT version_num FROM alembic_version").scalars()
    stamp(database, "9999_later", 9999)
    gateway = Starting(tmp_path)
    with killed_at_the_end(gateway.process):
        gateway.wait(lambda: gateway.status("/livez") == 200)
        gateway.wait(lambda: bool(gateway.lines("waiting")))
        answer = httpx.get(gateway.url + "/readyz", timeout=PATIENCE_S)
        assert (answer.status_code, answer.json()["code"], answer.headers["Retry-After"]) == (503, "SCHEMA_NEWER", "10")
        assert httpx.post(gateway.url + "/v1/captures", timeout=PATIENCE_S).status_code == 503
        refused = subprocess.run(
            [sys.executable, "-m", "capture2vr.cli", "gateway", "migrate"],
            env={**os.environ, **gateway.environment},
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
        assert (refused.returncode, "install that version, or restore the backup" in refused.stderr) == (2, True)
        stamp(database, known, 10)  # as a restored backup
        gateway.wait(lambda: gateway.status("/readyz?exclude=workers") == 200)
    (line,) = gateway.lines("waiting")
    assert "newer gateway (schema 9999_later, which works with 9999 and above)" in line


def test_a_gateway_that_waits_ends_when_it_is_asked_to(database: sa.Engine, tmp_path: Path) -> None:
    stamp(database, "9999_later", 9999)
    gateway = Starting(tmp_path)
    with killed_at_the_end(gateway.process):
        gateway.wait(lambda: gateway.status("/livez") == 200)
        gateway.process.end(signal.SIGTERM)
        assert gateway.process.wait() == 0


def test_a_gateway_that_migrates_for_long_lives(database: sa.Engine, tmp_path: Path) -> None:
    """As long as others have what it wants: here somebody else writes."""
    stamp_back = (
        *(f"DROP TRIGGER jobs_{event}" for event in ("added", "deleted", "changed", "ended")),
        *(f"DROP TABLE {table}" for table in ("job_counts", "ended_jobs", "backups")),
        "UPDATE alembic_version SET version_num = '0011_least_readable'",
    )
    with database.begin() as db:
        for statement in stamp_back:
            db.exec_driver_sql(statement)
    with database.connect() as db:
        db.exec_driver_sql("PRAGMA journal_mode=WAL")
        db.rollback()
        db.exec_driver_sql("UPDATE tenants SET label = 'x'")  # holds SQLite's lock until the end
        gateway = Starting(tmp_path)
        with killed_at_the_end(gateway.process):
            gateway.wait(lambda: gateway.status("/livez") == 200)
            answer = httpx.get(gateway.url + "/readyz", timeout=PATIENCE_S)
            assert (answer.status_code, answer.json()["code"]) == (503, "GATEWAY_STARTING")
            db.commit()
            gateway.wait(lambda: gateway.status("/readyz?exclude=workers") == 200)
