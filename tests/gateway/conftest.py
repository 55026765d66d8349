"""Databases of both kinds: what a test says of `url` holds for SQLite and for Postgres. A clock for rate limits."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import sqlalchemy as sa

from tests.conftest import missing
from tests.referees.postgres import programs, running


@pytest.fixture(scope="session")
def postgres_programs() -> Path:
    """The folder of Postgres' programs; the test is skipped where there is none."""
    found = programs()
    if found is None:
        missing("a Postgres server")
    assert found is not None
    return found


@pytest.fixture(scope="session")
def postgres(postgres_programs: Path) -> Iterator[str]:
    """The URL of a real Postgres."""
    with running(postgres_programs) as url:
        yield url


@pytest.fixture
def empty_postgres(postgres: str) -> str:
    """An empty database of Postgres."""
    engine = sa.create_engine(postgres)
    with engine.begin() as db:
        db.exec_driver_sql("DROP SCHEMA public CASCADE")
        db.exec_driver_sql("CREATE SCHEMA public")
    engine.dispose()
    return postgres


@pytest.fixture(params=["sqlite", "postgres"])
def url(tmp_path: Path, request: pytest.FixtureRequest) -> str:
    """An empty database of each kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'jobs.db'}"
    found: str = request.getfixturevalue("empty_postgres")
    return found


@pytest.fixture
def still_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop the clock by which requests are counted, a second after a minute has begun.

    Requests are counted by minutes of the clock: a test that runs over the end of one finds some of them gone.
    """
    now = time.time() // 60 * 60 + 1
    for module in ("limits.strategies", "limits.storage.memory"):
        monkeypatch.setattr(f"{module}.time", SimpleNamespace(time=lambda: now))
