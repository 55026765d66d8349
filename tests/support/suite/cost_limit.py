"""Finds tests that take seconds of CPU time and have no mark that says so: marks decide what `make test` runs."""

from __future__ import annotations

import resource
import sys
from collections.abc import Generator

import pytest

COSTLY = {"browser", "compose", "docker", "gpu", "s3", "slow"}
"""Marks of tests that may take more than a second."""

MARK_S = 1.0
"""CPU seconds of a test's own code and of the children that it waited for, from which it is named at the run's end. It
never fails: on a crowded machine, whose caches others use, the same test takes up to five times as much."""

# Modules. The first test that loads PyTorch or SciPy pays for all tests of its process, and is not judged.
_IMPORTED = 30

_NAMED = "cpu_s_without_a_mark"


def _cpu_s() -> float:
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """Measure the fixtures that the test is the first to need."""
    yield from _measured(item, "setup")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """Measure the test itself."""
    yield from _measured(item, "call")


def _measured(item: pytest.Item, phase: str) -> Generator[None]:
    began, loaded = _cpu_s(), len(sys.modules)
    yield
    cost = _cpu_s() - began
    item.user_properties.append((f"{phase}_cpu_s", round(cost, 3)))
    if cost > MARK_S and len(sys.modules) - loaded < _IMPORTED and not any(map(item.get_closest_marker, COSTLY)):
        item.user_properties.append((_NAMED, [round(cost, 1), phase]))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the tests that should be cheaper or marked, the costliest first."""
    named = (
        (*value, report.nodeid)
        for report in terminalreporter.getreports("passed")
        for name, value in report.user_properties
        if name == _NAMED and report.when == "call"
    )
    found = sorted(named, reverse=True)
    if found:
        terminalreporter.section("over a second of CPU time, and no mark that says so")
        for seconds, phase, name in found:
            terminalreporter.line(f"{seconds:5.1f} s  {phase:5}  {name}")
