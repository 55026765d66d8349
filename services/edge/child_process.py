"""A program of its own beside ours, for work that nothing can interrupt: it is watched, and killed when it takes too
long or is no longer wanted."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from services.edge.arrays import Tick

_POLL_SECONDS = 0.1


class ChildError(Exception):
    """It did not do its work, and why: a sentence that begins with its name."""


def run_child(command: Sequence[str | Path], name: str, log: Path, tick: Tick, most_seconds: float) -> None:
    """The program from start to end; what it says goes to the file `log`.

    Raises ChildError where it fails or takes more than `most_seconds`, OSError where no process is to be had, and what
    `tick` raises. In each case nothing of it runs on.
    """
    with (
        log.open("wb") as said,
        subprocess.Popen(  # noqa: S603 - our own programs
            command, stdin=subprocess.DEVNULL, stdout=said, stderr=said, start_new_session=True
        ) as child,
    ):
        try:
            code = _ended(child, name, tick, most_seconds)
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)
    if code != 0:
        last = log.read_text(errors="replace").strip().splitlines()[-1:]
        raise ChildError(f"{name} ended with status {code}" + "".join(f": {line}" for line in last))


def _ended(child: subprocess.Popen[bytes], name: str, tick: Tick, most_seconds: float) -> int:
    """The child's status; nothing tells how far it is, so the bar creeps on."""
    began = time.monotonic()
    while (spent := time.monotonic() - began) < most_seconds:
        tick(spent / (spent + 5))
        try:
            return child.wait(_POLL_SECONDS)
        except subprocess.TimeoutExpired:
            continue
    raise ChildError(f"{name} took more than {most_seconds:.0f} s")
