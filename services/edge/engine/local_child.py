"""Child process of `LocalEngine` that runs one task: `python -m capture2vr.edge.engine.local_child`.

It reads (work, inputs), pickled, from standard input, and writes pickled pairs to standard output: ("fraction", float),
then ("result", value) or ("error", exception). What the task prints goes to standard error.
"""

from __future__ import annotations

import pickle
import sys
import time
from typing import Any, BinaryIO

from capture2vr.edge.child_process import die_with_parent
from capture2vr.edge.errors import EdgeError

_EVERY_S = 0.1  # between two reports of progress


def run_task(output: BinaryIO) -> None:
    """Run the task of standard input."""
    last = 0.0

    def tick(fraction: float) -> None:
        nonlocal last
        if (now := time.monotonic()) - last > _EVERY_S:
            last = now
            _say(output, "fraction", fraction)

    try:
        work, inputs = pickle.load(sys.stdin.buffer)  # noqa: S301 - of our parent
        answer = ("result", work(tick, *inputs))
    except Exception as error:  # noqa: BLE001 - it is raised where the result is waited for
        answer = ("error", sendable(error))
    _say(output, *answer)


def sendable(error: Exception) -> Exception:
    """Return the error, or where it cannot be pickled and read again, an EdgeError that says the same."""
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301 - our own bytes
    except Exception:  # noqa: BLE001 - an error of others may refuse in any way
        return EdgeError("TASK_FAILED", f"{type(error).__name__}: {error}")
    return error


def _say(output: BinaryIO, kind: str, value: Any) -> None:
    pickle.dump((kind, value), output, pickle.HIGHEST_PROTOCOL)
    output.flush()


if __name__ == "__main__":
    run_task(die_with_parent())
