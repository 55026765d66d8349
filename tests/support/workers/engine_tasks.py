"""Tasks for the tests of engines."""

from __future__ import annotations

import hashlib
import os
import signal
import time
from pathlib import Path
from typing import Any

import capture2vr
from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import CaptureError

_MOST_S = 300.0  # of a task that waits for a file


class Unsendable(Exception):  # noqa: N818 - it reads as what it is
    """An exception that cannot be pickled."""

    def __init__(self) -> None:
        super().__init__("holds a function")
        self.held = lambda: None


class Unreadable:
    """A result that can be pickled, and not read again."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _refuse, ()


def _refuse() -> None:
    raise ImportError("there is no such thing here")


def double(tick: Tick, number: int) -> int:
    tick(0.5)
    return 2 * number


def digest(tick: Tick, data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def fail(tick: Tick, file: str) -> None:
    raise CaptureError("CAPTURE_EMPTY", "has nothing in it", file=file, retryable=True)


def fail_unsendable(tick: Tick) -> None:
    raise Unsendable


def unreadable(tick: Tick) -> Unreadable:
    return Unreadable()


def die(tick: Tick, begun: str) -> None:
    """Be killed, each time."""
    _note(begun)
    os.kill(os.getpid(), signal.SIGKILL)


def wait(tick: Tick, folder: str, number: int) -> int:
    """Note that it has begun, and wait until there is a file `go`; return the number."""
    _note(f"{folder}/begun-{number}")
    since = time.monotonic()
    while not Path(folder, "go").exists() and time.monotonic() - since < _MOST_S:
        tick(0.25)
        time.sleep(0.02)
    return number


def rest(tick: Tick, seconds: float) -> float:
    """Sleep, as a task does that works elsewhere; return when it ended."""
    time.sleep(seconds)
    return time.time()


def environment(tick: Tick, name: str) -> str:
    return os.environ.get(name, "")


def version(tick: Tick) -> str:
    return capture2vr.__version__


def _note(path: str) -> None:
    with Path(path).open("a") as file:
        file.write(f"{os.getpid()}\n")
