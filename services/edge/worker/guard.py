"""Run the worker in a child process of a container's first process, and start it again when it runs out of memory.

The kernel kills whoever takes most of a container's memory, with SIGKILL and without a word. The parent, which takes
next to none, survives, and reads in the control group's counters why its child is gone.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress

from capture2vr.edge.worker.control_group import ControlGroup
from capture2vr.process.parent_death import end_with_parent

_log = logging.getLogger(__name__)

_PAUSE_S = 1.0  # before a worker that ran out of memory starts again
_SIGNALS = (signal.SIGTERM, signal.SIGINT)

Serve = Callable[[bool], int]
"""Runs the worker and returns its exit status. The argument says whether the one before it ran out of memory."""


def is_container_start() -> bool:
    """Whether this is the first process of a container, which nobody else watches from within."""
    return sys.platform == "linux" and os.getpid() == 1


def run_guarded(serve: Serve, group: ControlGroup) -> int:
    """Run `serve` in a child process, again whenever the kernel has killed it for want of memory; return its status.

    SIGTERM and SIGINT are passed on. A child that a signal has killed otherwise gives 128 + signal, as in a shell.
    """
    out_of_memory = False
    while True:
        kills = group.oom_kills
        status = _run(serve, out_of_memory=out_of_memory)
        if status != -signal.SIGKILL or group.oom_kills <= kills:
            return status if status >= 0 else 128 - status
        out_of_memory = True
        _log.error(
            "the kernel killed the worker: its jobs wanted more memory than the %s bytes of this container. They are "
            "tried again. Raise the container's limit (LIMIT_EDGE_MEMORY), or lower EDGE_MEMORY or EDGE_SLOTS",
            f"{group.limit_bytes:,}" if group.limit_bytes else "free",
        )
        time.sleep(_PAUSE_S)


def _run(serve: Serve, *, out_of_memory: bool) -> int:
    """Fork, run `serve` in the child, and return its exit status, negative for the signal that ended it."""
    # Until the handlers know the child, signals wait.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        end_with_parent(parent)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        _serve_and_exit(serve, out_of_memory)

    def pass_on(number: int, _: object) -> None:
        with suppress(ProcessLookupError):  # it has just ended
            os.kill(child, number)

    former = [signal.signal(number, pass_on) for number in _SIGNALS]
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        return _wait_for(child)
    finally:
        for number, handler in zip(_SIGNALS, former, strict=True):
            signal.signal(number, handler)


def _wait_for(child: int) -> int:
    """Wait for the child's end. Orphans, which a container's first process inherits, are reaped meanwhile."""
    while True:
        ended, status = os.waitpid(-1 if is_container_start() else child, 0)
        if ended == child:
            return os.waitstatus_to_exitcode(status)


def _serve_and_exit(serve: Serve, out_of_memory: bool) -> None:
    """Run `serve` and end this process, whatever happens, without returning into the parent's code."""
    status = 1
    try:
        status = serve(out_of_memory)
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 1
    except BaseException:  # noqa: BLE001 - nothing may return into the parent's code
        _log.exception("the worker ended with an error")
    finally:
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
