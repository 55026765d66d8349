"""Keep what a service writes from the other users of its machine."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def write_for_own_user() -> None:
    """Let this process, and those that it starts, make files and folders that no other user may read."""
    os.umask(0o077)


def private_folder(folder: Path) -> None:
    """Make a folder that no other user may enter, or close one that is there. Raises OSError.

    One that belongs to another user, such as a mounted volume, stays as it is.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with suppress(PermissionError):
        folder.chmod(0o700)
