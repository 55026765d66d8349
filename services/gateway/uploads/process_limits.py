"""Limit the processor time and memory of a process that works on hostile bytes."""

from __future__ import annotations

import resource
import signal

_SLOWED = 4.0  # times as much of the clock, on a machine that does other work too; and a minute for a slow disk
_DISK_SECONDS = 60.0


def limit_process(seconds: float, most_data_bytes: int) -> None:
    """Limit this process's time and memory; a crash leaves no core file, which would hold the bytes."""
    whole = int(seconds) + 1
    # The hard limit of the processor time kills; the soft one, a second before it, says why.
    for kind, most, more in (
        (resource.RLIMIT_CPU, whole, 1),
        (resource.RLIMIT_DATA, most_data_bytes, 0),
        (resource.RLIMIT_CORE, 0, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        hard = most + more if hard == resource.RLIM_INFINITY else min(most + more, hard)
        resource.setrlimit(kind, (min(most, hard), hard))
    signal.setitimer(signal.ITIMER_REAL, _SLOWED * seconds + _DISK_SECONDS)  # SIGALRM kills, also in native code
