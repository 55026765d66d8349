"""Fixtures that every part of the tests shares."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.s3.server import S3Server, available, running

_IN_CI = os.environ.get("CI") == "true"
_WITH_SERVERS = {"cli", "deploy", "gateway", "storage", "web"}  # folders whose tests start real ones

if "PYTEST_XDIST_WORKER" in os.environ:  # before anything loads torch
    os.environ["OMP_NUM_THREADS"] = "1"  # threads of two processes on two cores would spin against each other


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Side by side (`pytest -n 2 --dist loadgroup`) real servers stand in one process, and a file's tests in one."""
    for item in items:
        folder = item.path.relative_to(Path(__file__).parent).parts[0]
        item.add_marker(pytest.mark.xdist_group("servers" if folder in _WITH_SERVERS else item.path.name))


def missing(what: str) -> None:
    """Skip on a laptop, fail in CI: a test that silently never runs proves nothing."""
    if _IN_CI:
        pytest.fail(f"{what} is missing, and CI must have it")
    pytest.skip(f"{what} is missing")


def data_folder() -> Path:
    """Where the real test data lies: $CAPTURE2VR_DATA, or shared/data beside the checkout."""
    return Path(os.environ.get("CAPTURE2VR_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of the real test data."""
    folder = data_folder()
    if not folder.is_dir():
        missing(f"the test data ({folder})")
    return folder


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    """One real S3 server for the whole session."""
    if not available():
        missing("a RADOS Gateway (radosgw, ceph-mon, ceph-osd)")
    with running() as server:
        yield server
