"""Says right before pytest's last line what a run with `-m` left out: tests of each mark and in each folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Sequence
from pathlib import PurePath
from typing import Any

import pytest

from tests.support.suite.cost_limit import COSTLY

_LEFT = pytest.StashKey[dict[str, dict[str, int]]]()


def pytest_deselected(items: Sequence[pytest.Item]) -> None:
    """Count them, in the process that collects: each of xdist's workers does, and all count the same."""
    marks, folders = Counter[str](), Counter[str]()
    for item in items:
        if item.get_closest_marker("compose"):  # left to make test-compose
            continue
        marks.update({mark.name for mark in item.iter_markers()} & COSTLY)
        folders["/".join(PurePath(item.nodeid.partition("::")[0]).parent.parts[:3])] += 1
    if folders:
        items[0].config.stash[_LEFT] = {"marks": dict(marks), "folders": dict(folders)}


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand the counts of a worker to the process that prints."""
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["left_out"] = session.config.stash.get(_LEFT, {})


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take the counts of a worker."""
    if left := getattr(node, "workeroutput", {}).get("left_out"):
        node.config.stash[_LEFT] = left


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> Generator[None]:
    """Print the counts behind all that pytest says but its last line."""
    yield
    left = config.stash.get(_LEFT, {})
    if not left or not config.option.markexpr:
        return
    total = sum(left["folders"].values())
    terminalreporter.section("left to make test-all")
    terminalreporter.line(f"{total:,} tests, by their marks: {_listed(left['marks'])}")
    terminalreporter.line(f"by their folders: {_listed(left['folders'])}")


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(
        f"{name} {count:,}" for name, count in sorted(counts.items(), key=lambda each: (-each[1], each[0]))
    )
