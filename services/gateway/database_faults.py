"""Why the jobs database refuses work: full, read-only or unusable."""

from __future__ import annotations

from enum import StrEnum

from sqlalchemy.exc import DBAPIError, SQLAlchemyError


class Fault(StrEnum):
    """Why the database refuses work; the value is for people."""

    FULL = "its disk is full"
    READ_ONLY = "it is read-only"
    UNUSABLE = "it is busy, or cannot be reached or used"


def fault_of(error: SQLAlchemyError) -> Fault:
    """Return what a failed call says of the database, by Postgres' SQLSTATE or SQLite's words."""
    cause = error.orig if isinstance(error, DBAPIError) else error
    code, text = getattr(cause, "sqlstate", None), str(cause).lower()
    # SQLite calls it an I/O error where the index of its write-ahead log has no space.
    no_index = getattr(cause, "sqlite_errorname", "") == "SQLITE_IOERR_SHMSIZE"
    if no_index or code == "53100" or "is full" in text or "no space" in text:
        return Fault.FULL
    if code == "25006" or "readonly database" in text:
        return Fault.READ_ONLY
    return Fault.UNUSABLE
