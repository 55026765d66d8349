"""A program of its own is watched: it ends with its work, when it takes too long, or when nobody wants it any more."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.errors import Cancelled
from tests.support.command_lines import children_running
from tests.support.patience import CANCEL_S

STUBBORN = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"
PARENT = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {STUBBORN!r}])"
TELLING = """
import json, time
for part in range(4):
    print(json.dumps({"fraction": part / 3}), flush=True)
    time.sleep(0.15)
"""
CLOSED = "import os, time; os.close(1); time.sleep(600)"


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_a_program_that_ends_well_is_waited_for(tmp_path: Path) -> None:
    made = tmp_path / "made"
    code = f"open({str(made)!r}, 'w').write('done')"
    run_child(python(code), "it", tmp_path / "log", no_tick, most_seconds=60)
    assert made.read_text() == "done"


def test_the_progress_it_tells_is_heard(tmp_path: Path) -> None:
    heard: list[float] = []
    run_child(python(TELLING), "it", tmp_path / "log", heard.append, most_seconds=60, tells_progress=True)
    assert heard == sorted(heard)
    assert {0.0, 1.0} < set(heard)


def test_the_bar_of_a_silent_program_creeps_on_and_stays_below_its_end(tmp_path: Path) -> None:
    heard: list[float] = []
    run_child(python("import time; time.sleep(0.5)"), "it", tmp_path / "log", heard.append, most_seconds=60)
    assert heard == sorted(set(heard))
    assert heard[-1] < 1


def test_its_last_words_are_in_the_error(tmp_path: Path) -> None:
    with pytest.raises(ChildError, match=r"it ended with status 1: .*ValueError: seven") as caught:
        run_child(python("raise ValueError('seven')"), "it", tmp_path / "log", no_tick, most_seconds=60)
    assert not caught.value.too_slow


@pytest.mark.parametrize("code", [STUBBORN, PARENT, CLOSED])
@pytest.mark.parametrize("tells_progress", [False, True])
def test_a_cancel_ends_it_and_what_it_started(tmp_path: Path, code: str, tells_progress: bool) -> None:
    raised: list[float] = []

    def cancel(_: float) -> None:
        if children_running("time.sleep(600)"):
            raised.append(time.monotonic())
            raise Cancelled

    with pytest.raises(Cancelled):
        run_child(python(code), "it", tmp_path / "log", cancel, most_seconds=60, tells_progress=tells_progress)
    assert time.monotonic() - raised[0] < CANCEL_S
    assert children_running("time.sleep(600)") == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "tells_progress", "says"),
    [
        (STUBBORN, False, "took more than"),
        (STUBBORN, True, "reported no progress for"),
        (CLOSED, True, "reported no progress for"),
    ],
)
def test_one_that_takes_too_long_is_ended(tmp_path: Path, code: str, tells_progress: bool, says: str) -> None:
    with pytest.raises(ChildError, match=f"it {says} 1 s") as caught:
        run_child(python(code), "it", tmp_path / "log", no_tick, most_seconds=1, tells_progress=tells_progress)
    assert caught.value.too_slow
    assert children_running("time.sleep(600)") == []


def test_a_program_that_is_not_there_is_an_oserror(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        run_child(["/no/such/program"], "it", tmp_path / "log", no_tick, most_seconds=1)
