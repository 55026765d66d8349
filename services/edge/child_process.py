"""Run a program in a child process and kill it on a timeout or when the job is cancelled: for native code that cannot
be interrupted from Python. The children that are our own set themselves up here too."""

from __future__ import annotations

import json
import os
import resource
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO

from capture2vr.edge.arrays import Tick
from capture2vr.process.child_start import start_child
from capture2vr.process.parent_death import end_with_parent
from capture2vr.sentences.sentence import say

_POLL_SECONDS = 0.1  # between two ticks: the longest time that a cancelled job still runs
_LOG_LINES = 3  # the last lines of the program's output that are quoted in an error
_HALF_WAY_SECONDS = 5.0  # after which the progress of a program that reports none is shown as one half

ReportFraction = Callable[[float], None]
"""Function with which a child reports the fraction done."""


class ChildError(Exception):
    """The program failed or took too long (`too_slow`). The message begins with the program's name and says why."""

    def __init__(self, message: str, *, too_slow: bool = False) -> None:
        super().__init__(message)
        self.too_slow = too_slow


def run_child(
    command: Sequence[str | Path],
    name: str,
    log: Path,
    tick: Tick,
    *,
    most_seconds: float,
    tells_progress: bool = False,
) -> None:
    """Run a program to its end, in a process group of its own; its output goes to the file `log`.

    name            the program's name in error messages
    most_seconds    longest run time; with `tells_progress`, longest time between two lines of progress
    tells_progress  whether it prints lines of JSON, {"fraction": 0.5}, to standard output, which are passed to `tick`

    Raises ChildError where the program fails or takes too long, OSError where no process can be started, and within a
    fraction of a second what `tick` raises. In each case the whole process group is killed.
    """
    with log.open("wb") as errors:
        output = subprocess.PIPE if tells_progress else errors
        with start_child(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=errors, bufsize=0, start_new_session=True
        ) as child:
            try:
                deadline = _Deadline(name, most_seconds, silent=tells_progress)
                code = (_follow if tells_progress else _wait)(child, tick, deadline)
            finally:
                if child.poll() is None:
                    os.killpg(child.pid, signal.SIGKILL)
    if code != 0:
        last = " | ".join(log.read_text(errors="replace").strip().splitlines()[-_LOG_LINES:])
        raise ChildError(f"{name} ended with status {code}: {last or 'no output'}")


class _Deadline:
    """A program's time limit; `restart` begins it anew."""

    def __init__(self, name: str, most_seconds: float, *, silent: bool) -> None:
        self._name, self._most_seconds, self._silent = name, most_seconds, silent
        self.restart()

    def restart(self) -> None:
        self._since = time.monotonic()

    def elapsed(self) -> float:
        """Seconds since the start or the last restart. Raises ChildError where they are more than the limit."""
        elapsed = time.monotonic() - self._since
        if elapsed > self._most_seconds:
            code = "reported_no_progress" if self._silent else "took_more_than"
            raise ChildError(say(code, name=self._name, seconds=self._most_seconds), too_slow=True)
        return elapsed


def _wait(child: subprocess.Popen[bytes], tick: Tick, deadline: _Deadline) -> int:
    """Wait for the program's end; return its exit status. Its progress is unknown: the fraction creeps towards 1."""
    while True:
        elapsed = deadline.elapsed()
        tick(elapsed / (elapsed + _HALF_WAY_SECONDS))
        try:
            return child.wait(_POLL_SECONDS)
        except subprocess.TimeoutExpired:
            continue


def _follow(child: subprocess.Popen[bytes], tick: Tick, deadline: _Deadline) -> int:
    """Pass the program's progress to `tick` until it closes its output; return its exit status."""
    assert child.stdout is not None
    fraction = 0.0
    with selectors.DefaultSelector() as selector:
        selector.register(child.stdout, selectors.EVENT_READ)
        while True:
            if selector.select(_POLL_SECONDS):
                line = child.stdout.readline()
                if not line:
                    break
                fraction = float(json.loads(line)["fraction"])
                deadline.restart()
            deadline.elapsed()
            tick(fraction)
    return _wait(child, lambda _: tick(fraction), deadline)


def set_up_child() -> ReportFraction:
    """Set up this process as a child: it dies with its parent, writes no core dump, and stdout has only its progress.

    Returns the function that reports progress to a parent that called `run_child` with `tells_progress`."""
    output = die_with_parent()
    return lambda fraction: _write_fraction(output.fileno(), fraction)


def die_with_parent() -> BinaryIO:
    """Make this process exit when its parent dies and write no core dump; return what was its standard output.

    What is printed from now on goes to standard error.
    """
    end_with_parent()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return output


def _write_fraction(output: int, fraction: float) -> None:
    os.write(output, json.dumps({"fraction": round(fraction, 4)}).encode() + b"\n")
