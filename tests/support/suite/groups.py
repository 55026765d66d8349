"""Which tests run in one process: those of a file, or of files that share what takes long to start."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePath
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

# What costs seconds to start is started once: Chromium and the whole product, the S3 server, the SBOM. The pages
# are three groups, because all together they would take longer than the other tests beside them.
_TOGETHER = {
    "web/capture": "capture pages",
    "web/viewer": "viewer pages",
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


def group_of(file: str) -> str:
    """The group of a test file (`tests/…`): one of `_TOGETHER`, or the file itself."""
    path = PurePath(file).relative_to("tests")
    groups = (_TOGETHER.get(each.as_posix()) for each in (path, *path.parents))
    return next((group for group in groups if group), path.as_posix())


class _Together(LoadFileScheduling):
    """Side by side (`pytest -n 2`) a group's tests share a process.

    Every server listens on a free port and keeps its files in a folder of its own, so that any two may stand together.
    """

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid.partition("::")[0])


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> _Together:
    """Not xdist_group's marks: xdist 3.8 hands them on in node ids, which pytest 9.2 no longer lets it change."""
    config.option.loadscopereorder = False
    return _Together(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the groups that take longest: the short ones at the end keep all processes busy until then."""
    weights = Counter[str]()
    for item in items:
        is_long = any(mark.name in _LONG_MARKS for mark in item.iter_markers())
        weights[_group(item)] += _LONG if is_long else 1
    items.sort(key=lambda item: (-weights[_group(item)], _group(item)))


def _group(item: pytest.Item) -> str:
    return group_of(item.nodeid.partition("::")[0])
