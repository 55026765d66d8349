"""What the suite holds its tests to: marks by CPU time, and no test left out in silence."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.repository import ROOT

COSTLY = """
import time
import pytest

@pytest.fixture(scope="module")
def dear():
    burn()

def burn():
    end = time.process_time() + 0.4
    while time.process_time() < end:
        pass

def test_unmarked():
    burn()

@pytest.mark.slow
def test_marked():
    burn()

def test_behind_a_dear_fixture(dear):
    pass

def test_that_loads_libraries():
    for number in range(40):
        __import__(f"part_{number}")
    burn()

def test_idle():
    time.sleep(0.5)
"""
pytestmark = pytest.mark.slow

PLUGINS = ("-p", "tests.support.suite.cost_limit", "-p", "tests.support.suite.left_out", "-p", "no:cacheprovider")
LIMIT = "from tests.support.suite import cost_limit\ncost_limit.MARK_S = 0.2\n"


def _pytest(folder: Path, *arguments: str) -> list[str]:
    """Run pytest on the tests above; its lines."""
    (folder / "pytest.ini").write_text("[pytest]\nmarkers =\n    slow: slow\n")
    (folder / "conftest.py").write_text(LIMIT)
    (folder / "test_it.py").write_text(COSTLY)
    for number in range(40):
        (folder / f"part_{number}.py").write_text("")
    command = [sys.executable, "-m", "pytest", *PLUGINS, *arguments, folder]
    variables = {**os.environ, "COLUMNS": "300"}
    return subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True).stdout.splitlines()


@pytest.mark.parametrize("processes", ["0", "1"])
def test_a_costly_test_is_named_unless_it_is_marked_or_loads_a_library_first(tmp_path: Path, processes: str) -> None:
    said = _pytest(tmp_path, "-n", processes)
    assert "5 passed" in said[-1]
    named = sorted(line.split()[2:] for line in said if " s  " in line and "test_it.py::" in line)
    assert [(phase, name.partition("::")[2]) for phase, name in named] == [
        ("call", "test_unmarked"),
        ("setup", "test_behind_a_dear_fixture"),
    ]


@pytest.mark.parametrize("processes", ["0", "1"])
def test_what_was_left_out_stands_right_before_the_last_line(tmp_path: Path, processes: str) -> None:
    said = _pytest(tmp_path, "-m", "slow", "-n", processes)
    title, marks, folders, last = [line for line in said if line][-4:]
    assert "left to make test-all" in title
    assert marks.startswith("4 tests")
    assert folders.endswith(" 4")
    assert "1 passed" in last
