"""Finds tests that take seconds of CPU time and have no mark that says so: marks decide what `make test` runs."""

from __future__ import annotations

import resource
import sys
from collections.abc import Generator

import pytest

COSTLY = {"browser", "compose", "docker", "gpu", "s3", "slow"}
"""Marks of tests that may take more than a second."""

MARK_S, LIMIT_S = 1.0, 10.0
"""CPU seconds of a test's own code and of the children that it waited for, from which it is named at the run's end, and
from which it fails. On a crowded machine, whose caches others use, the same test takes up to twice as much."""

# Modules. The first test that loads PyTorch or SciPy pays for all tests of its process, and is not judged.
_IMPORTED = 30

_UNMARKED = "cpu_s_without_a_mark"


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
    if cost <= MARK_S or len(sys.modules) - loaded >= _IMPORTED or any(map(item.get_closest_marker, COSTLY)):
        return
    item.user_properties.append((_UNMARKED, round(cost, 1)))
    if cost > LIMIT_S:
        pytest.fail(f"took {cost:.1f} s of CPU time: make it cheaper, or mark it slow", pytrace=False)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the tests that should be cheaper or marked, the costliest first."""
    passed = (
        dict(report.user_properties) | {"name": report.nodeid} for report in terminalreporter.getreports("passed")
    )
    found = sorted(((each[_UNMARKED], each["name"]) for each in passed if _UNMARKED in each), reverse=True)
    if found:
        terminalreporter.section("over a second of CPU time, and no mark that says so")
        for seconds, name in found:
            terminalreporter.line(f"{seconds:5.1f} s  {name}")
