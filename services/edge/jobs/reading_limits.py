"""Limits of the processor time and the memory that reading a capture may take, in proportion to what was sent.

Captures are hostile until they have been read: a file of a few kilobytes can cost a reader minutes and gigabytes.
"""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.sentences.sentence import say

# Beside the interpreter and its libraries, which have 350 MB: rows of text take 15 times their bytes when they are
# parsed, and are parsed at 20 MB a second.
_LEAST_BYTES, _BYTES_PER_BYTE, _MOST_BYTES = 1 << 30, 16, 6 << 30
_LEAST_SECONDS, _SECONDS_PER_GB = 20, 100


@contextmanager
def limited_reading(folder: Path) -> Iterator[None]:
    """Limit this process, and each child of it, in the block to what reading a capture's folder may take.

    Only the soft limits: a child with an own budget, for native decoders, sets its own, and what follows has none.
    Raises CAPTURE_TOO_LARGE where the memory does not suffice; where the time does not, SIGXCPU ends the process.
    """
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    used = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(used.ru_utime + used.ru_stime) + 1
    limits = {
        resource.RLIMIT_DATA: min(_LEAST_BYTES + _BYTES_PER_BYTE * size, _MOST_BYTES),
        resource.RLIMIT_CPU: seconds + _LEAST_SECONDS + _SECONDS_PER_GB * size // 10**9,
    }
    before = {kind: resource.getrlimit(kind) for kind in limits}
    for kind, most in limits.items():
        hard = before[kind][1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    try:
        yield
    except MemoryError:
        raise too_costly(say("more_memory")) from None
    finally:
        for kind, limit in before.items():
            resource.setrlimit(kind, limit)


def too_costly(what: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a capture that needs more of something than its size explains."""
    return CaptureError("CAPTURE_TOO_LARGE", say("needs_to_be_read_than", what=what))


def reader_ended(status: int) -> EdgeError:
    """Return the error for a process that ended before it had read a capture. status: its exit status."""
    if -status in (signal.SIGXCPU, signal.SIGKILL):  # the kernel sends the second one where memory is short
        return too_costly(say("more_time"))
    name = signal.Signals(-status).name if status < 0 else f"status {status}"
    return CaptureError("CAPTURE_UNREADABLE", say("cannot_be_read_reader_crashed", name=name))
