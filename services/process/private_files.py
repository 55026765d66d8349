"""Keep what a service writes from the other users of its machine, and its secrets from the processes that it starts."""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress
from pathlib import Path

_PR_SET_DUMPABLE = 4  # of prctl(2): files of /proc/PID that tell of its memory are root's then


def write_for_own_user() -> None:
    """Let this process, and those that it starts, make files and folders that no other user may read."""
    os.umask(0o077)


def hide_secrets() -> None:
    """Keep other processes of this user, such as one that a capture has taken over, from this one's variables and
    memory. Whoever may do so in the name of root is not kept, and nobody on systems other than Linux.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_DUMPABLE, 0)


def private_folder(folder: Path) -> None:
    """Make a folder that no other user may enter, or close one that is there. Raises OSError.

    One that belongs to another user, such as a mounted volume, stays as it is.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with suppress(PermissionError):
        folder.chmod(0o700)
