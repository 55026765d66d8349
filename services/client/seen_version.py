"""Stores the highest version of a collection seen on this machine, to detect that a gateway serves an older one."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
from pathlib import Path

from capture2vr.errors import BadInput
from capture2vr.process.atomic_write import atomic_write


class SeenVersion:
    """The highest version, with a valid signature, of one collection at one gateway. Its file is written atomically.

    Stored for each gateway separately: a test system may have a collection of the same name and key.
    """

    def __init__(self, gateway: str, collection: str) -> None:
        self._identity = {"gateway": gateway.rstrip("/"), "collection": collection}
        name = hashlib.sha256(json.dumps(self._identity, sort_keys=True).encode()).hexdigest()[:32]
        self.path = state_folder() / "seen" / f"{name}.json"

    @property
    def version(self) -> int:
        """The stored version; 0 where none was seen. Raises BadInput for a damaged file."""
        try:
            return int(json.loads(self.path.read_bytes())["version"])
        except FileNotFoundError:
            return 0
        except (ValueError, KeyError, TypeError):
            raise BadInput(
                f"{self.path} is damaged: delete it (the next pull then cannot detect an older catalogue)"
            ) from None

    def remember(self, version: int) -> None:
        """Store this version unless a higher one is stored. Raises OSError."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # Two commands at once must not leave the lower version; the kernel drops the lock with the process.
        with (self.path.parent / ".lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if version > self.version:
                with atomic_write(self.path) as part:
                    part.write_text(json.dumps({**self._identity, "version": version}))


def state_folder() -> Path:
    """Return $XDG_STATE_HOME/capture2vr, or ~/.local/state/capture2vr: unlike a cache, it is never emptied.

    Raises OSError for a user without a home folder.
    """
    return user_folder("XDG_STATE_HOME", ".local/state")


def user_folder(variable: str, below_home: str) -> Path:
    """Return the user's folder for capture2vr: below an XDG variable's folder if set, else below the home folder.

    Raises OSError for a user without one, such as a container's that is given by number.
    """
    if named := os.environ.get(variable):
        return Path(named) / "capture2vr"
    try:
        return Path.home() / below_home / "capture2vr"
    except RuntimeError:
        raise OSError(errno.ENOENT, f"this user has no home folder: set {variable} to a folder to write to") from None
