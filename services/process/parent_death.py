"""End a process when its parent dies, however that happens: PR_SET_PDEATHSIG of Linux's prctl(2)."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def end_with_parent(parent: int | None = None, *, by: signal.Signals = signal.SIGKILL) -> None:
    """Ask the kernel to signal this process when its parent dies; on systems other than Linux do nothing.

    parent  process number that the parent has; a process whose parent died before this call ends at once.
            None: the caller knows no number
    """
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, by)
    if parent is not None and os.getppid() != parent:
        os._exit(1)
