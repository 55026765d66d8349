"""A place to try a restore: a database and a store that are empty at first, and gone at the end.

They are of the kind that the service has: a schema of its own on the same Postgres, a prefix of the same bucket; else a
file and a folder. What a trial left that was killed, the next one removes: their names are always the same.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import sqlalchemy as sa

from capture2vr.gateway.database.database import create_engine
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store, list_all
from capture2vr.storage.tenant_store import PrefixStore

_SCHEMA = "capture2vr_drill"
_PREFIX = "uploads/drill/"  # what lies below uploads/ is in no backup
_LOCK = 0x63327673  # Postgres: key of the lock that one trial holds; any number, only ours


class TrialUnderWay(Exception):  # noqa: N818 - it reads as what it is
    """Another trial uses the same database server."""


@contextmanager
def trial_database(url: str, folder: Path) -> Iterator[str]:
    """Yield the URL of an empty database, which goes at the end.

    url     of the service's database; folder: an empty one, for a database that is a file
    Raises TrialUnderWay, sqlalchemy.exc.SQLAlchemyError.
    """
    engine = create_engine(url)
    try:
        if engine.dialect.name != "postgresql":
            yield f"sqlite:///{(folder / 'gateway.db').absolute()}"
            return
        with engine.execution_options(isolation_level="AUTOCOMMIT").connect() as db:
            if not db.execute(sa.text("SELECT pg_try_advisory_lock(:key)"), {"key": _LOCK}).scalar_one():
                raise TrialUnderWay("another drill restores to the same database server: wait until it has ended")
            drop = sa.text(f"DROP SCHEMA IF EXISTS {_SCHEMA} CASCADE")
            db.execute(drop)
            db.execute(sa.text(f"CREATE SCHEMA {_SCHEMA}"))
            try:
                own = sa.make_url(url).update_query_dict({"options": f"-csearch_path={_SCHEMA}"})
                yield own.render_as_string(hide_password=False)
            finally:
                db.execute(drop)
    finally:
        engine.dispose()


@contextmanager
def trial_store(store: Store, folder: Path) -> Iterator[Store]:
    """Yield an empty store, which goes at the end. folder: an empty one, for a store that is one. Raises OSError."""
    if isinstance(store, LocalStore):
        yield LocalStore(folder / "store")
        return
    _empty(store)
    try:
        yield PrefixStore(store, _PREFIX)
    finally:
        _empty(store)


@contextmanager
def trial_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder, which goes at the end."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(mode=0o700, parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder)


def _empty(store: Store) -> None:
    for head in list(list_all(store, _PREFIX)):
        store.delete(head.name)
