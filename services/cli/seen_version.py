"""Which version of a collection was seen last, kept on this machine, so that an older one is known as such."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import tempfile
from pathlib import Path

from services.cli.errors import BadInput


class Seen:
    """The highest version of one collection at one gateway whose signature held. Its file is written whole or not.

    Two gateways count for themselves: a test system may well have a collection of the same name and key.
    """

    def __init__(self, gateway: str, collection: str) -> None:
        self._who = {"gateway": gateway.rstrip("/"), "collection": collection}
        name = hashlib.sha256(json.dumps(self._who, sort_keys=True).encode()).hexdigest()[:32]
        self.path = state_folder() / "seen" / f"{name}.json"

    @property
    def version(self) -> int:
        """0 where none was seen. Raises BadInput for a file that was not written here."""
        try:
            return int(json.loads(self.path.read_bytes())["version"])
        except FileNotFoundError:
            return 0
        except (ValueError, KeyError, TypeError):
            raise BadInput(
                f"{self.path} says no version; delete it, and older catalogues are not noticed once"
            ) from None

    def remember(self, version: int) -> None:
        """Keep the higher one of this and what is kept. Raises OSError."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # Two commands at once must not leave the lower version; the kernel drops the lock with the process.
        with (self.path.parent / ".lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if version > self.version:
                _write({**self._who, "version": version}, self.path)


def state_folder() -> Path:
    """$XDG_STATE_HOME/capture2vr, or ~/.local/state/capture2vr: unlike a cache, nobody empties it."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "capture2vr"


def _write(document: dict[str, object], path: Path) -> None:
    descriptor, part = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(descriptor, "w") as file:
            json.dump(document, file)
            file.flush()
            os.fsync(file.fileno())
        Path(part).replace(path)
    except BaseException:
        Path(part).unlink(missing_ok=True)
        raise
