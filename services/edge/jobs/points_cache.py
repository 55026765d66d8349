"""Points that outlive their job's run beside its checkpoint, so that its next lease need not make them again."""

from __future__ import annotations

import logging
from pathlib import Path

from services.edge.errors import EdgeError
from services.edge.prepared import Prepared, read_prepared, write_prepared

_log = logging.getLogger(__name__)

_SUFFIX = ".points"


def keep(prepared: Prepared, checkpoint: Path) -> Path:
    """Write them beside the checkpoint of this lease; they go when that goes. The archive. Raises OSError."""
    archive = checkpoint.with_suffix(_SUFFIX)
    write_prepared(prepared, archive)
    return archive


def kept(checkpoint: Path, scratch: Path) -> Prepared | None:
    """Those that the newest lease of the job has kept, unpacked into `scratch`; None where none can be read."""
    archives = [path for path in checkpoint.parent.glob(f"*{_SUFFIX}") if path.stem.isdecimal()]
    if not archives:
        return None
    newest = max(archives, key=lambda path: int(path.stem))
    try:
        return read_prepared(newest, scratch)
    except (EdgeError, OSError) as error:  # of another version, or gone with the lease that wrote it
        _log.warning("the points in %s cannot be read and are made anew: %s", newest, error)
        return None
