"""Every store under one name: what a test says of `store` holds for all of them."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.s3 import S3Store
from capture2vr.storage.store import Store, list_all
from capture2vr.storage.tenant_store import store_of_tenant
from tests.referees.s3.server import S3Server


@pytest.fixture(scope="session")
def shared_bucket(s3_server: S3Server) -> S3Store:
    """One bucket for all tests of the contract: to make one takes longer than to empty it.

    What was a folder stays one on SeaweedFS, where no later test can claim the name for an object (`if_absent`).
    """
    return s3_store(s3_server)


@pytest.fixture(params=["memory", "local", "tenant", pytest.param("s3", marks=[pytest.mark.s3, pytest.mark.essential])])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    """An empty store of each kind."""
    if request.param == "s3":
        bucket: S3Store = request.getfixturevalue("shared_bucket")
        yield bucket
        for head in list_all(bucket, ""):
            bucket.delete(head.name)
    else:
        yield near_store(request.param, tmp_path)


def near_store(kind: str, folder: Path) -> Store:
    """A store that answers within a millisecond, for tests of what is the same for all."""
    if kind == "memory":
        return MemoryStore()
    local = LocalStore(folder / "objects", "http://gateway/v1/files")
    return store_of_tenant(local, "ada") if kind == "tenant" else local


def s3_store(server: S3Server, bucket: str = "") -> S3Store:
    """A store on a bucket of its own."""
    store = S3Store(
        bucket=bucket or f"test-{uuid.uuid4().hex[:12]}",
        access_key=server.access_key,
        secret_key=server.secret_key,
        endpoint=server.endpoint,
    )
    store.create_bucket()
    return store
