"""Fails a test that takes seconds of CPU time and has no mark that says so: marks decide what `make test` runs."""

from __future__ import annotations

import resource
import sys
from collections.abc import Generator

import pytest

COSTLY = {"browser", "compose", "docker", "gpu", "s3", "slow"}
"""Marks of tests that may take more than a second."""

LIMIT_S = 2.5
"""CPU seconds of a test's own code and of the children that it waited for. Marks are set from 1 s on; on a crowded
machine, whose caches others use, the same test takes up to twice as much."""

# Modules. The first test that loads PyTorch or SciPy pays for all tests of its process, and is not judged.
_IMPORTED = 30


def _cpu_s() -> float:
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """Measure the test alone, without its fixtures, which others may share."""
    began, loaded = _cpu_s(), len(sys.modules)
    yield
    cost = _cpu_s() - began
    item.user_properties.append(("cpu_s", round(cost, 3)))
    if cost > LIMIT_S and len(sys.modules) - loaded < _IMPORTED and not any(map(item.get_closest_marker, COSTLY)):
        pytest.fail(f"took {cost:.1f} s of CPU time: make it cheaper, or mark it slow", pytrace=False)
